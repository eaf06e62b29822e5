/* Decompresses the blocks of USD crates and decodes their integers. A compressed block begins with
 * a byte, the number of chunks. Each chunk is an LZ4 block, preceded by its size in 4 bytes. If the
 * first byte is 0, a single LZ4 block follows, without its size.
 *
 * Integers are stored as the differences of successive values: first the most frequent difference
 * (4 bytes), then a code of 2 bits for each value, then all other differences. Code 0 means the
 * most frequent difference; codes 1, 2 and 3 mean a difference that is stored in 1, 2 or 4 bytes.
 */
#pragma once

#include "base/mem.h"

/* Decompresses a block into `out`, and returns the number of decompressed bytes, or SIZE_MAX if the
 * block is malformed or decompresses to more than `capacity` bytes. */
size_t spin_usd_unpack(const unsigned char *in, size_t n, unsigned char *out, size_t capacity);
/* Decodes n integers from a compressed block into *out, which the caller frees. *out is only
 * allocated if the block may contain n integers, so that a small malformed file cannot cause a
 * large allocation. */
spin_status spin_usd_unpack_ints(const unsigned char *in, size_t n_in, uint64_t n, int32_t **out);
