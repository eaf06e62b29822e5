/* A camera's own look: picture = min(exp(m) (1 + c1 r^2 + c2 r^4) render + offset, 1), each channel
 * by itself. Gain and offset are the camera's (Dynamic 3D Gaussians fits the same; its cam_m and
 * cam_c). The falloff c1, c2 is that of the lens, shared by cameras of one kind; r is the distance
 * from the principal point in halves of the picture's width. White is the brightest that a
 * photograph shows. So splats need not paint a camera's white balance and its dark corners into the
 * scene. Held-out views are drawn with the falloff, m = 0 and offset 0. */
#pragma once

#include "math/portable.h"

/* r^2 of a pixel: its middle is at (x + 0.5, y + 0.5). */
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

/* What one pixel's slope d gives to the slopes of m, offset, c1 and c2. */
struct spin_exposure_slopes {
    float m, offset, c1, c2;
};

/* gain: exp(m), without the falloff. Returns the slope of v. Beyond white all are 0. */
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
