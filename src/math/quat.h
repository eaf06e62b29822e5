/* Quaternions in the order w x y z: length, normalisation, product, rotation of a point. */
#pragma once

#include "math/portable.h"

/* The length of q, computed in double, in which the squares of floats neither overflow nor
 * underflow. */
SPIN_FN double spin_quat_norm(const float q[4])
{
    return sqrt((double)q[0] * q[0] + (double)q[1] * q[1] + (double)q[2] * q[2] +
                (double)q[3] * q[3]);
}

/* Normalises q in place. The zero quaternion becomes the identity. */
SPIN_FN void spin_quat_normalise(float q[4])
{
    double norm = spin_quat_norm(q);

    for (int i = 0; i < 4; i++)
        q[i] = norm > 0 ? (float)(q[i] / norm) : (float)(i == 0);
}

/* Normalises a quaternion, with a result in double. The zero quaternion becomes NaN. */
SPIN_FN void spin_unit_quat(const float in[4], double out[4])
{
    double norm = spin_quat_norm(in);

    for (int i = 0; i < 4; i++)
        out[i] = norm > 0 ? in[i] / norm : NAN;
}

/* Hamilton product a b. out must differ from a and b. */
SPIN_FN void spin_quat_product(const float a[4], const float b[4], float out[4])
{
    out[0] = a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3];
    out[1] = a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2];
    out[2] = a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1];
    out[3] = a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0];
}

/* Rotates p about the origin by a quaternion of any length except zero. */
SPIN_FN void spin_quat_rotate(const float q[4], const float p[3], float out[3])
{
    float w = q[0], x = q[1], y = q[2], z = q[3];
    float s = 2.0f / (w * w + x * x + y * y + z * z);

    out[0] =
        (1 - s * (y * y + z * z)) * p[0] + s * (x * y - z * w) * p[1] + s * (x * z + y * w) * p[2];
    out[1] =
        s * (x * y + z * w) * p[0] + (1 - s * (x * x + z * z)) * p[1] + s * (y * z - x * w) * p[2];
    out[2] =
        s * (x * z - y * w) * p[0] + s * (y * z + x * w) * p[1] + (1 - s * (x * x + y * y)) * p[2];
}

/* These functions rotate the values that a dynamic track shares among its frames by the unit
 * quaternion q, the rotation of the splat's surface since the track's reference frame: displacement
 * d becomes R(q) d, and rotation r becomes q r. Both maps are orthogonal, so the adjoint of each is
 * the same map with the inverse rotation. */

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
