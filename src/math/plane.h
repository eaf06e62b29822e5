/* Bilinear lookup in feature planes and trilinear lookup in feature grids (K-planes and HexPlane;
 * hustvl/4DGaussians 843d5ac).
 *
 * As with PyTorch's align_corners=True, coordinate -1 is the first sample of an axis and 1 the
 * last. Positions outside a plane are clamped to its border. */
#pragma once

#include <stddef.h>

#include "math/portable.h"

/* The two samples of one axis between which a lookup interpolates, and the fraction r: value = (1 -
 * r) sample[low] + r sample[high]. */
struct spin_plane_axis {
    int low, high;
    float r;
};

/* Finds the samples and the fraction for coordinate u on an axis of `size` samples. In units of
 * samples, u is at (u + 1) / 2 (size - 1). */
SPIN_FN struct spin_plane_axis spin_plane_axis(float u, int size)
{
    struct spin_plane_axis a;
    float last = (float)(size - 1);
    float at = (u + 1.0f) * 0.5f * last;

    at = spin_minf(spin_maxf(at, 0.0f), last);
    a.low = (int)at;
    a.high = a.low + 1 < size ? a.low + 1 : a.low;
    a.r = at - (float)a.low;
    return a;
}

/* Interpolates a plane [height][width][n] at (column, row). Sets out [n] to the result or, if
 * `multiply` is not 0, multiplies the elements of out by those of the result. */
SPIN_FN void spin_plane_lookup(const float *SPIN_RESTRICT plane, int width, int n,
                               struct spin_plane_axis column, struct spin_plane_axis row,
                               int multiply, float *SPIN_RESTRICT out)
{
    const float *SPIN_RESTRICT a = plane + ((size_t)row.low * width + column.low) * n;
    const float *SPIN_RESTRICT b = plane + ((size_t)row.low * width + column.high) * n;
    const float *SPIN_RESTRICT c = plane + ((size_t)row.high * width + column.low) * n;
    const float *SPIN_RESTRICT d = plane + ((size_t)row.high * width + column.high) * n;
    float wa = (1.0f - column.r) * (1.0f - row.r), wb = column.r * (1.0f - row.r);
    float wc = (1.0f - column.r) * row.r, wd = column.r * row.r;

    if (multiply) {
        for (int i = 0; i < n; i++)
            out[i] *= wa * a[i] + wb * b[i] + wc * c[i] + wd * d[i];
    } else {
        for (int i = 0; i < n; i++)
            out[i] = wa * a[i] + wb * b[i] + wc * c[i] + wd * d[i];
    }
}

/* Trilinear lookup in a grid [n][n][n] with x as the first dimension. u: position in samples.
 * Samples outside the grid are 0. */
SPIN_FN float spin_voxel_lookup(const float *grid, int n, const float u[3])
{
    float sum = 0.0f;
    int low[3];

    for (int d = 0; d < 3; d++) {
        if (!(u[d] > -1.0f && u[d] < (float)n))
            return 0.0f;
        low[d] = (int)floorf(u[d]);
    }
    for (int k = 0; k < 8; k++) {
        float weight = 1.0f;
        int inside = 1, at = 0;

        for (int d = 0; d < 3; d++) {
            int bit = k >> d & 1, q = low[d] + bit;
            float r = u[d] - (float)low[d];

            weight *= bit ? r : 1.0f - r;
            inside = inside && q >= 0 && q < n;
            at = at * n + q;
        }
        if (inside)
            sum += weight * grid[at];
    }
    return sum;
}
