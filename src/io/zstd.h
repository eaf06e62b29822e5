/* Frames of Zstandard (RFC 8878) in memory, by the system's libzstd. It is loaded when first
 * needed, so that who reads or writes no such file does without; Debian and Ubuntu always have
 * it, as dpkg does not do without. SPIN_ZSTD names another file than libzstd.so.1. */
#pragma once

#include "spin.h"

/* SPIN_E_UNSUPPORTED without the library. */
spin_status spin_zstd_need(void);
/* All frames of data, which must give exactly n_out bytes. SPIN_E_MALFORMED otherwise;
 * SPIN_E_UNSUPPORTED without the library. */
spin_status spin_zstd_read(const void *data, size_t size, void *out, size_t n_out);
/* One frame of data, of level 1 (fast) to 19 (small); *out has room for *n_room bytes and grows
 * when that is not enough. The same data, level and library give the same bytes. */
spin_status spin_zstd_write(const void *data, size_t size, int level, unsigned char **out,
                            size_t *n_room, size_t *n_out);
