/* Between a call of spin_denormals_off() and one of spin_denormals_back(), denormal numbers are
 * treated as zero. Otherwise the moments of Adam, for parameters without a gradient, would decay to
 * denormal numbers and stay denormal, since 0.9 times the smallest denormal number is rounded to
 * that number again. Arithmetic on denormal numbers is a hundred times slower. Without SSE the
 * functions do nothing. */
#pragma once

#if defined(__SSE__)
#include <xmmintrin.h>
#endif

static inline unsigned spin_denormals_off(void)
{
#if defined(__SSE__)
    unsigned before = _mm_getcsr();

    _mm_setcsr(before | 0x8040u); /* sets the bits "flush to zero" and "denormals are zero" */
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
