/* Rotates the values that a dynamic track shares among its frames by the unit quaternion q, the
 * rotation of the splat's surface since the track's reference frame: displacement d becomes R(q) d,
 * and rotation r becomes q r. Both maps are orthogonal, so the adjoint of each is the same map with
 * the inverse rotation. */
#pragma once

#include "math/quat.h"

/* Rotates a displacement (width 3) or a rotation (width 4). out must not be in. */
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
