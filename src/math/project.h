/* The projection of a Gaussian to an ellipse in the image, and its adjoint (docs/method.md 4.1 and
 * 4.3). */
#pragma once

#include "math/portable.h"

/* The dilation of the 3DGS rasteriser: added to the variances of an ellipse in x and y, in
 * pixels^2. Another value would change the images. */
#define SPIN_PROJECT_DILATION 0.3f

struct spin_projection {
    float fx, fy, cx, cy;   /* pixels */
    float limit_x, limit_y; /* limits of x/z and y/z in the Jacobian */
    const float *r, *t;     /* [9], [3]: world to camera */
};

/* Intermediate values that the forward and the backward pass share. */
struct spin_projected_cov {
    spin_vec3 p; /* mean in camera coordinates */
    float x, y;  /* p.x, p.y clamped for the Jacobian */
    int x_clamped, y_clamped;
    float a[2][3];            /* J R, with the Jacobian J of the projection */
    float rot[3][3], m[3][3]; /* rotation matrix of the quaternion; rot * diag(scale) */
    float k[2][3];            /* a m: the 2-D covariance is k k^T + dilation I */
};

struct spin_ellipse {
    /* u_px, v_px: the mean in pixels, where pixel centres are integers: 0.5 less than in spin.h. */
    float u_px, v_px, conic[3];
    float radius_px; /* 3 sigma, rounded up; 0 or not finite: the splat is not drawn */
};

SPIN_FN spin_vec3 spin_to_camera(const float *r, const float *t, spin_vec3 w)
{
    return spin_v3(r[0] * w.x + r[1] * w.y + r[2] * w.z + t[0],
                   r[3] * w.x + r[4] * w.y + r[5] * w.z + t[1],
                   r[6] * w.x + r[7] * w.y + r[8] * w.z + t[2]);
}

/* The rotation matrix of a unit quaternion w x y z. */
SPIN_FN void spin_rotation(const float *q, float rot[3][3])
{
    float w = q[0], x = q[1], y = q[2], z = q[3];

    rot[0][0] = 1 - 2 * (y * y + z * z);
    rot[0][1] = 2 * (x * y - w * z);
    rot[0][2] = 2 * (x * z + w * y);
    rot[1][0] = 2 * (x * y + w * z);
    rot[1][1] = 1 - 2 * (x * x + z * z);
    rot[1][2] = 2 * (y * z - w * x);
    rot[2][0] = 2 * (x * z - w * y);
    rot[2][1] = 2 * (y * z + w * x);
    rot[2][2] = 1 - 2 * (x * x + y * y);
}

/* Adjoint of spin_rotation(): adds to d_q [4] the gradient of the quaternion, given g, the gradient
 * of the matrix. The result is not projected onto the tangent space of unit quaternions. */
SPIN_FN void spin_matrix_quat_adj(const float *q, float g[3][3], float *d_q)
{
    float w = q[0], x = q[1], y = q[2], z = q[3];

    d_q[0] += 2 * (z * (g[1][0] - g[0][1]) + y * (g[0][2] - g[2][0]) + x * (g[2][1] - g[1][2]));
    d_q[1] += 2 * (y * (g[0][1] + g[1][0]) + z * (g[0][2] + g[2][0]) + w * (g[2][1] - g[1][2])) -
              4 * x * (g[1][1] + g[2][2]);
    d_q[2] += 2 * (x * (g[0][1] + g[1][0]) + w * (g[0][2] - g[2][0]) + z * (g[1][2] + g[2][1])) -
              4 * y * (g[0][0] + g[2][2]);
    d_q[3] += 2 * (w * (g[1][0] - g[0][1]) + x * (g[0][2] + g[2][0]) + y * (g[1][2] + g[2][1])) -
              4 * z * (g[0][0] + g[1][1]);
}

SPIN_FN float spin_clampf(float v, float limit)
{
    return v > limit ? limit : v < -limit ? -limit : v;
}

/* Computes *f for a Gaussian with scale [3] and rotation q [4]. p: mean in camera coordinates; p.z
 * must be above 0. */
SPIN_FN void spin_projected_cov_from(const struct spin_projection *lens, spin_vec3 p,
                                     const float *scale, const float *q,
                                     struct spin_projected_cov *f)
{
    const float *r = lens->r;
    float inv_z = 1 / p.z, tx = p.x * inv_z, ty = p.y * inv_z;
    float cx = spin_clampf(tx, lens->limit_x), cy = spin_clampf(ty, lens->limit_y);

    f->p = p;
    f->x_clamped = cx != tx;
    f->y_clamped = cy != ty;
    f->x = cx * p.z;
    f->y = cy * p.z;
    spin_rotation(q, f->rot);
    for (int j = 0; j < 3; j++) {
        f->a[0][j] = lens->fx * inv_z * (r[j] - cx * r[6 + j]);
        f->a[1][j] = lens->fy * inv_z * (r[3 + j] - cy * r[6 + j]);
        for (int i = 0; i < 3; i++)
            f->m[i][j] = f->rot[i][j] * scale[j];
    }
    for (int i = 0; i < 2; i++)
        for (int j = 0; j < 3; j++)
            f->k[i][j] =
                f->a[i][0] * f->m[0][j] + f->a[i][1] * f->m[1][j] + f->a[i][2] * f->m[2][j];
}

/* The 2-D covariance k k^T + d I, where d is the dilation. With the rows k0, k1 of k, the
 * determinant is computed as |k0 x k1|^2 + d (|k0|^2 + |k1|^2) + d^2. No term is negative, so
 * nothing cancels, whereas the usual a c - b^2 would lose digits for needles. */
struct spin_cov2d {
    float aa, b, cc; /* elements of k k^T */
    float area, det; /* determinants of k k^T and of k k^T + d I */
};

SPIN_FN struct spin_cov2d spin_cov2d_from(const struct spin_projected_cov *f)
{
    struct spin_cov2d g;
    spin_vec3 k0 = spin_v3(f->k[0][0], f->k[0][1], f->k[0][2]);
    spin_vec3 k1 = spin_v3(f->k[1][0], f->k[1][1], f->k[1][2]);
    spin_vec3 n =
        spin_v3(k0.y * k1.z - k0.z * k1.y, k0.z * k1.x - k0.x * k1.z, k0.x * k1.y - k0.y * k1.x);
    float dil = SPIN_PROJECT_DILATION;

    g.aa = spin_dot3(k0, k0);
    g.b = spin_dot3(k0, k1);
    g.cc = spin_dot3(k1, k1);
    g.area = spin_dot3(n, n);
    g.det = g.area + dil * (g.aa + g.cc) + dil * dil;
    return g;
}

SPIN_FN struct spin_ellipse spin_ellipse_from(const struct spin_projection *lens,
                                              const struct spin_projected_cov *f)
{
    struct spin_ellipse e;
    struct spin_cov2d g = spin_cov2d_from(f);
    float a = g.aa + SPIN_PROJECT_DILATION, b = g.b, c = g.cc + SPIN_PROJECT_DILATION;
    float half = 0.5f * (g.aa - g.cc), mid = 0.5f * (a + c), inv = 1 / g.det;

    e.u_px = lens->fx * f->p.x / f->p.z + lens->cx - 0.5f;
    e.v_px = lens->fy * f->p.y / f->p.z + lens->cy - 0.5f;
    e.conic[0] = c * inv;
    e.conic[1] = -b * inv;
    e.conic[2] = a * inv;
    e.radius_px = ceilf(3 * sqrtf(mid + sqrtf(spin_maxf(half * half + b * b, 0.1f))));
    return e;
}

/* Antialiasing: the dilation spreads a splat over more pixels. To compensate, the opacity is
 * multiplied by the square root of the ratio of the determinants without and with the dilation.
 * SPIN_PROJECT_FAINTEST is the lower limit of this ratio in the 3DGS rasteriser. */
#define SPIN_PROJECT_FAINTEST 2.5e-5f

/* The factor on the opacity for antialiasing, 0.005 to 1. */
SPIN_FN float spin_aa_compensation(const struct spin_projected_cov *f)
{
    struct spin_cov2d g = spin_cov2d_from(f);
    float ratio = g.area / g.det;

    return sqrtf(ratio > SPIN_PROJECT_FAINTEST ? ratio : SPIN_PROJECT_FAINTEST);
}

/* Adds to d_k [2][3] the gradient through the compensation factor, given d_fade, the gradient of
 * the factor. Adds nothing if the factor is at its lower limit. */
SPIN_FN void spin_aa_compensation_adj(const struct spin_projected_cov *f, float d_fade,
                                      float d_k[2][3])
{
    struct spin_cov2d g = spin_cov2d_from(f);
    float ratio = g.area / g.det, dil = SPIN_PROJECT_DILATION;
    float d_ratio = ratio > SPIN_PROJECT_FAINTEST ? 0.5f * d_fade / sqrtf(ratio) : 0;
    float d_area = d_ratio * (g.det - g.area) / (g.det * g.det);
    float d_trace = -d_ratio * g.area * dil / (g.det * g.det);

    for (int j = 0; j < 3; j++) {
        float k0 = f->k[0][j], k1 = f->k[1][j];

        d_k[0][j] += 2 * (d_area * (g.cc * k0 - g.b * k1) + d_trace * k0);
        d_k[1][j] += 2 * (d_area * (g.aa * k1 - g.b * k0) + d_trace * k1);
    }
}

/* Sets d_k [2][3] to the gradient through the conic, given d_conic [3], the gradient of the conic.
 * The conic is the inverse of C = k k^T + dilation I, so dL/dC = -conic G conic with G =
 * dL/d(conic). All products are computed in double: for a needle of aspect ratio 100, their sum is
 * 1e-4 of the terms. */
SPIN_FN void spin_conic_adj(const struct spin_projected_cov *f, const float *d_conic,
                            float d_k[2][3])
{
    double k00 = f->k[0][0], k01 = f->k[0][1], k02 = f->k[0][2];
    double k10 = f->k[1][0], k11 = f->k[1][1], k12 = f->k[1][2];
    double nx = k01 * k12 - k02 * k11, ny = k02 * k10 - k00 * k12, nz = k00 * k11 - k01 * k10;
    double aa = k00 * k00 + k01 * k01 + k02 * k02, cc = k10 * k10 + k11 * k11 + k12 * k12;
    double bb = k00 * k10 + k01 * k11 + k02 * k12, dil = SPIN_PROJECT_DILATION;
    double inv = 1 / (nx * nx + ny * ny + nz * nz + dil * (aa + cc) + dil * dil);
    double a = (cc + dil) * inv, b = -bb * inv, c = (aa + dil) * inv;
    double ga = d_conic[0], gb = d_conic[1], gc = d_conic[2];
    /* Gradients of the elements xx and yy of the covariance, and of xy, which occurs twice. */
    double dxx = -(a * a * ga + a * b * gb + b * b * gc);
    double dyy = -(b * b * ga + b * c * gb + c * c * gc);
    double dxy = -(2 * a * b * ga + (a * c + b * b) * gb + 2 * b * c * gc);

    for (int j = 0; j < 3; j++) {
        d_k[0][j] = (float)(2 * dxx * f->k[0][j] + dxy * f->k[1][j]);
        d_k[1][j] = (float)(dxy * f->k[0][j] + 2 * dyy * f->k[1][j]);
    }
}

/* Adjoint of the whole projection, given the gradients of u, v, the conic and the compensation
 * factor (d_fade; 0 without antialiasing). Adds to d_scale [3] and d_pos_w [3], the gradients of
 * scale and mean, and sets d_rot [3][3], the gradient of the rotation matrix, for
 * spin_matrix_quat_adj(). As in 3DGS, an x/z or y/z that was clamped in the Jacobian counts as a
 * constant: p.x or p.y then receives no gradient through the Jacobian. */
SPIN_FN void spin_ellipse_adj(const struct spin_projection *lens,
                              const struct spin_projected_cov *f, const float *scale, float d_u,
                              float d_v, const float *d_conic, float d_fade, float *d_scale,
                              float d_rot[3][3], float *d_pos_w)
{
    const float *r = lens->r;
    float d_k[2][3], d_a[2][3], d_j[2][3], d_m[3][3];
    float inv_z = 1 / f->p.z, inv_z2 = inv_z * inv_z, fx2 = lens->fx * inv_z2,
          fy2 = lens->fy * inv_z2;
    float dp[3];

    spin_conic_adj(f, d_conic, d_k);
    if (d_fade != 0)
        spin_aa_compensation_adj(f, d_fade, d_k);
    for (int j = 0; j < 3; j++)
        for (int i = 0; i < 3; i++) {
            d_m[i][j] = f->a[0][i] * d_k[0][j] + f->a[1][i] * d_k[1][j];
            d_rot[i][j] = d_m[i][j] * scale[j];
            d_scale[j] += d_m[i][j] * f->rot[i][j];
        }
    for (int i = 0; i < 2; i++)
        for (int j = 0; j < 3; j++)
            d_a[i][j] = d_k[i][0] * f->m[j][0] + d_k[i][1] * f->m[j][1] + d_k[i][2] * f->m[j][2];
    for (int i = 0; i < 2; i++)
        for (int j = 0; j < 3; j++)
            d_j[i][j] = d_a[i][0] * r[3 * j] + d_a[i][1] * r[3 * j + 1] + d_a[i][2] * r[3 * j + 2];
    dp[0] = lens->fx * inv_z * d_u - (f->x_clamped ? 0 : fx2 * d_j[0][2]);
    dp[1] = lens->fy * inv_z * d_v - (f->y_clamped ? 0 : fy2 * d_j[1][2]);
    dp[2] = -fx2 * (d_j[0][0] + f->p.x * d_u) - fy2 * (d_j[1][1] + f->p.y * d_v) +
            2 * inv_z * (fx2 * f->x * d_j[0][2] + fy2 * f->y * d_j[1][2]);
    for (int j = 0; j < 3; j++)
        d_pos_w[j] += r[j] * dp[0] + r[3 + j] * dp[1] + r[6 + j] * dp[2];
}

/* Returns the unit vector from the camera centre to the mean of a splat, and sets *distance to the
 * distance between these two points. */
SPIN_FN spin_vec3 spin_view_direction(const float *centre, const float *pos_w, float *distance)
{
    spin_vec3 d = spin_v3(pos_w[0] - centre[0], pos_w[1] - centre[1], pos_w[2] - centre[2]);
    float length = sqrtf(spin_dot3(d, d)), inv = 1 / length;

    *distance = length;
    return spin_v3(d.x * inv, d.y * inv, d.z * inv);
}

/* Adjoint of spin_view_direction() for direction d: d_pos_w [3] += (I - d d^T) d_d / distance. */
SPIN_FN void spin_view_direction_adj(spin_vec3 d, float distance, spin_vec3 d_d, float *d_pos_w)
{
    float along = spin_dot3(d, d_d), inv = 1 / distance;

    d_pos_w[0] += (d_d.x - along * d.x) * inv;
    d_pos_w[1] += (d_d.y - along * d.y) * inv;
    d_pos_w[2] += (d_d.z - along * d.z) * inv;
}
