/* Rotates a scene: positions, rotations and spherical harmonics.
 *
 * The colour f(d) in direction d before a rotation R is the colour f'(R d) in direction R d after
 * it. With real harmonics Y that are orthonormal over the sphere, the coefficients c become
 *     c'_m = sum_n c_n integral Y_m(R d) Y_n(d) dd,
 * where the sum is over the functions n of the same degree as m, and the integral is over all
 * directions d. The product of two functions of degree 3 is a polynomial of degree 6, for which a
 * quadrature with 4 Gauss-Legendre nodes in z times 8 equidistant angles around the z axis is
 * exact. */
#pragma once

#include "math/quat.h"
#include "math/sh.h"

enum spin_scene_rotation_kind {
    SPIN_TURN_NONE,
    SPIN_TURN_SIGNS, /* half a turn about x, y or z: only changes signs, without rounding */
    SPIN_TURN_ANY
};

struct spin_scene_rotation {
    enum spin_scene_rotation_kind kind;
    float q[4];                         /* w x y z */
    float m[9];                         /* [3][3] */
    float sh[SPIN_SH_MAX][SPIN_SH_MAX]; /* matrix for the SH coefficients */
};

/* out = b a: rotation a followed by rotation b, as unit quaternions w x y z. */
SPIN_FN void spin_scene_rotation_join(const double *a, const double *b, double *out)
{
    double w = b[0] * a[0] - b[1] * a[1] - b[2] * a[2] - b[3] * a[3];
    double x = b[0] * a[1] + b[1] * a[0] + b[2] * a[3] - b[3] * a[2];
    double y = b[0] * a[2] - b[1] * a[3] + b[2] * a[0] + b[3] * a[1];
    double z = b[0] * a[3] + b[1] * a[2] - b[2] * a[1] + b[3] * a[0];

    out[0] = w;
    out[1] = x;
    out[2] = y;
    out[3] = z;
}

/* Rounds x to 0, 1 or -1 if it differs by less than 2e-6, so that half turns are recognised despite
 * rounding errors. */
SPIN_FN float spin_scene_rotation_snap(double x)
{
    double a = x < 0 ? -x : x;

    if (a < 2e-6)
        return 0;
    if (a > 1 - 2e-6 && a < 1 + 2e-6)
        return x < 0 ? -1 : 1;
    return (float)x;
}

SPIN_FN spin_vec3 spin_scene_rotation_place(const struct spin_scene_rotation *t, spin_vec3 p)
{
    return spin_v3(t->m[0] * p.x + t->m[1] * p.y + t->m[2] * p.z,
                   t->m[3] * p.x + t->m[4] * p.y + t->m[5] * p.z,
                   t->m[6] * p.x + t->m[7] * p.y + t->m[8] * p.z);
}

SPIN_FN void spin_scene_rotation_sh_matrix(struct spin_scene_rotation *t)
{
    const float node[4] = {-0.8611363115940526f, -0.3399810435848563f, 0.3399810435848563f,
                           0.8611363115940526f};
    const float weight[4] = {0.3478548451374538f, 0.6521451548625461f, 0.6521451548625461f,
                             0.3478548451374538f};
    double sum[SPIN_SH_MAX][SPIN_SH_MAX] = {{0}};

    for (int i = 0; i < 32; i++) {
        float z = node[i / 8], r = sqrtf(1 - z * z), angle = 0.7853981633974483f * (float)(i % 8);
        spin_vec3 d = spin_v3(r * cosf(angle), r * sinf(angle), z);
        float before[SPIN_SH_MAX], after[SPIN_SH_MAX];

        spin_sh_basis(3, d, before);
        spin_sh_basis(3, spin_scene_rotation_place(t, d), after);
        for (int m = 0; m < SPIN_SH_MAX; m++)
            for (int n = 0; n < SPIN_SH_MAX; n++)
                sum[m][n] += 0.7853981633974483 * (double)weight[i / 8] * (double)after[m] *
                             (double)before[n];
    }
    for (int m = 0; m < SPIN_SH_MAX; m++)
        for (int n = 0; n < SPIN_SH_MAX; n++)
            t->sh[m][n] = spin_scene_rotation_snap(sum[m][n]);
}

/* Initialises *t from a unit quaternion w x y z. */
SPIN_FN void spin_scene_rotation_from(const double *q, struct spin_scene_rotation *t)
{
    double w = q[0], x = q[1], y = q[2], z = q[3];
    const double m[9] = {1 - 2 * (y * y + z * z), 2 * (x * y - w * z),     2 * (x * z + w * y),
                         2 * (x * y + w * z),     1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
                         2 * (x * z - w * y),     2 * (y * z + w * x),     1 - 2 * (x * x + y * y)};
    int signs = 1, same = 1;

    for (int i = 0; i < 4; i++)
        t->q[i] = (float)q[i];
    for (int i = 0; i < 9; i++) {
        t->m[i] = spin_scene_rotation_snap(m[i]);
        signs &= t->m[i] == 0 || (i % 4 == 0 && (t->m[i] == 1 || t->m[i] == -1));
        same &= t->m[i] == (i % 4 == 0 ? 1.0f : 0.0f);
    }
    t->kind = same ? SPIN_TURN_NONE : signs ? SPIN_TURN_SIGNS : SPIN_TURN_ANY;
    spin_scene_rotation_sh_matrix(t);
}

/* Rotates the rotation q of a splat, a unit quaternion w x y z. */
SPIN_FN void spin_scene_rotation_quat(const struct spin_scene_rotation *t, const float *q,
                                      float *out)
{
    const float from[4] = {q[0], q[1], q[2], q[3]};

    spin_quat_product(t->q, from, out);
}

/* Rotates SH coefficients [n][3]. n: number of functions up to a degree: 1, 4, 9 or 16. out must
 * not be sh. */
SPIN_FN void spin_scene_rotation_sh(const struct spin_scene_rotation *t, int n, const float *sh,
                                    float *out)
{
    for (int m = 0, low = 0, high = 1; m < n; m++) {
        float sum[3] = {0, 0, 0};

        if (m == high) { /* begin the next degree l, which has 2 l + 1 functions */
            int width = high - low + 2;

            low = high;
            high += width;
        }
        if (t->kind == SPIN_TURN_SIGNS) {
            for (int c = 0; c < 3; c++)
                out[3 * m + c] = t->sh[m][m] * sh[3 * m + c];
            continue;
        }
        for (int k = low; k < high; k++)
            for (int c = 0; c < 3; c++)
                sum[c] += t->sh[m][k] * sh[3 * k + c];
        for (int c = 0; c < 3; c++)
            out[3 * m + c] = sum[c];
    }
}
