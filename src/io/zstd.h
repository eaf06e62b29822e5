/* Zstandard frames (RFC 8878) in memory, by the system's libzstd. The library is loaded when first
 * needed, so that only files in this format require it; Debian and Ubuntu always have it, since
 * dpkg requires it. The environment variable SPIN_ZSTD can replace the path libzstd.so.1. */
#pragma once

#include "spin.h"

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
