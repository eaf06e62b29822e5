/* Moments of entries that are no longer touched fade into denormal numbers, and stay there: 0.9
 * times the smallest one rounds back to it. Arithmetic on them is a hundred times slower, so they
 * count as zero between these two calls. On machines without the switch nothing but speed changes.
 */
#pragma once

#if defined(__SSE__)
#include <xmmintrin.h>
#endif

static inline unsigned spin_denormals_off(void)
{
#if defined(__SSE__)
    unsigned before = _mm_getcsr();

    _mm_setcsr(before | 0x8040u); /* flush to zero, denormals are zero */
    return before;
#else
    return 0;
#endif
}

static inline void spin_denormals_back(unsigned before)
{
#if defined(__SSE__)
    _mm_setcsr(before);
#else
    (void)before;
#endif
}
