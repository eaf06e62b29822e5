/* Morton codes (Morton 1966) interleave the bits of x, y and z. Points that are close in space
 * mostly have similar codes. */
#pragma once

#include "math/portable.h"

#define SPIN_MORTON_MAX 2097151.0 /* 21 bits per axis */

/* Inserts two zero bits between consecutive bits of the low 21 bits of x. The code of a point is
 * spread(x) | spread(y) << 1 | spread(z) << 2. */
SPIN_FN uint64_t spin_morton_spread(uint64_t x)
{
    x &= 0x1fffff;
    x = (x | x << 32) & 0x1f00000000ffffULL;
    x = (x | x << 16) & 0x1f0000ff0000ffULL;
    x = (x | x << 8) & 0x100f00f00f00f00fULL;
    x = (x | x << 4) & 0x10c30c30c30c30c3ULL;
    return (x | x << 2) & 0x1249249249249249ULL;
}
