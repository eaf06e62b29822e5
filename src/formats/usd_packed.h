/* Compressed parts of USD crates: LZ4 blocks and integers. A compressed block begins with a byte,
 * the number of chunks, where 0 means a single chunk without a size; otherwise each chunk is
 * preceded by its size in 4 bytes. A chunk is an LZ4 block.
 *
 * Integers are stored as the differences of successive values: first the most frequent difference
 * (4 bytes), then a code of 2 bits for each value, then all other differences. Code 0 stands for
 * the most frequent difference; 1, 2 and 3 for a stored difference of 1, 2 or 4 bytes. */
#pragma once

#include "base/mem.h"

/* Decompresses a block into `out` and returns the number of decompressed bytes; SIZE_MAX if the
 * block is damaged or yields more than `capacity` bytes. */
size_t spin_usd_unpack(const unsigned char *in, size_t n, unsigned char *out, size_t capacity);
/* Decodes n integers from a compressed block into *out, which the caller frees. *out is allocated
 * only if the block is large enough for n integers, so that a small damaged file cannot demand much
 * memory. */
spin_status spin_usd_unpack_ints(const unsigned char *in, size_t n_in, uint64_t n, int32_t **out);
