/* The multi-resolution 4-D hash grid of DASH: the sizes of its levels, and the row of each vertex
 * in the table of features (chenj02/DASH 0898b2d; docs/method.md 3.3).
 *
 * Vertex k = 0, 1, ... along an axis is at position k / scale. The 16 corners of a cell are
 * numbered 0..15: bit d of the number is set for the upper vertex of axis d. The interpolation
 * weight of a corner is the product of the smoothstep weights of the four axes. */
#pragma once

#include "math/portable.h"

/* The factors of the spatial hash. The factor of x is 1, so that neighbours in x usually share a
 * cache line. */
#define SPIN_GRID_PRIME_X 1u
#define SPIN_GRID_PRIME_Y 2654435761u
#define SPIN_GRID_PRIME_Z 805459861u
#define SPIN_GRID_PRIME_T 3674653429u

/* Weight of the upper vertex for a point at r in [0, 1] within a cell, and the derivative of this
 * weight with respect to r. */
SPIN_FN float spin_smoothstep(float r) { return r * r * (3.0f - 2.0f * r); }
SPIN_FN float spin_smoothstep_slope(float r) { return 6.0f * r * (1.0f - r); }

SPIN_FN uint32_t spin_grid_hash(const uint32_t q[4])
{
    return (q[0] * SPIN_GRID_PRIME_X) ^ (q[1] * SPIN_GRID_PRIME_Y) ^ (q[2] * SPIN_GRID_PRIME_Z) ^
           (q[3] * SPIN_GRID_PRIME_T);
}

/* Returns 1 if a level has more vertices than rows, so that vertices must share rows by hashing;
 * otherwise the level is dense. The number of vertices is computed in 64 bits: in 32 bits, 2048^3
 * would wrap to 0, and the level would be considered dense. */
SPIN_FN int spin_grid_is_hashed(const uint32_t res[4], uint64_t rows)
{
    uint64_t product = 1;

    for (int d = 0; d < 4; d++) {
        product *= res[d];
        if (product > rows)
            return 1;
    }
    return 0;
}

/* The row of vertex q, 0..rows - 1, within its level. */
SPIN_FN uint32_t spin_grid_row(const uint32_t q[4], const uint32_t res[4], uint32_t rows,
                               int hashed)
{
    if (hashed)
        return spin_grid_hash(q) % rows;
    return (q[0] + res[0] * (q[1] + res[1] * (q[2] + res[2] * q[3]))) % rows;
}

/* Geometry of one level of a network trained by spin4d (docs/method.md 3.3). Along an axis, the
 * number of vertices n grows geometrically from `base` in the first level to `finest` in the last
 * level; a single level has n = base. n is a real number: scale = n - 1, and res is n rounded up,
 * where 1e-9 is subtracted first so that rounding errors do not add a vertex. Returns the number of
 * rows: min(2^log2_rows, product of res). */
SPIN_FN uint64_t spin_grid_level(int level, int n_levels, const int base[4], const int finest[4],
                                 int log2_rows, float scale[4], uint32_t res[4], int *hashed)
{
    uint64_t most = (uint64_t)1 << log2_rows, product = 1;

    for (int d = 0; d < 4; d++) {
        double n = base[d];

        if (level > 0 && level == n_levels - 1)
            n = finest[d];
        else if (level > 0)
            n *= pow((double)finest[d] / base[d], (double)level / (n_levels - 1));
        scale[d] = (float)(n - 1.0);
        res[d] = (uint32_t)ceil(n - 1.0 - 1e-9) + 1u;
    }
    *hashed = spin_grid_is_hashed(res, most);
    if (*hashed)
        return most;
    for (int d = 0; d < 4; d++)
        product *= res[d];
    return product;
}

/* Geometry of one level of an imported network (DASH, Grid4D), from the growth and base of each
 * axis, which are stored with the network as float32. The intermediate results are rounded to float
 * exactly as in the method's kernel, since a difference of one unit in the last place can turn a
 * dense level into a hashed one. A grid of n_dims < 4 axes has one vertex along each missing axis,
 * which affects neither rows nor hashes. Returns 1, or 0 if growth, base or the resulting scale is
 * out of range. */
SPIN_FN int spin_grid_stored_level(int level, int n_dims, const float *growth, const float *base,
                                   float scale[4], uint32_t res[4])
{
    for (int d = 0; d < 4; d++) {
        float log_growth, e;

        scale[d] = 0.0f;
        res[d] = 1;
        if (d >= n_dims)
            continue;
        if (!(growth[d] > 0.0f && base[d] > 0.0f))
            return 0;
        log_growth = (float)log2((double)growth[d]);
        e = (float)exp2((double)((float)level * log_growth));
        scale[d] = (float)((double)e * (double)base[d] - 1.0);
        if (!(scale[d] >= 0.0f && scale[d] < 1e9f))
            return 0;
        res[d] = (uint32_t)ceilf(scale[d]) + 1u;
    }
    return 1;
}
