/* Deflate, gzip and zlib in memory. */
#pragma once

#include <stdbool.h>

#include "base/pool.h"

/* A part of a deflate stream: n bytes, and n_before bytes that lie before them and were deflated
 * already (those that back references may reach: SPIN_DEFLATE_WINDOW). It ends on a whole byte; the
 * last part ends the stream. */
enum { SPIN_DEFLATE_WINDOW = 32 << 10 };
struct spin_deflate {
    const unsigned char *data;
    size_t n, n_before;
    int level;
    bool rle;         /* only runs of one byte are found */
    bool noise_as_is; /* blocks that Huffman's code would not shorten are stored */
    bool last;
};
/* Grows as needed; free(data) at last. */
struct spin_deflate_room {
    unsigned char *data;
    size_t n_room, n;
};
/* The deflated bytes are to->data[n_head .. n_head + to->n), with room for n_tail more behind them.
 * By the threads of the pool (NULL: by this one); the bytes do not depend on them. */
spin_status spin_deflate(struct spin_pool *pool, const struct spin_deflate *job, size_t n_head,
                         size_t n_tail, struct spin_deflate_room *to);

/* The gzip of n bytes, deflated by the threads of the pool (NULL: by this one); the bytes do not
 * depend on them, and carry no date. Level 1 (fast: codes by frequency and runs of one byte, no
 * search for repeats) to 9 (small). *out has room for *n_room bytes and grows when that is not
 * enough. */
spin_status spin_gzip_write(struct spin_pool *pool, int level, const void *data, size_t n,
                            unsigned char **out, size_t *n_room, size_t *n_out);

/* At most n_out bytes from the beginning of a gzip in memory; *n how many there were. A stream that
 * is damaged before them is SPIN_E_MALFORMED, checksum and length included when its end is reached.
 */
spin_status spin_gzip_read(const void *data, size_t size, void *out, size_t n_out, size_t *n);
/* The same of a zlib stream (RFC 1950). */
spin_status spin_zlib_read(const void *data, size_t size, void *out, size_t n_out, size_t *n);
/* What the last bytes of a gzip say of its length, modulo 2^32; 0 when there are none. */
uint32_t spin_gzip_length(const void *data, size_t size);
