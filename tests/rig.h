/* Cameras by where they stand and what lies to their right, below and ahead, for tests that work
 * out by themselves what is seen. */
#ifndef SPIN_TESTS_RIG_H
#define SPIN_TESTS_RIG_H

#include <math.h>
#include <string.h>

#include "spin.h"

/* A camera as it stands in the world. */
struct pose {
    double eye[3], right[3], down[3], ahead[3];
};

static double dot(const double a[3], const double b[3])
{
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

static void across(const double a[3], const double b[3], double out[3])
{
    double c[3] = {a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]};

    memcpy(out, c, sizeof c);
}

static void make_long(double v[3], double length)
{
    double k = length / sqrt(dot(v, v));

    for (int c = 0; c < 3; c++)
        v[c] *= k;
}

/* At eye, towards target, with this up as far as it may be, then rolled about its axis. */
static struct pose pose_towards(const double eye[3], const double target[3], const double up[3],
                                double roll)
{
    struct pose p;
    double right[3], down[3];

    for (int c = 0; c < 3; c++) {
        p.eye[c] = eye[c];
        p.ahead[c] = target[c] - eye[c];
    }
    make_long(p.ahead, 1);
    across(p.ahead, up, right);
    make_long(right, 1);
    across(p.ahead, right, down);
    for (int c = 0; c < 3; c++) {
        p.right[c] = cos(roll) * right[c] + sin(roll) * down[c];
        p.down[c] = cos(roll) * down[c] - sin(roll) * right[c];
    }
    return p;
}

static struct spin_camera camera_of(struct spin_camera lens, const struct pose *p)
{
    const double *axis[3] = {p->right, p->down, p->ahead};

    for (int r = 0; r < 3; r++) {
        memcpy(lens.w2c + 4 * r, axis[r], sizeof p->right);
        lens.w2c[4 * r + 3] = -dot(axis[r], p->eye);
    }
    return lens;
}

#endif
