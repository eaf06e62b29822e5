/* Compressed parts of crates of USD: LZ4 blocks and integers. A compressed block is a byte with the
 * number of chunks, 0 for one; each of several chunks is preceded by its size (4 bytes). A chunk is
 * an LZ4 block.
 *
 * Integers are the differences of successive values: the most frequent difference (4 bytes), a code
 * of 2 bits for each value, and the differences that the codes announce. 0: the most frequent one;
 * 1, 2, 3: one of 1, 2 or 4 bytes. */
#pragma once

#include "base/mem.h"

/* Decompresses a block into `out`, and returns how many bytes it yields; SIZE_MAX: it is damaged or
 * yields more than `capacity` bytes. */
size_t spin_usd_unpack(const unsigned char *in, size_t n, unsigned char *out, size_t capacity);
/* Decodes n integers from a compressed block. *out, which the caller frees, is allocated only if
 * the block can have as many. */
spin_status spin_usd_unpack_ints(const unsigned char *in, size_t n_in, uint64_t n, int32_t **out);
