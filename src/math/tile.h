/* The tiles that an ellipse touches, and its sort key (docs/method.md 4.1, 4.2). */
#pragma once

#include "math/approx.h"
#include "math/portable.h"

#define SPIN_TILE_PX 16

/* v / 16, truncated and clamped to 0..n; also for infinities and NaN (which gives 0). */
SPIN_FN int spin_tile_of(float v, int n)
{
    float t = v * (1.0f / SPIN_TILE_PX);
    return !(t > 0) ? 0 : t >= (float)n ? n : (int)t;
}

/* The tiles of the integer 3-sigma radius, half open. As in 3DGS: other rectangles give other
 * images. */
SPIN_FN void spin_tile_rect(float u_px, float v_px, float radius_px, int tiles_x, int tiles_y,
                            int *x0, int *y0, int *x1, int *y1)
{
    *x0 = spin_tile_of(u_px - radius_px, tiles_x);
    *y0 = spin_tile_of(v_px - radius_px, tiles_y);
    *x1 = spin_tile_of(u_px + radius_px + (SPIN_TILE_PX - 1), tiles_x);
    *y1 = spin_tile_of(v_px + radius_px + (SPIN_TILE_PX - 1), tiles_y);
}

/* Narrows [low, high) to tiles with pixels nearer than `reach` to `at`. Branch-free, so that loops
 * over it vectorise. */
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

/* Positive floats compare like their bits. */
SPIN_FN uint32_t spin_depth_key(float depth) { return spin_bits_of_float(depth); }
