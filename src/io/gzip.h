/* Deflate, gzip and zlib in memory. */
#pragma once

#include <stdbool.h>

#include "base/pool.h"

/* A part of a deflate stream: n bytes to compress. In memory, n_before bytes that were compressed
 * already precede them; back references may reach the last SPIN_DEFLATE_WINDOW of these. The output
 * ends at a byte boundary; the last part ends the stream. */
enum { SPIN_DEFLATE_WINDOW = 32 << 10 };
struct spin_deflate {
    const unsigned char *data;
    size_t n, n_before;
    int level;
    bool rle;         /* search only for runs of one byte */
    bool noise_as_is; /* store blocks that Huffman coding would not shorten */
    bool last;
};
/* Output buffer of capacity n_room, which grows as needed; the caller frees data. */
struct spin_deflate_room {
    unsigned char *data;
    size_t n_room, n;
};
/* Compress into to->data[n_head .. n_head + to->n), with space for n_tail more bytes behind them,
 * so that the caller can add a header and a trailer. The threads of the pool share the work (NULL:
 * only the calling thread); their number does not affect the output. */
spin_status spin_deflate(struct spin_pool *pool, const struct spin_deflate *job, size_t n_head,
                         size_t n_tail, struct spin_deflate_room *to);

/* Compress n bytes to gzip, using the threads of the pool (NULL: only the calling thread); their
 * number does not affect the output. The output contains no date. Level 1 (fast: entropy coding and
 * runs of one byte, without a search for repeats) to 9 (small). *out has a capacity of *n_room
 * bytes; if that is too small, both are updated. */
spin_status spin_gzip_write(struct spin_pool *pool, int level, const void *data, size_t n,
                            unsigned char **out, size_t *n_room, size_t *n_out);

/* Decompress at most n_out bytes from the beginning of gzip data; *n receives their number.
 * SPIN_E_MALFORMED if the stream is damaged before that; checksum and length are verified if its
 * end is reached. */
spin_status spin_gzip_read(const void *data, size_t size, void *out, size_t n_out, size_t *n);
/* spin_gzip_read() for a zlib stream (RFC 1950). */
spin_status spin_zlib_read(const void *data, size_t size, void *out, size_t n_out, size_t *n);
/* The uncompressed length modulo 2^32, as stored at the end of gzip data; 0 if they are too
 * short. */
uint32_t spin_gzip_length(const void *data, size_t size);
