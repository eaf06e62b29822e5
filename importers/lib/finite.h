/* How many of some values are NaN or infinite, at the speed of memory: importers look at every value of
 * every frame. */
#ifndef SPIN_IMPORTERS_LIB_FINITE_H
#define SPIN_IMPORTERS_LIB_FINITE_H

#include <stddef.h>
#include <stdint.h>
#include <string.h>

/* By the bits, whose exponent is all ones; in 32-bit sums, which the compiler turns into vectors. */
static inline size_t finite_missing(const float *values, size_t n)
{
    const uint32_t exponent = 0x7f800000u;
    size_t bad = 0;

    for (size_t first = 0; first < n; first += 4096) {
        size_t end = first + 4096 < n ? first + 4096 : n;
        uint32_t part = 0;

        for (size_t i = first; i < end; i++) {
            uint32_t bits;

            memcpy(&bits, &values[i], sizeof bits);
            part += (bits & exponent) == exponent;
        }
        bad += part;
    }
    return bad;
}

#endif
