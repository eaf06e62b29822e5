/* The checksum of zip and gzip, at the speed of memory where the processor multiplies without carry. */
#ifndef SPIN_IO_CRC_H
#define SPIN_IO_CRC_H

#include <stddef.h>
#include <stdint.h>

/* Of all the bytes so far, from that of those before (0: none): as zlib's crc32(). */
uint32_t spin_crc32(uint32_t crc, const void *data, size_t n);
/* Of one block, a large one by a few threads. */
uint32_t spin_crc32_whole(const void *data, size_t n);

/* What a file is told by: its bytes, not its name or time. */
struct spin_imprint {
    uint64_t size;
    uint32_t crc; /* of all bytes */
};

#endif
