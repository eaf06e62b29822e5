/* What deformation networks do to a canonical Gaussian (4dgaussian.md 3, grid4d.md 4). */
#ifndef SPIN_MATH_DEFORM_H
#define SPIN_MATH_DEFORM_H

#include "math/portable.h"

/* Hamilton product a b of quaternions w, x, y, z; out is neither of them. */
SPIN_FN void spin_quat_product(const float a[4], const float b[4], float out[4])
{
    out[0] = a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3];
    out[1] = a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2];
    out[2] = a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1];
    out[3] = a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0];
}

/* Rotate p about the world's origin by a quaternion of any length but zero. */
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

/* The covariance that the 3DGS rasteriser forms from a quaternion it takes to be of unit length
 * when it is not: its R is then no rotation, and no pair of unit quaternion and same scales gives
 * this ellipsoid. cov6: xx xy xz yy yz zz of (R S) (R S)^T. */
SPIN_FN void spin_covariance_unnormalised(const double scale[3], const double q[4], double cov6[6])
{
    double w = q[0], x = q[1], y = q[2], z = q[3];
    double r[9] = {1 - 2 * (y * y + z * z), 2 * (x * y - w * z),     2 * (x * z + w * y),
                   2 * (x * y + w * z),     1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
                   2 * (x * z - w * y),     2 * (y * z + w * x),     1 - 2 * (x * x + y * y)};
    int at = 0;

    for (int i = 0; i < 3; i++) {
        for (int j = i; j < 3; j++) {
            cov6[at] = 0;
            for (int k = 0; k < 3; k++)
                cov6[at] += r[3 * i + k] * scale[k] * scale[k] * r[3 * j + k];
            at++;
        }
    }
}

#endif
