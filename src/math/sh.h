/* Real spherical harmonics up to degree 3, in the order and with the signs of 3DGS (docs/method.md
 * 4.1). Coefficient k of channel c is sh[3 k + c]. */
#pragma once

#include "math/portable.h"

#define SPIN_SH_MAX 16 /* number of basis functions up to degree 3 */

#define SPIN_SH_C0 0.28209479177387814
#define SPIN_SH_C1 0.4886025119029199f
#define SPIN_SH_C2A 1.0925484305920792f
#define SPIN_SH_C2B 0.31539156525252005f
#define SPIN_SH_C2C 0.5462742152960396f
#define SPIN_SH_C3A 0.5900435899266435f
#define SPIN_SH_C3B 2.890611442640554f
#define SPIN_SH_C3C 0.4570457994644658f
#define SPIN_SH_C3D 0.3731763325901154f
#define SPIN_SH_C3E 1.445305721320277f

/* Number of basis functions up to a degree. */
SPIN_FN int spin_sh_count(int degree) { return (degree + 1) * (degree + 1); }

/* Sets basis [16] to the values of the basis functions at unit direction d. Functions of a higher
 * degree than `degree` are set to 0. */
SPIN_FN void spin_sh_basis(int degree, spin_vec3 d, float *basis)
{
    float x = d.x, y = d.y, z = d.z;
    float xx = x * x, yy = y * y, zz = z * z;

    for (int k = 0; k < SPIN_SH_MAX; k++)
        basis[k] = 0;
    basis[0] = (float)SPIN_SH_C0;
    if (degree < 1)
        return;
    basis[1] = -SPIN_SH_C1 * y;
    basis[2] = SPIN_SH_C1 * z;
    basis[3] = -SPIN_SH_C1 * x;
    if (degree < 2)
        return;
    basis[4] = SPIN_SH_C2A * x * y;
    basis[5] = -SPIN_SH_C2A * y * z;
    basis[6] = SPIN_SH_C2B * (2 * zz - xx - yy);
    basis[7] = -SPIN_SH_C2A * x * z;
    basis[8] = SPIN_SH_C2C * (xx - yy);
    if (degree < 3)
        return;
    basis[9] = -SPIN_SH_C3A * y * (3 * xx - yy);
    basis[10] = SPIN_SH_C3B * x * y * z;
    basis[11] = -SPIN_SH_C3C * y * (4 * zz - xx - yy);
    basis[12] = SPIN_SH_C3D * z * (2 * zz - 3 * xx - 3 * yy);
    basis[13] = -SPIN_SH_C3C * x * (4 * zz - xx - yy);
    basis[14] = SPIN_SH_C3E * z * (xx - yy);
    basis[15] = -SPIN_SH_C3A * x * (xx - 3 * yy);
}

/* The gradient of the sum of weight[k] * basis[k] with respect to d, whose three components count
 * as independent: d is not constrained to unit length. */
SPIN_FN spin_vec3 spin_sh_slope(int degree, spin_vec3 d, const float *weight)
{
    const float *w = weight;
    float x = d.x, y = d.y, z = d.z;
    float xx = x * x, yy = y * y, zz = z * z;
    spin_vec3 g = spin_v3(0, 0, 0);

    if (degree < 1)
        return g;
    g.x = -SPIN_SH_C1 * w[3];
    g.y = -SPIN_SH_C1 * w[1];
    g.z = SPIN_SH_C1 * w[2];
    if (degree < 2)
        return g;
    g.x += SPIN_SH_C2A * (y * w[4] - z * w[7]) - 2 * SPIN_SH_C2B * x * w[6] +
           2 * SPIN_SH_C2C * x * w[8];
    g.y += SPIN_SH_C2A * (x * w[4] - z * w[5]) - 2 * SPIN_SH_C2B * y * w[6] -
           2 * SPIN_SH_C2C * y * w[8];
    g.z += -SPIN_SH_C2A * (y * w[5] + x * w[7]) + 4 * SPIN_SH_C2B * z * w[6];
    if (degree < 3)
        return g;
    g.x += -SPIN_SH_C3A * (6 * x * y * w[9] + 3 * (xx - yy) * w[15]) + SPIN_SH_C3B * y * z * w[10] +
           SPIN_SH_C3C * (2 * x * y * w[11] - (4 * zz - 3 * xx - yy) * w[13]) -
           SPIN_SH_C3D * 6 * x * z * w[12] + SPIN_SH_C3E * 2 * x * z * w[14];
    g.y += -SPIN_SH_C3A * (3 * (xx - yy) * w[9] - 6 * x * y * w[15]) + SPIN_SH_C3B * x * z * w[10] +
           SPIN_SH_C3C * (2 * x * y * w[13] - (4 * zz - xx - 3 * yy) * w[11]) -
           SPIN_SH_C3D * 6 * y * z * w[12] - SPIN_SH_C3E * 2 * y * z * w[14];
    g.z += SPIN_SH_C3B * x * y * w[10] - SPIN_SH_C3C * 8 * z * (y * w[11] + x * w[13]) +
           SPIN_SH_C3D * (6 * zz - 3 * xx - 3 * yy) * w[12] + SPIN_SH_C3E * (xx - yy) * w[14];
    return g;
}

/* Sets colour [3] to max(0, SH(d) + 0.5). In the result, bit c is set if channel c was clamped to
 * 0. */
SPIN_FN unsigned spin_sh_colour(int degree, spin_vec3 d, const float *sh, float *colour)
{
    float basis[SPIN_SH_MAX], sum[3] = {0.5f, 0.5f, 0.5f};
    int n = spin_sh_count(degree);
    unsigned clamped = 0;

    spin_sh_basis(degree, d, basis);
    for (int k = 0; k < n; k++)
        for (int c = 0; c < 3; c++)
            sum[c] += basis[k] * sh[3 * k + c];
    for (int c = 0; c < 3; c++) {
        clamped |= (unsigned)(sum[c] < 0) << c;
        colour[c] = spin_maxf(sum[c], 0);
    }
    return clamped;
}

/* Adjoint of spin_sh_colour(): adds the gradient of the coefficients to d_sh [48], and returns the
 * gradient of d. d_colour [3]: gradient of the colour; the caller must have set clamped channels to
 * 0. */
SPIN_FN spin_vec3 spin_sh_colour_adj(int degree, spin_vec3 d, const float *sh,
                                     const float *d_colour, float *d_sh)
{
    float basis[SPIN_SH_MAX], weight[SPIN_SH_MAX] = {0};
    int n = spin_sh_count(degree);

    spin_sh_basis(degree, d, basis);
    for (int k = 0; k < n; k++) {
        for (int c = 0; c < 3; c++) {
            d_sh[3 * k + c] += basis[k] * d_colour[c];
            weight[k] += sh[3 * k + c] * d_colour[c];
        }
    }
    return spin_sh_slope(degree, d, weight);
}
