/* The appearance model of a camera: image = min(exp(m) (1 + c1 r^2 + c2 r^4) render + offset, 1),
 * for each channel. Gain exp(m) and offset belong to the camera (Dynamic 3D Gaussians fits the same
 * as cam_m and cam_c). The falloff c1, c2 belongs to the lens, which cameras of one kind share; r
 * is the distance from the principal point in half image widths. Captured images are clipped at
 * white. The model keeps white balance and dark corners out of the splats. Held-out views are
 * rendered with the falloff, m = 0 and offset 0. */
#pragma once

#include "math/portable.h"

/* r^2 of a pixel, whose centre is at (x + 0.5, y + 0.5). */
SPIN_FN float spin_lens_r2(int x, int y, float cx, float cy, float half_width)
{
    float dx = ((float)x + 0.5f - cx) / half_width, dy = ((float)y + 0.5f - cy) / half_width;

    return dx * dx + dy * dy;
}

SPIN_FN float spin_falloff(float c1, float c2, float r2) { return 1 + r2 * (c1 + r2 * c2); }

/* gain: exp(m) times the falloff. */
SPIN_FN float spin_exposure(float gain, float offset, float v)
{
    float out = gain * v + offset;

    return out < 1 ? out : 1;
}

/* Contributions of one pixel's gradient d to the gradients of m, offset, c1 and c2. */
struct spin_exposure_slopes {
    float m, offset, c1, c2;
};

/* gain: exp(m), without the falloff. Returns the gradient of v. All are 0 if the pixel is clipped
 * at 1. */
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
