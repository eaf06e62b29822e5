/* What a splat has of its moving track where the surface has turned by the unit quaternion q since
 * the track's own frame: the displacement R(q) d and the rotation q r. Both are orthogonal maps, so
 * the adjoint turns back. */
#pragma once

#include "math/quat.h"

/* width 3: a displacement; 4: a rotation. out is not in. */
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
