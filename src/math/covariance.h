/* Converts scale and rotation to a covariance and back, and computes the slice of a 4-D Gaussian at
 * a given time.
 *
 * A symmetric 3x3 matrix is stored as xx xy xz yy yz zz. All computations are in double: for a
 * Gaussian that moves fast, slicing subtracts nearly equal matrices, which would cost floats half
 * of their digits. */
#pragma once

#include "math/portable.h"

/* ---- 3-D ------------------------------------------------------------------------------------- */

/* The rotation matrix, row by row, of a quaternion w x y z of any length except zero. */
SPIN_FN void spin_matrix_of_quat(const double quat[4], double r[9])
{
    double s =
        2.0 / (quat[0] * quat[0] + quat[1] * quat[1] + quat[2] * quat[2] + quat[3] * quat[3]);
    double w = quat[0], x = quat[1], y = quat[2], z = quat[3];

    r[0] = 1 - s * (y * y + z * z);
    r[1] = s * (x * y - w * z);
    r[2] = s * (x * z + w * y);
    r[3] = s * (x * y + w * z);
    r[4] = 1 - s * (x * x + z * z);
    r[5] = s * (y * z - w * x);
    r[6] = s * (x * z - w * y);
    r[7] = s * (y * z + w * x);
    r[8] = 1 - s * (x * x + y * y);
}

/* The unit quaternion with w >= 0 of a rotation matrix (Shepperd, 1978). Four formulas are
 * possible, one for each component; the one that divides by the largest component is used. */
SPIN_FN void spin_quat_of_matrix(const double r[9], double quat[4])
{
    double q[4], norm, trace = r[0] + r[4] + r[8];

    if (trace > r[0] && trace > r[4] && trace > r[8]) {
        q[0] = 1 + trace;
        q[1] = r[7] - r[5];
        q[2] = r[2] - r[6];
        q[3] = r[3] - r[1];
    } else {
        int i = r[0] > r[4] ? (r[0] > r[8] ? 0 : 2) : (r[4] > r[8] ? 1 : 2);
        int j = (i + 1) % 3, k = (i + 2) % 3;

        q[0] = r[3 * k + j] - r[3 * j + k];
        q[1 + i] = 1 + 2 * r[4 * i] - trace;
        q[1 + j] = r[3 * i + j] + r[3 * j + i];
        q[1 + k] = r[3 * i + k] + r[3 * k + i];
    }
    norm = sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]);
    for (int i = 0; i < 4; i++)
        quat[i] = q[i] / (q[0] < 0 ? -norm : norm);
}

/* R diag(scale)^2 R^T (3DGS, eq. 6), as xx xy xz yy yz zz. */
SPIN_FN void spin_covariance_of_matrix(const double scale[3], const double r[9], double cov6[6])
{
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

/* The covariance from scale and a quaternion of any length except zero. */
SPIN_FN void spin_covariance_of(const double scale[3], const double quat[4], double cov6[6])
{
    double r[9];

    spin_matrix_of_quat(quat, r);
    spin_covariance_of_matrix(scale, r, cov6);
}

/* The covariance as computed by the 3DGS rasteriser, which does not normalise the quaternion. If
 * its length is not 1, the matrix R is not a rotation, and no unit quaternion with the same scales
 * describes this ellipsoid. */
SPIN_FN void spin_covariance_unnormalised(const double scale[3], const double q[4], double cov6[6])
{
    double w = q[0], x = q[1], y = q[2], z = q[3];
    double r[9] = {1 - 2 * (y * y + z * z), 2 * (x * y - w * z),     2 * (x * z + w * y),
                   2 * (x * y + w * z),     1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
                   2 * (x * z - w * y),     2 * (y * z + w * x),     1 - 2 * (x * x + y * y)};

    spin_covariance_of_matrix(scale, r, cov6);
}

/* A Jacobi rotation: rotates matrix a in the plane of axes p and q so that a[p][q] becomes 0, and
 * applies the same rotation to the columns of v (Golub and Van Loan, 8.5.2). */
SPIN_FN void spin_jacobi_turn(double a[9], double v[9], int p, int q)
{
    double apq = a[3 * p + q], theta, t, c, s;

    if (apq == 0)
        return;
    theta = (a[4 * q] - a[4 * p]) / (2 * apq);
    t = (theta < 0 ? -1.0 : 1.0) / (fabs(theta) + sqrt(theta * theta + 1));
    c = 1 / sqrt(t * t + 1);
    s = t * c;
    for (int k = 0; k < 3; k++) {
        double x = a[3 * k + p], y = a[3 * k + q];

        a[3 * k + p] = c * x - s * y;
        a[3 * k + q] = s * x + c * y;
    }
    for (int k = 0; k < 3; k++) {
        double x = a[3 * p + k], y = a[3 * q + k];

        a[3 * p + k] = c * x - s * y;
        a[3 * q + k] = s * x + c * y;
        x = v[3 * k + p];
        y = v[3 * k + q];
        v[3 * k + p] = c * x - s * y;
        v[3 * k + q] = s * x + c * y;
    }
    a[3 * p + q] = a[3 * q + p] = 0;
}

/* Computes the eigenvalues, and the eigenvectors as columns of a rotation matrix (determinant +1).
 * Cyclic Jacobi rotations are slower than closed formulas, but accurate to the last digits, even if
 * eigenvalues are equal. Returns 1, or 0 without results if an element is NaN, infinite or above
 * 1e300. */
SPIN_FN int spin_eigen3(const double cov6[6], double value[3], double vector[9])
{
    double largest = 0, det;
    double a[9] = {cov6[0], cov6[1], cov6[2], cov6[1], cov6[3], cov6[4], cov6[2], cov6[4], cov6[5]};

    for (int i = 0; i < 6; i++) {
        if (!(fabs(cov6[i]) < 1e300))
            return 0;
        largest = fabs(cov6[i]) > largest ? fabs(cov6[i]) : largest;
    }
    for (int i = 0; i < 9; i++) {
        /* Scale the elements to at most 1, so that squares neither overflow nor underflow. */
        a[i] = largest > 0 ? a[i] / largest : 0;
        vector[i] = i % 4 == 0;
    }
    /* Convergence is quadratic: 4 or 5 sweeps are sufficient in practice. */
    for (int sweep = 0; sweep < 20; sweep++) {
        if (fabs(a[1]) + fabs(a[2]) + fabs(a[5]) < 1e-18)
            break;
        spin_jacobi_turn(a, vector, 0, 1);
        spin_jacobi_turn(a, vector, 0, 2);
        spin_jacobi_turn(a, vector, 1, 2);
    }
    for (int i = 0; i < 3; i++)
        value[i] = a[4 * i] * largest;
    det = vector[0] * (vector[4] * vector[8] - vector[5] * vector[7]) -
          vector[1] * (vector[3] * vector[8] - vector[5] * vector[6]) +
          vector[2] * (vector[3] * vector[7] - vector[4] * vector[6]);
    for (int i = 0; i < 3 && det < 0; i++)
        vector[3 * i + 2] = -vector[3 * i + 2];
    return 1;
}

/* Decomposes a covariance into log standard deviations and a unit quaternion, so that R
 * diag(exp(log_scale))^2 R^T is the covariance. Order and signs of the axes are arbitrary.
 * Eigenvalues that rounding made zero, negative or tiny are raised to 1e-14 of the largest
 * eigenvalue. Returns 1, or 0 in the cases of spin_eigen3(). */
SPIN_FN int spin_covariance_split(const double cov6[6], double log_scale[3], double quat[4])
{
    double value[3], vector[9], least = 0;

    if (!spin_eigen3(cov6, value, vector))
        return 0;
    for (int i = 0; i < 3; i++)
        least = value[i] > least ? value[i] : least;
    least = 1e-14 * least + 1e-36;
    for (int i = 0; i < 3; i++)
        log_scale[i] = 0.5 * log(value[i] > least ? value[i] : least);
    spin_quat_of_matrix(vector, quat);
    return 1;
}

/* ---- 4-D ------------------------------------------------------------------------------------- */

/* The 4-D rotation matrix, with axes x y z t, of a pair of quaternions of any length except zero:
 * the product of a left-isoclinic and a right-isoclinic rotation (4D Gaussian Splatting, Yang et
 * al., ICLR 2024; fudan-zvg/4d-gaussian-splatting 63725f2). older: 1 for the order of axes that the
 * method had before 2024-09-15; 0 for the present order, in which rows and columns are reversed. */
SPIN_FN void spin_rotation4_of_pair(const double left[4], const double right[4], int older,
                                    double a[16])
{
    double nl = 0, nr = 0, l[4], r[4];

    for (int i = 0; i < 4; i++) {
        nl += left[i] * left[i];
        nr += right[i] * right[i];
    }
    for (int i = 0; i < 4; i++) {
        l[i] = left[i] / sqrt(nl);
        r[i] = right[i] / sqrt(nr);
    }
    double p[16] = {l[0], -l[1], -l[2], -l[3], l[1], l[0],  -l[3], l[2],
                    l[2], l[3],  l[0],  -l[1], l[3], -l[2], l[1],  l[0]};
    double q[16] = {r[0],  r[1], r[2], r[3],  -r[1], r[0],  -r[3], r[2],
                    -r[2], r[3], r[0], -r[1], -r[3], -r[2], r[1],  r[0]};
    for (int i = 0; i < 4; i++) {
        for (int j = 0; j < 4; j++) {
            double sum = 0;

            for (int k = 0; k < 4; k++)
                sum += p[4 * i + k] * q[4 * k + j];
            a[older ? 4 * i + j : 4 * (3 - i) + 3 - j] = sum;
        }
    }
}

/* The 4-D matrix of a rotor s xy xz yz xw yw zw xyzw, where w is time (4D-Rotor Gaussian Splatting,
 * Duan et al., SIGGRAPH 2024; weify627/4D-Rotor-Gaussians 1ea2ff9). As in the method's renderer,
 * the rotor is not normalised: if its length is not 1, the matrix is not a rotation. */
SPIN_FN void spin_matrix4_of_rotor(const double rotor[8], double a[16])
{
    double s = rotor[0], xy = rotor[1], xz = rotor[2], yz = rotor[3];
    double xw = rotor[4], yw = rotor[5], zw = rotor[6], p = rotor[7];
    double s2 = s * s, xy2 = xy * xy, xz2 = xz * xz, yz2 = yz * yz;
    double xw2 = xw * xw, yw2 = yw * yw, zw2 = zw * zw, p2 = p * p;

    a[0] = s2 - xy2 - xz2 - xw2 + yz2 + yw2 + zw2 - p2;
    a[1] = 2 * (s * xy - xz * yz - xw * yw + zw * p);
    a[2] = 2 * (s * xz + xy * yz - xw * zw - yw * p);
    a[3] = 2 * (s * xw + xy * yw + xz * zw + yz * p);
    a[4] = -2 * (s * xy + xz * yz + xw * yw + zw * p);
    a[5] = s2 - xy2 + xz2 + xw2 - yz2 - yw2 + zw2 - p2;
    a[6] = 2 * (s * yz - xy * xz + xw * p - yw * zw);
    a[7] = 2 * (s * yw - xy * xw - xz * p + yz * zw);
    a[8] = 2 * (xy * yz - s * xz - xw * zw + yw * p);
    a[9] = -2 * (s * yz + xy * xz + xw * p + yw * zw);
    a[10] = s2 + xy2 - xz2 + xw2 - yz2 + yw2 - zw2 - p2;
    a[11] = 2 * (s * zw + xy * p - xz * xw - yw * yz);
    a[12] = 2 * (xy * yw + xz * zw - s * xw - yz * p);
    a[13] = 2 * (xz * p - xy * xw + yz * zw - s * yw);
    a[14] = -2 * (s * zw + xy * p + xz * xw + yz * yw);
    a[15] = s2 + xy2 + xz2 - xw2 + yz2 - yw2 - zw2 - p2;
}

/* The slices of a 4-D Gaussian at all times. Together they form a 3-D Gaussian of constant shape
 * that moves along a line at constant velocity. */
typedef struct spin_slice {
    double velocity[3]; /* units of space per unit of time */
    double cov6[6];
    double variance_t; /* square of sigma, the width of the Gaussian window in time */
} spin_slice;

/* Slices the 4-D Gaussian with covariance Sigma = A diag(scale)^2 A^T and mean (mu, mu_t). If Sigma
 * has the blocks [C k; k^T c], with the 3x3 matrix C and the variance c of time, the distribution
 * conditioned on time t has the mean mu + k/c (t - mu_t) and the covariance C - k k^T / c. */
SPIN_FN void spin_slice_of(const double a[16], const double scale[4], spin_slice *out)
{
    double sigma[16];
    int at = 0;

    for (int i = 0; i < 4; i++) {
        for (int j = 0; j < 4; j++) {
            sigma[4 * i + j] = 0;
            for (int k = 0; k < 4; k++)
                sigma[4 * i + j] += a[4 * i + k] * scale[k] * (a[4 * j + k] * scale[k]);
        }
    }
    out->variance_t = sigma[15];
    for (int i = 0; i < 3; i++)
        out->velocity[i] = sigma[4 * i + 3] / sigma[15];
    for (int i = 0; i < 3; i++)
        for (int j = i; j < 3; j++)
            out->cov6[at++] = sigma[4 * i + j] - out->velocity[i] * sigma[4 * j + 3];
}

/* The Gaussian window: the factor on the opacity at time dt from the splat's centre in time. */
SPIN_FN double spin_time_weight(double dt, double variance)
{
    return exp(-0.5 * dt * dt / variance);
}

/* Converts 4-D spherindrical harmonics at one time to spherical harmonics. The conversion is exact,
 * since the 4-D basis functions are products of SH and cosines of time. sh [16 (1 + degree_t)][3],
 * out [16][3]. dt: time from the splat's centre in time; length: duration of the clip, in the same
 * unit. */
SPIN_FN void spin_sh_fold(int degree_t, double dt, double length, const float *sh, float *out)
{
    for (int i = 0; i < 48; i++) {
        double sum = sh[i];

        for (int n = 1; n <= degree_t; n++)
            sum += cos(6.283185307179586 * n * dt / length) * sh[48 * n + i];
        out[i] = (float)sum;
    }
}
