/* The appearance model of a camera: for each colour channel, image = min(exp(m) (1 + c1 r^2 + c2
 * r^4) render + offset, 1). With it, splats need not learn white balance and dark image corners.
 *
 * Each camera has its own m and offset, like cam_m and cam_c of Dynamic 3D Gaussians. The
 * coefficients c1 and c2 of the falloff belong to a lens, which all cameras of one kind share. r is
 * the distance from the principal point in half image widths. The minimum models the clipping of
 * captured images at white. Held-out views are rendered with the falloff, but with m = 0 and offset
 * = 0. */
#pragma once

#include "math/portable.h"

/* r^2 at the centre of a pixel, (x + 0.5, y + 0.5). */
SPIN_FN float spin_lens_r2(int x, int y, float cx, float cy, float half_width)
{
    float dx = ((float)x + 0.5f - cx) / half_width, dy = ((float)y + 0.5f - cy) / half_width;

    return dx * dx + dy * dy;
}

SPIN_FN float spin_falloff(float c1, float c2, float r2) { return 1 + r2 * (c1 + r2 * c2); }

/* Applies the model to value v. gain: exp(m) times the falloff. */
SPIN_FN float spin_exposure(float gain, float offset, float v)
{
    float out = gain * v + offset;

    return out < 1 ? out : 1;
}

/* Gradients of m, offset, c1 and c2 through one pixel; the caller sums them over pixels. */
struct spin_exposure_slopes {
    float m, offset, c1, c2;
};

/* Adjoint of spin_exposure(). gain: exp(m), here without the falloff; d: gradient of the result.
 * Sets *s and returns the gradient of v. All gradients are 0 if the pixel is clipped at 1. */
SPIN_FN float spin_exposure_adj(float gain, float falloff, float offset, float r2, float v, float d,
                                struct spin_exposure_slopes *s)
{
    float whole = gain * falloff, seen = whole * v + offset < 1 ? d : 0;

    s->m = whole * v * seen;
    s->offset = seen;
    s->c1 = gain * v * seen * r2;
    s->c2 = s->c1 * r2;
    return whole * seen;
}
