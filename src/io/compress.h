/* Compression and decompression in memory: deflate, gzip and zlib, xz, and Zstandard. */
#pragma once

#include <stdbool.h>

#include "spin.h"
#include "base/pool.h"

/* ---- Deflate, gzip and zlib ------------------------------------------------------------------ */

/* A part of a deflate stream: n bytes at `data`, to be compressed. In memory, they follow n_before
 * bytes that were compressed earlier; back references may point to the last SPIN_DEFLATE_WINDOW of
 * those earlier bytes. The output of each part ends at a byte boundary, and the output of the last
 * part ends the stream. */
enum { SPIN_DEFLATE_WINDOW = 32 << 10 };
struct spin_deflate {
    const unsigned char *data;
    size_t n, n_before;
    int level;
    bool rle;         /* only search for repetitions of the preceding byte, which is faster */
    bool noise_as_is; /* store blocks uncompressed if Huffman coding would hardly shorten them */
    bool last;
};
/* An output buffer with a capacity of n_room bytes. Functions enlarge it as needed; the caller
 * frees `data`. n: number of bytes that spin_deflate() wrote. */
struct spin_deflate_room {
    unsigned char *data;
    size_t n_room, n;
};
/* Compress a part. The output begins at to->data[n_head] and has to->n bytes; the buffer has space
 * for n_tail more bytes behind it, so that the caller can add a header of n_head bytes and a
 * trailer. The threads of the pool share the work; if `pool` is NULL, only the calling thread
 * works. The number of threads does not affect the output. */
spin_status spin_deflate(struct spin_pool *pool, const struct spin_deflate *job, size_t n_head,
                         size_t n_tail, struct spin_deflate_room *to);

/* Compress n bytes to gzip, using the threads of the pool, or only the calling thread if `pool` is
 * NULL. The number of threads does not affect the output, which contains no date. level: 1 (fast:
 * entropy coding and repetitions of single bytes, without a search for repeated strings) to 9
 * (small). *out is a buffer with a capacity of *n_room bytes; if it is too small, it is reallocated
 * and *n_room increases. *n_out receives the size of the output. */
spin_status spin_gzip_write(struct spin_pool *pool, int level, const void *data, size_t n,
                            unsigned char **out, size_t *n_room, size_t *n_out);

/* Decompress gzip data until n_out bytes are written or the stream ends; *n receives the number of
 * decompressed bytes. SPIN_E_MALFORMED if the part of the stream that was read is damaged. The
 * checksum and length at the end of the stream are verified only if the end is reached. */
spin_status spin_gzip_read(const void *data, size_t size, void *out, size_t n_out, size_t *n);
/* spin_gzip_read() for a zlib stream (RFC 1950). */
spin_status spin_zlib_read(const void *data, size_t size, void *out, size_t n_out, size_t *n);
/* Compress n bytes to a zlib stream. The caller frees *out, which has *n_out bytes. */
spin_status spin_zlib_write(const void *data, size_t n, unsigned char **out, size_t *n_out);
/* The uncompressed length modulo 2^32, as stored at the end of gzip data; 0 if the data are shorter
 * than any gzip file. */
uint32_t spin_gzip_length(const void *data, size_t size);

/* ---- xz -------------------------------------------------------------------------------------- */

/* Files compressed with xz (LZMA2), decompressed into memory within a limit. */

bool spin_xz_detect(const unsigned char *head, size_t n);

/* Decompress a file into a block allocated with malloc. SPIN_E_UNSUPPORTED if the decompressed size
 * exceeds `limit` bytes, or exceeds the sum of 8 MiB and 32 times the size of the file. The
 * decoder's own memory is limited too. Errors contain the path. */
spin_status spin_xz_load(const char *path, size_t limit, unsigned char **out, size_t *n);

/* ---- Zstandard ------------------------------------------------------------------------------- */

/* Zstandard frames (RFC 8878) in memory, by the system's libzstd. The library is loaded when first
 * needed, so that only files in this format require it; Debian and Ubuntu always have it, since
 * dpkg requires it. The environment variable SPIN_ZSTD can replace the path libzstd.so.1. */

/* SPIN_E_UNSUPPORTED if the library is missing. */
spin_status spin_zstd_need(void);
/* Decompress all frames of data, which must yield exactly n_out bytes, else SPIN_E_MALFORMED.
 * SPIN_E_UNSUPPORTED if the library is missing. */
spin_status spin_zstd_read(const void *data, size_t size, void *out, size_t n_out);
/* Compress data as one frame. level: 1 (fast) to 19 (small). *out is a buffer with a capacity of
 * *n_room bytes; if it is too small, it is reallocated and *n_room increases. *n_out receives the
 * size of the frame. Equal data, level and library give equal bytes. */
spin_status spin_zstd_write(const void *data, size_t size, int level, unsigned char **out,
                            size_t *n_room, size_t *n_out);
