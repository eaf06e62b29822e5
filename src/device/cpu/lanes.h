/* Defines a vector of floats that has the width of this SIMD path, and masks that select lanes of
 * the vector. Most functions use the vector types of the compiler; those for AVX-512 use mask
 * registers. */
#pragma once

#include <stdint.h>
#include <string.h>

#include "math/approx.h"
#include "math/portable.h"

#if defined(__AVX512F__) && defined(__AVX512DQ__)
#define SPIN_LANES 16
#include <immintrin.h>
#elif defined(__AVX__)
#define SPIN_LANES 8
#include <immintrin.h>
#else
#define SPIN_LANES 4
#if defined(__SSE2__)
#include <emmintrin.h>
#endif
#endif

typedef float spin_lanes __attribute__((vector_size(4 * SPIN_LANES)));
typedef uint32_t spin_lanes_u __attribute__((vector_size(4 * SPIN_LANES)));
typedef int32_t spin_lanes_i __attribute__((vector_size(4 * SPIN_LANES)));

#if SPIN_LANES == 16
typedef __mmask16 spin_mask;
#else
typedef spin_lanes_i spin_mask; /* 0 (false) or -1 (true) in each lane */
#endif

SPIN_FN spin_lanes spin_lanes_all(float v) { return v - (spin_lanes){0}; }

SPIN_FN spin_lanes spin_lanes_load(const float *from)
{
    spin_lanes v;
    memcpy(&v, from, sizeof v);
    return v;
}

SPIN_FN void spin_lanes_store(float *to, spin_lanes v) { memcpy(to, &v, sizeof v); }

SPIN_FN spin_lanes_i spin_lanes_load_i(const int32_t *from)
{
    spin_lanes_i v;
    memcpy(&v, from, sizeof v);
    return v;
}

SPIN_FN void spin_lanes_store_i(int32_t *to, spin_lanes_i v) { memcpy(to, &v, sizeof v); }

/* Returns the vector of lane numbers: 0, 1, 2, ... */
SPIN_FN spin_lanes spin_lanes_count(void)
{
    static const float count[16] = {0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15};
    return spin_lanes_load(count);
}

#if SPIN_LANES == 16

SPIN_FN spin_mask spin_lanes_ge(spin_lanes a, spin_lanes b)
{
    return _mm512_cmp_ps_mask((__m512)a, (__m512)b, _CMP_GE_OQ);
}
SPIN_FN int spin_mask_any(spin_mask m) { return m != 0; }
SPIN_FN uint32_t spin_mask_bits(spin_mask m) { return m; } /* bit i is the mask of lane i */
SPIN_FN spin_mask spin_mask_and(spin_mask a, spin_mask b) { return (spin_mask)(a & b); }
SPIN_FN spin_mask spin_mask_without(spin_mask a, spin_mask b) { return (spin_mask)(a & ~b); }
SPIN_FN spin_mask spin_mask_first(int n) { return (spin_mask)((1u << n) - 1); }
SPIN_FN spin_lanes spin_lanes_pick(spin_mask m, spin_lanes yes, spin_lanes no)
{
    return (spin_lanes)_mm512_mask_blend_ps(m, (__m512)no, (__m512)yes);
}
/* Stores only the lanes that the mask selects; `to` must be aligned. */
SPIN_FN void spin_lanes_put_i(int32_t *to, spin_mask m, spin_lanes_i v)
{
    _mm512_mask_store_epi32(to, m, (__m512i)v);
}
SPIN_FN spin_lanes spin_lanes_keep(spin_mask m, spin_lanes v)
{
    return (spin_lanes)_mm512_maskz_mov_ps(m, (__m512)v);
}
SPIN_FN spin_lanes spin_lanes_min(spin_lanes a, spin_lanes b)
{
    return (spin_lanes)_mm512_min_ps((__m512)a, (__m512)b);
}
SPIN_FN spin_lanes spin_lanes_max(spin_lanes a, spin_lanes b)
{
    return (spin_lanes)_mm512_max_ps((__m512)a, (__m512)b);
}
/* Returns 1/v, computed from a 14-bit estimate by one Newton step, with a relative error of 1e-7.
 */
SPIN_FN spin_lanes spin_lanes_inverse(spin_lanes v)
{
    spin_lanes x = (spin_lanes)_mm512_rcp14_ps((__m512)v);
    return x + x * (1.0f - v * x);
}

#else

SPIN_FN spin_mask spin_lanes_ge(spin_lanes a, spin_lanes b) { return (spin_mask)(a >= b); }
SPIN_FN spin_mask spin_mask_and(spin_mask a, spin_mask b) { return a & b; }
SPIN_FN spin_mask spin_mask_without(spin_mask a, spin_mask b) { return a & ~b; }
SPIN_FN spin_lanes spin_lanes_keep(spin_mask m, spin_lanes v)
{
    return (spin_lanes)(m & (spin_lanes_i)v);
}
SPIN_FN spin_lanes spin_lanes_pick(spin_mask m, spin_lanes yes, spin_lanes no)
{
    return (spin_lanes)((m & (spin_lanes_i)yes) | (~m & (spin_lanes_i)no));
}
SPIN_FN void spin_lanes_put_i(int32_t *to, spin_mask m, spin_lanes_i v)
{
    spin_lanes_store_i(to, (m & v) | (~m & spin_lanes_load_i(to)));
}
SPIN_FN spin_lanes spin_lanes_inverse(spin_lanes v) { return 1.0f / v; }

#if defined(__AVX__)
SPIN_FN uint32_t spin_mask_bits(spin_mask m) { return (uint32_t)_mm256_movemask_ps((__m256)m); }
SPIN_FN int spin_mask_any(spin_mask m) { return spin_mask_bits(m) != 0; }
SPIN_FN spin_lanes spin_lanes_min(spin_lanes a, spin_lanes b)
{
    return (spin_lanes)_mm256_min_ps((__m256)a, (__m256)b);
}
SPIN_FN spin_lanes spin_lanes_max(spin_lanes a, spin_lanes b)
{
    return (spin_lanes)_mm256_max_ps((__m256)a, (__m256)b);
}
#elif defined(__SSE2__)
SPIN_FN uint32_t spin_mask_bits(spin_mask m) { return (uint32_t)_mm_movemask_ps((__m128)m); }
SPIN_FN int spin_mask_any(spin_mask m) { return spin_mask_bits(m) != 0; }
SPIN_FN spin_lanes spin_lanes_min(spin_lanes a, spin_lanes b)
{
    return (spin_lanes)_mm_min_ps((__m128)a, (__m128)b);
}
SPIN_FN spin_lanes spin_lanes_max(spin_lanes a, spin_lanes b)
{
    return (spin_lanes)_mm_max_ps((__m128)a, (__m128)b);
}
#else
SPIN_FN uint32_t spin_mask_bits(spin_mask m)
{
    uint32_t bits = 0;
    for (int i = 0; i < SPIN_LANES; i++)
        bits |= (uint32_t)(m[i] & 1) << i;
    return bits;
}
SPIN_FN int spin_mask_any(spin_mask m) { return spin_mask_bits(m) != 0; }
SPIN_FN spin_lanes spin_lanes_min(spin_lanes a, spin_lanes b)
{
    return spin_lanes_pick((spin_mask)(a < b), a, b);
}
SPIN_FN spin_lanes spin_lanes_max(spin_lanes a, spin_lanes b)
{
    return spin_lanes_pick((spin_mask)(a > b), a, b);
}
#endif

/* Returns the mask that selects the first n lanes. */
SPIN_FN spin_mask spin_mask_first(int n)
{
    return spin_lanes_ge(spin_lanes_all((float)n - 0.5f), spin_lanes_count());
}

#endif

/* Computes spin_exp2() of math/approx.h for -126 <= x <= 127. */
SPIN_FN spin_lanes spin_lanes_exp2(spin_lanes x)
{
    spin_lanes shifted = x + SPIN_ROUND_MAGIC, f = x - (shifted - SPIN_ROUND_MAGIC), p;

    p = 1.3276471979302398e-3f * f + 9.675541334214534e-3f;
    p = p * f + 5.550713273543044e-2f;
    p = p * f + 2.40221197238485e-1f;
    p = p * f + 6.93146967064733e-1f;
    p = p * f + 1.0f;
    return (spin_lanes)((spin_lanes_u)p + ((spin_lanes_u)shifted << 23));
}

/* Returns the sum of the lanes, which are added in a fixed order. */
SPIN_FN float spin_lanes_sum(spin_lanes v)
{
#if SPIN_LANES == 16
    __m256 half =
        _mm256_add_ps(_mm512_castps512_ps256((__m512)v), _mm512_extractf32x8_ps((__m512)v, 1));
    __m128 q = _mm_add_ps(_mm256_castps256_ps128(half), _mm256_extractf128_ps(half, 1));
#elif SPIN_LANES == 8
    __m128 q = _mm_add_ps(_mm256_castps256_ps128((__m256)v), _mm256_extractf128_ps((__m256)v, 1));
#elif defined(__SSE2__)
    __m128 q = (__m128)v;
#else
    return (v[0] + v[2]) + (v[1] + v[3]);
#endif
#if SPIN_LANES > 4 || defined(__SSE2__)
    q = _mm_add_ps(q, _mm_movehl_ps(q, q));
    return _mm_cvtss_f32(_mm_add_ss(q, _mm_shuffle_ps(q, q, 1)));
#endif
}

/* Sets sum[0] to sum[7] to the sums of the lanes of eight vectors, each added in a fixed order. */
SPIN_FN void spin_lanes_sum8(const spin_lanes *v, float *sum)
{
#if SPIN_LANES == 16
    __m512 half[4], x, y;
    float all[16];

    for (int i = 0; i < 4; i++) { /* half[i]: sums of a in its lower half, of b in its upper half */
        __m512 a = (__m512)v[2 * i], b = (__m512)v[2 * i + 1];
        half[i] = _mm512_add_ps(_mm512_shuffle_f32x4(a, b, 0x44), _mm512_shuffle_f32x4(a, b, 0xee));
    }
    x = _mm512_add_ps(_mm512_shuffle_f32x4(half[0], half[1], 0x88),
                      _mm512_shuffle_f32x4(half[0], half[1], 0xdd));
    y = _mm512_add_ps(_mm512_shuffle_f32x4(half[2], half[3], 0x88),
                      _mm512_shuffle_f32x4(half[2], half[3], 0xdd));
    x = _mm512_add_ps(_mm512_unpacklo_ps(x, y), _mm512_unpackhi_ps(x, y));
    x = _mm512_add_ps(x, _mm512_shuffle_ps(x, x, 0xee));
    _mm512_storeu_ps(all, x);
    for (int i = 0; i < 4; i++) {
        sum[i] = all[4 * i];
        sum[4 + i] = all[4 * i + 1];
    }
#else
    for (int i = 0; i < 8; i++)
        sum[i] = spin_lanes_sum(v[i]);
#endif
}
