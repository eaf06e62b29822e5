/* Byte planes, the form in which some formats store a column of integers before compression: each
 * integer is mapped to an unsigned symbol of 1, 2 or 4 bytes by zigzag coding; the first plane
 * contains the lowest bytes of all symbols, the second plane their second bytes, and so on. */
#pragma once

#include <stddef.h>
#include <stdint.h>

/* Reads symbol i of n symbols with `width` bytes each. */
static inline uint32_t spin_plane_symbol(const unsigned char *planes, int width, size_t n, size_t i)
{
    uint32_t symbol = 0;

    for (int b = 0; b < width; b++)
        symbol |= (uint32_t)planes[(size_t)b * n + i] << (8 * b);
    return symbol;
}

/* Zigzag decoding: 0, 1, 2, 3, 4 become 0, -1, 1, -2, 2. */
static inline int32_t spin_unzigzag(uint32_t symbol)
{
    return (int32_t)(symbol >> 1 ^ -(symbol & 1));
}

/* Zigzag encoding, the inverse of spin_unzigzag(). */
static inline uint32_t spin_zigzag(int32_t value)
{
    return (uint32_t)value << 1 ^ (value < 0 ? UINT32_MAX : 0);
}
