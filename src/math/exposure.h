/* A camera's own colour: gain and offset per channel, picture = exp(m) render + c (Dynamic 3D Gaussians
 * fits the same; its cam_m and cam_c). Training cameras that differ in white balance then do not pull the
 * splats' colours apart; held-out views are drawn with m = 0, c = 0. */
#ifndef SPIN_MATH_EXPOSURE_H
#define SPIN_MATH_EXPOSURE_H

#include "math/portable.h"

SPIN_FN float spin_exposure(float gain, float offset, float v) { return gain * v + offset; }

/* With gain = exp(m): d_m = gain v d, and d_c = d. Returns d_v. */
SPIN_FN float spin_exposure_adj(float gain, float v, float d, float *d_m, float *d_c)
{
    *d_m = gain * v * d;
    *d_c = d;
    return gain * d;
}

#endif
