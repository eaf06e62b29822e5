/* Counting values that are not finite. */
#include "importers/lib/finite.h"

#include <stdint.h>

size_t spin_finite_missing(const float *values, size_t n)
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
