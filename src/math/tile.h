/* The tiles that an ellipse overlaps, and the key by which splats are sorted front to back
 * (docs/method.md 4.1, 4.2). */
#pragma once

#include "math/approx.h"
#include "math/portable.h"

#define SPIN_TILE_PX 16

/* The tile of pixel coordinate v: v / 16, truncated to an integer and clamped to 0..n. NaN gives 0.
 */
SPIN_FN int spin_tile_of(float v, int n)
{
    float t = v * (1.0f / SPIN_TILE_PX);
    return !(t > 0) ? 0 : t >= (float)n ? n : (int)t;
}

/* Computes the half-open rectangle of tiles, [x0, x1) x [y0, y1), that a square of half side
 * radius_px around (u_px, v_px) overlaps. The formula is that of 3DGS; another one would change the
 * images. */
SPIN_FN void spin_tile_rect(float u_px, float v_px, float radius_px, int tiles_x, int tiles_y,
                            int *x0, int *y0, int *x1, int *y1)
{
    *x0 = spin_tile_of(u_px - radius_px, tiles_x);
    *y0 = spin_tile_of(v_px - radius_px, tiles_y);
    *x1 = spin_tile_of(u_px + radius_px + (SPIN_TILE_PX - 1), tiles_x);
    *y1 = spin_tile_of(v_px + radius_px + (SPIN_TILE_PX - 1), tiles_y);
}

/* Narrows the range of tiles [low, high) along one axis to those that contain a pixel centre within
 * the distance `reach` of `at`, in pixels; pixel centres are integers. If there is no such tile,
 * the range becomes empty. The function has no branches, so that loops over it vectorise. */
SPIN_FN void spin_tile_narrow(float at, float reach, int *low, int *high)
{
    float first = ceilf(at - reach), last = floorf(at + reach);
    int none = !(first <= last) | (last < 0);
    int a = spin_tile_of(first, *high), b = spin_tile_of(last, *high - 1) + 1;

    a = a > *low ? a : *low;
    b = b < *high ? b : *high;
    a = none ? *low : a < b ? a : b;
    *high = none ? *low : b;
    *low = a;
}

/* The sort key of a positive depth: the bits of positive floats have the same order as the
 * floats. */
SPIN_FN uint32_t spin_depth_key(float depth) { return spin_bits_of_float(depth); }
