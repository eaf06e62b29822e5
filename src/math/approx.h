/* exp, exp2, sigmoid, erf and GELU without libm, so that loops over these functions vectorise and
 * all devices compute the same values. tests/math/t-approx.c checks the error bounds below on a
 * dense grid of arguments.
 *
 * Unless stated otherwise, arguments outside a function's range are clamped, and the result for NaN
 * is NaN. */
#pragma once

#include "math/portable.h"

SPIN_FN float spin_float_of_bits(uint32_t bits)
{
#if defined(__CUDA_ARCH__)
    return __uint_as_float(bits);
#else
    union {
        uint32_t u;
        float f;
    } pun;
    pun.u = bits;
    return pun.f;
#endif
}

SPIN_FN uint32_t spin_bits_of_float(float x)
{
#if defined(__CUDA_ARCH__)
    return __float_as_uint(x);
#else
    union {
        uint32_t u;
        float f;
    } pun;
    pun.f = x;
    return pun.u;
#endif
}

/* Adding 1.5 * 2^23 to a float rounds the float to the nearest integer, which is then in the low
 * bits of the sum. SPIN_ROUND_BITS: the bit pattern of 1.5 * 2^23. */
#define SPIN_ROUND_MAGIC 12582912.0f
#define SPIN_ROUND_BITS 0x4b400000u

/* 2^f for |f| <= 1/2: minimax polynomial of degree 5, relative error 3e-7. */
SPIN_FN float spin_exp2_fraction(float f)
{
    float p = 1.3276471979302398e-3f;

    p = p * f + 9.675541334214534e-3f;
    p = p * f + 5.550713273543044e-2f;
    p = p * f + 2.40221197238485e-1f;
    p = p * f + 6.93146967064733e-1f;
    return p * f + 1.0f;
}

/* 1 / v, where v and 1 / v must be normal (not denormal). On a GPU, the approximate instruction is
 * used, with an error of 1 unit in the last place, since it is faster than a division. */
SPIN_FN float spin_reciprocal(float v)
{
#if defined(__CUDA_ARCH__)
    float inverse;

    asm("rcp.approx.ftz.f32 %0, %1;" : "=f"(inverse) : "f"(v));
    return inverse;
#else
    return 1 / v;
#endif
}

/* 2^x; x is clamped to [-126, 127]. Relative error 3e-7. */
SPIN_FN float spin_exp2(float x)
{
    float shifted, p;

    x = x < -126.0f ? -126.0f : x;
    x = x > 127.0f ? 127.0f : x;
    shifted = x + SPIN_ROUND_MAGIC;
    p = spin_exp2_fraction(x - (shifted - SPIN_ROUND_MAGIC));
    return p * spin_float_of_bits((spin_bits_of_float(shifted) - SPIN_ROUND_BITS + 127u) << 23);
}

/* 2^x without clamping; x must be in [-126, 127]. Computes 2 to the fractional part of x, and adds
 * the integer part of x to the exponent bits of this float. */
SPIN_FN float spin_exp2_within(float x)
{
    float shifted = x + SPIN_ROUND_MAGIC;
    float p = spin_exp2_fraction(x - (shifted - SPIN_ROUND_MAGIC));

    return spin_float_of_bits(spin_bits_of_float(p) + (spin_bits_of_float(shifted) << 23));
}

/* e^x; x is clamped to [-87, 88]. Relative error 2e-7. e^x = 2^n e^f with f = x - n ln 2 and |f| <=
 * ln(2)/2. ln 2 is split into two constants, so that the low bits of f are exact. e^f is
 * approximated by a polynomial of degree 6, exact at f = 0. */
SPIN_FN float spin_exp(float x)
{
    float shifted, n, f, p;

    x = x < -87.0f ? -87.0f : x;
    x = x > 88.0f ? 88.0f : x;
    shifted = x * 1.44269504088896341f + SPIN_ROUND_MAGIC;
    n = shifted - SPIN_ROUND_MAGIC;
    f = x - n * 0.693359375f;
    f = f + n * 2.12194440e-4f;
    p = 1.381461276459081e-3f;
    p = p * f + 8.368710026517165e-3f;
    p = p * f + 4.166838738249959e-2f;
    p = p * f + 1.6666520688169564e-1f;
    p = p * f + 4.9999993451588126e-1f;
    p = p * f * f + f + 1.0f;
    return p * spin_float_of_bits((spin_bits_of_float(shifted) - SPIN_ROUND_BITS + 127u) << 23);
}

/* 1 / (1 + e^-x). Relative error 4e-7 for x >= -87; absolute error 2e-7 for all x. */
SPIN_FN float spin_sigmoid(float x) { return 1.0f / (1.0f + spin_exp(-x)); }

/* Phi(-|x|), the tail of the standard normal distribution, from |x| and e^(-x^2/2). It is computed
 * as erfc(|x| / sqrt(2)) / 2 by formula 7.1.26 of Abramowitz and Stegun, with an absolute error of
 * 0.8e-7 plus rounding. */
SPIN_FN float spin_normal_tail(float abs_x, float exp_half_x2)
{
    float t = spin_reciprocal(1.0f + 0.231641888f * abs_x); /* 0.3275911 / sqrt(2) */
    float p = 0.5307027145f; /* this and the following coefficients are half those of 7.1.26 */

    p = p * t - 0.7265760135f;
    p = p * t + 0.7107068705f;
    p = p * t - 0.142248368f;
    p = p * t + 0.127414796f;
    return p * t * exp_half_x2;
}

/* erf(x). Absolute error 6e-7. The error is largest near 0, where 1 - 2 Phi cancels. */
SPIN_FN float spin_erf(float x)
{
    float u = fabsf(x);
    float e = spin_exp2(-1.44269504088896341f * u * u);
    float y = 1.0f - 2.0f * spin_normal_tail(1.41421356237309505f * u, e);

    return x < 0.0f ? -y : y;
}

/* Returns GELU(x) = x Phi(x) in its exact (erf) form (docs/method.md 3.4), and sets *slope to its
 * derivative Phi(x) + x phi(x). Value and derivative share the exponential e^(-x^2/2). For |x| <= 6
 * the absolute error is 5e-7 plus rounding in the value, and 5e-7 in the derivative. */
SPIN_FN float spin_gelu_both(float x, float *slope)
{
    float u = fabsf(x);
    float e = spin_exp2(-0.72134752044448170f * u * u); /* log2(e) / 2 */
    float tail = spin_normal_tail(u, e);
    float phi = x < 0.0f ? tail : 1.0f - tail;

    *slope = phi + x * 0.39894228040143268f * e;
    return x * phi;
}

/* GELU(x) without its derivative, absolute error 5e-7. With u = |x|, x Phi(x) = max(x, 0) - u
 * Phi(-u). log2(Phi(-u)) is so smooth that a polynomial of degree 6 is sufficient, which is faster
 * than spin_normal_tail(). The polynomial is minimax for the error of u Phi(-u) on [0, 5.6]; for
 * larger u, the product is set to its value at 5.6, which is 6e-8. u is compared with 5.6 as an
 * integer, since the bits of positive floats have the order of their values. max(x, 0) is computed
 * as (x + |x|) / 2, so that the result for NaN is NaN. */
SPIN_FN float spin_gelu(float x)
{
    uint32_t bits = spin_bits_of_float(x) & 0x7fffffffu, far = 0x40b33333u; /* 5.6 */
    float both = x + spin_float_of_bits(bits), q;
    float u = spin_float_of_bits(bits < far ? bits : far);

    q = 2.868571971e-5f;
    q = q * u - 7.291929278e-4f;
    q = q * u + 7.943568729e-3f;
    q = q * u - 5.318971521e-2f;
    q = q * u - 4.589454913e-1f;
    q = q * u - 1.151142148f;
    q = q * u - 9.999991891e-1f;
    return 0.5f * both - u * spin_exp2_within(q);
}
