/* The displacement and rotation that a dynamic track contributes to a splat if the surface has
 * rotated by the unit quaternion q since the track's own frame: R(q) d and q r. Both maps are
 * orthogonal, so the adjoint is the inverse rotation. */
#pragma once

#include "math/quat.h"

/* width 3: a displacement; 4: a rotation. out must differ from in. */
SPIN_FN void spin_turn(const float q[4], int width, const float *in, float *out)
{
    if (width == 3)
        spin_quat_rotate(q, in, out);
    else
        spin_quat_product(q, in, out);
}

SPIN_FN void spin_turn_adj(const float q[4], int width, const float *in, float *out)
{
    float back[4] = {q[0], -q[1], -q[2], -q[3]};

    spin_turn(back, width, in, out);
}
