/* Files compressed with xz (LZMA2), decompressed into memory within a limit. */
#pragma once

#include "spin.h"

bool spin_xz_detect(const unsigned char *head, size_t n);

/* Decompress a file into a block allocated with malloc. SPIN_E_UNSUPPORTED if the decompressed size
 * exceeds `limit` bytes, or exceeds the sum of 8 MiB and 32 times the size of the file. The
 * decoder's own memory is limited too. Errors contain the path. */
spin_status spin_xz_load(const char *path, size_t limit, unsigned char **out, size_t *n);
