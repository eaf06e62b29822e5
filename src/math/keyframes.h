/* Interpolation of positions and rotations between key frames, and the fading of opacity before and
 * after the time in which a splat is visible (Ex4DGS, Lee et al., NeurIPS 2024). */
#pragma once

#include "math/quat.h"

enum keyframes_kind { KEYFRAMES_LINEAR, KEYFRAMES_CUBE, KEYFRAMES_PCHIP };

/* A time between two key frames. CUBE and PCHIP interpolation also read the key frame before and
 * the key frame after these two. */
struct keyframes {
    enum keyframes_kind kind;
    int key;     /* the last key frame before the time */
    double part; /* fraction of the way to the next key frame, 0 to 1 */
    double time; /* in units of key frames: key + part */
};

/* The derivative of a curve at a key frame, per key frame interval. before: the value at this key
 * frame minus that at the previous one; after: the value at the next key frame minus that at this
 * one. CUBE: the mean of `before` and `after`. PCHIP (Fritsch and Butland, 1984): the harmonic mean
 * of both, or 0 if their signs differ. */
SPIN_FN double spin_keyframes_slope(enum keyframes_kind kind, double before, double after)
{
    if (kind == KEYFRAMES_CUBE)
        return (before + after) / 2;
    return before * after > 0 ? 2 * before * after / (before + after) : 0;
}

/* Computes the coefficients c of the curve from key frame `at` to the next, whose value is the sum
 * of c[i] u^i for u from 0 to 1. y[step * k]: value of key frame k. */
SPIN_FN void spin_keyframes_cubic(enum keyframes_kind kind, int at, const float *y, int step,
                                  double c[4])
{
    const float *key = y + (long)step * at;
    double from = key[0], rise = key[step] - from, m[2] = {rise, rise};

    if (kind != KEYFRAMES_LINEAR) {
        m[0] = spin_keyframes_slope(kind, from - key[-step], rise);
        m[1] = spin_keyframes_slope(kind, rise, (double)key[2 * step] - key[step]);
    }
    c[0] = from;
    c[1] = m[0];
    c[2] = 3 * rise - 2 * m[0] - m[1];
    c[3] = m[0] + m[1] - 2 * rise;
}

SPIN_FN double spin_keyframes_value(const struct keyframes *at, const float *y, int step)
{
    double c[4], u = at->part;

    spin_keyframes_cubic(at->kind, at->key, y, step, c);
    return c[0] + u * (c[1] + u * (c[2] + u * c[3]));
}

/* Spherical linear interpolation (Shoemake, 1985) between key frames. quats + 4 k: quaternion of
 * key frame k, of any length except zero. out has unit length. As in the method, the signs of the
 * quaternions are not aligned: if their dot product is negative, the interpolation follows the
 * longer arc. If the weighted sum of the two quaternions is zero, the result is the first
 * quaternion. */
SPIN_FN void spin_keyframes_turn(const struct keyframes *at, const float *quats, float out[4])
{
    double q[2][4], dot = 0, angle, w[2], sum = 0;

    for (int k = 0; k < 2; k++)
        spin_unit_quat(quats + 4 * (at->key + k), q[k]);
    for (int c = 0; c < 4; c++)
        dot += q[0][c] * q[1][c];
    angle = acos(fmin(fmax(dot, -1 + 1e-4), 1 - 1e-4));
    w[0] = sin((1 - at->part) * angle);
    w[1] = sin(at->part * angle);
    for (int c = 0; c < 4; c++) {
        out[c] = (float)((w[0] * q[0][c] + w[1] * q[1][c]) / (w[0] + w[1]));
        sum += fabs((double)out[c]);
    }
    for (int c = 0; c < 4 && sum <= 1e-4; c++)
        out[c] = (float)q[0][c];
    spin_quat_normalise(out);
}

/* The factor on a splat's opacity, 0 to 1. times: start and end of full visibility in units of key
 * frames, in any order. log_width: natural log of the width of the fade before the start and of the
 * fade after the end, in the same unit; least_width is added to both widths. As in the method, both
 * fades are Gaussians centred at the later of the two times, so the factor jumps at the earlier
 * time. */
SPIN_FN double spin_keyframes_visibility(const struct keyframes *at, const float times[2],
                                         const float log_width[2], double least_width)
{
    double low = fmin(times[0], times[1]), high = fmax(times[0], times[1]), x;

    if (at->time > low && at->time < high)
        return 1;
    x = (at->time - high) / (exp(log_width[at->time >= high]) + least_width);
    return exp(-x * x);
}
