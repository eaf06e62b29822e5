/* Files compressed with xz (LZMA2), decompressed into memory within a limit. */
#pragma once

#include "spin.h"

bool spin_xz_looks_like(const unsigned char *head, size_t n);

/* The decompressed file, allocated with malloc. SPIN_E_UNSUPPORTED if it exceeds `limit` bytes, or
 * 32 times the size of the file plus 8 MiB. The decoder's own memory is limited too. Errors contain
 * the path. */
spin_status spin_xz_load(const char *path, size_t limit, unsigned char **out, size_t *n);
