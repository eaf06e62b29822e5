/* Between these two calls denormal numbers are treated as zero. Adam's moments of parameters
 * without a gradient decay to denormal numbers and stay there, since 0.9 times the smallest
 * denormal is rounded back to it. Arithmetic on denormals is a hundred times slower. Without SSE
 * the calls do nothing. */
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
