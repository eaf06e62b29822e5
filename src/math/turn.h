/* The contribution of a dynamic track to a splat whose surface has rotated by the unit quaternion q
 * since the reference frame of the track: displacement d becomes R(q) d, and rotation r becomes q
 * r. Both maps are orthogonal, so the adjoint of each is the same map with the inverse rotation. */
#pragma once

#include "math/quat.h"

/* Rotates a displacement (width 3) or a rotation (width 4). out must differ from in. */
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
