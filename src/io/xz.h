/* Files compressed with xz (LZMA2), inflated into memory within a bound. */
#pragma once

#include "spin.h"

bool spin_xz_looks_like(const unsigned char *head, size_t n);

/* All that the file holds, malloc'd; more than `limit` bytes, or than 32 times the file and
 * 8 MiB, is SPIN_E_UNSUPPORTED. What the decoder needs for itself is bounded too. Errors name the
 * path. */
spin_status spin_xz_load(const char *path, size_t limit, unsigned char **out, size_t *n);
