/* The Neural Transformation Cache of 3DGStream: a multi-resolution 3-D hash grid, and rounding to
 * half precision, as implemented in tiny-cuda-nn (NVlabs/tiny-cuda-nn 6ee3546).
 *
 * It differs from the grid of spin4d (grid.h) in three ways: vertex k along an axis is at (k - 0.5)
 * / scale; interpolation weights are linear; and the number of rows of a level is rounded up to a
 * multiple of 8. */
#pragma once

#include "math/approx.h"

/* Rounds a float to the nearest half-precision value, ties to even, and returns it as a float. */
SPIN_FN float spin_half(float x)
{
    uint32_t bits = spin_bits_of_float(x), sign = bits & 0x80000000u, a = bits & 0x7fffffffu;

    if (a >= 0x7f800000u) /* infinity or NaN */
        return x;
    if (a >= 0x477ff000u) /* 65520, midway between the largest half, 65504, and 2^16 */
        return spin_float_of_bits(sign | 0x7f800000u);
    /* Below 2^-14, halves are multiples of 2^-24: adding 0.5f rounds to such a multiple. */
    if (a < 0x38800000u) {
        float r = (spin_float_of_bits(a) + 0.5f) - 0.5f;

        return spin_float_of_bits(sign | spin_bits_of_float(r));
    }
    a += 0xfffu + (a >> 13 & 1u);
    return spin_float_of_bits(sign | (a & ~0x1fffu));
}

struct spin_ntc_level {
    float scale;
    uint32_t res;     /* vertices along an axis */
    uint32_t entries; /* rows of the table */
    int hashed;
};

/* Computes the geometry of a level: scale = base * growth^level - 1, in float arithmetic like
 * tiny-cuda-nn, and res = ceil(scale) + 1. Returns 1, or 0 if the index of a vertex would not fit
 * into 32 bits. */
SPIN_FN int spin_ntc_level(int level, int base, float growth, int log2_entries,
                           struct spin_ntc_level *out)
{
    float scale = exp2f((float)level * log2f(growth)) * (float)base - 1.0f;
    uint64_t most = (uint64_t)1 << log2_entries, cube;

    if (!(scale >= 0.0f && scale < 2147483648.0f))
        return 0;
    out->scale = scale;
    out->res = (uint32_t)ceilf(scale) + 1u;
    cube = out->res > 2000000u ? (uint64_t)1 << 62 : (uint64_t)out->res * out->res * out->res;
    out->entries = (uint32_t)((cube + 7) / 8 * 8 < most ? (cube + 7) / 8 * 8 : most);
    out->hashed = cube > out->entries;
    return 1;
}

/* The row of vertex q in the table of its level. In a dense level, indices beyond the table wrap
 * around. */
SPIN_FN uint32_t spin_ntc_row(const struct spin_ntc_level *l, const uint32_t q[3])
{
    if (l->hashed)
        return (q[0] ^ (q[1] * 2654435761u) ^ (q[2] * 805459861u)) % l->entries;
    return (q[0] + l->res * (q[1] + l->res * q[2])) % l->entries;
}

/* Rows and weights of the 8 vertices of the cell that contains x in [0, 1]^3. Bit d of the index is
 * set for the upper vertex of axis d. */
SPIN_FN void spin_ntc_corners(const struct spin_ntc_level *l, const float x[3], uint32_t row[8],
                              float weight[8])
{
    uint32_t g[3], q[3];
    float w[3];

    for (int d = 0; d < 3; d++) {
        float p = fmaf(x[d], l->scale, 0.5f), whole = floorf(p);

        g[d] = (uint32_t)whole;
        w[d] = p - whole;
    }
    for (uint32_t c = 0; c < 8; c++) {
        weight[c] = 1.0f;
        for (uint32_t d = 0; d < 3; d++) {
            uint32_t up = c >> d & 1u;

            q[d] = g[d] + up;
            weight[c] *= up ? w[d] : 1.0f - w[d];
        }
        row[c] = spin_ntc_row(l, q);
    }
}
