/* covariance: scale and rotation there and back, eigenvalues of difficult matrices, and slices of
 * 4-D Gaussians compared with direct conditioning and with the worked examples of the formats'
 * pages. */
#include "math/covariance.h"
#include "math/rng.h"
#include "tests/tap.h"

static uint32_t drawn;

static double draw(void) { return 2.0 * (double)spin_rng_u32(7, 0, drawn++) / 4294967295.0 - 1.0; }

static void draw_n(double *out, int n, double size)
{
    for (int i = 0; i < n; i++)
        out[i] = size * draw();
}

/* Largest difference, relative to the trace of the matrix. */
static double error_of(const double got[6], const double want[6])
{
    double trace = fabs(want[0]) + fabs(want[3]) + fabs(want[5]) + 1e-300, worst = 0;

    for (int i = 0; i < 6; i++)
        worst = larger(worst, fabs(got[i] - want[i]) / trace);
    return worst;
}

static double unit_error(const double quat[4])
{
    double n = 0;

    for (int i = 0; i < 4; i++)
        n += quat[i] * quat[i];
    return fabs(n - 1);
}

/* cov6 -> scale, quaternion -> cov6 */
static double round_trip(const double cov6[6])
{
    double log_scale[3], scale[3], quat[4], back[6];

    if (!spin_covariance_split(cov6, log_scale, quat))
        return INFINITY;
    for (int i = 0; i < 3; i++)
        scale[i] = exp(log_scale[i]);
    spin_covariance_of(scale, quat, back);
    return fmax(error_of(back, cov6), unit_error(quat) + (quat[0] < 0));
}

static void test_split(void)
{
    static const struct {
        const char *what;
        double cov6[6];
    } cases[] = {
        {"a sphere", {2, 0, 0, 2, 0, 2}},
        {"a disc across the axes", {1, -0.5, 0, 1, 0, 1.5}},
        {"a needle", {1, 1, 1, 1, 1, 1}},
        {"tiny", {1e-30, 1e-31, 0, 2e-30, 0, 3e-30}},
        {"huge", {1e30, 1e29, 0, 2e30, 0, 3e30}},
        {"two equal axes, nearly", {1, 1e-17, 0, 1 + 1e-16, 1e-17, 0.25}},
        {"slightly negative by rounding", {1, 0, 0, -1e-17, 0, 1e-17}},
    };
    double worst = 0, log_scale[3], quat[4];
    double nothing[6] = {0}, bad[6] = {1, 0, 0, 1, NAN, 1}, worse[6] = {1, 0, 0, 1, 0, INFINITY};

    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++)
        near(round_trip(cases[i].cov6), 0, 1e-13, cases[i].what);
    for (int i = 0; i < 20000; i++) {
        double scale[3], q[4], cov6[6];

        for (int k = 0; k < 3; k++)
            scale[k] = exp(6 * draw());
        draw_n(q, 4, 1);
        if (i % 3 == 0) /* rotations by half a turn: w is 0 */
            q[0] = 0;
        if (i % 5 == 0)
            scale[1] = scale[0];
        spin_covariance_of(scale, q, cov6);
        worst = larger(worst, round_trip(cov6));
    }
    ok(spin_covariance_split(nothing, log_scale, quat) && log_scale[0] < -40 &&
           isfinite(log_scale[2]) && unit_error(quat) < 1e-15,
       "no extent at all is a point");
    near(worst, 0, 1e-12, "20000 covariances come back from scale and rotation");
    ok(!spin_covariance_split(bad, log_scale, quat) &&
           !spin_covariance_split(worse, log_scale, quat),
       "NaN and infinities are refused");
}

static void test_quats(void)
{
    double worst = 0;

    for (int i = 0; i < 5000; i++) {
        double q[4], r[9], back[4], dot = 0, norm = 0;

        draw_n(q, 4, 1);
        if (i % 4)
            q[i % 4] *= 1e-9;
        spin_matrix_of_quat(q, r);
        spin_quat_of_matrix(r, back);
        for (int k = 0; k < 4; k++) {
            dot += q[k] * back[k];
            norm += q[k] * q[k];
        }
        worst = larger(worst, fabs(fabs(dot) / sqrt(norm) - 1));
    }
    near(worst, 0, 1e-14, "quaternions come back from matrices");
}

/* ---- 4-D ------------------------------------------------------------------------------------- */

/* |A A^T - 1| */
static double off_rotation(const double a[16])
{
    double worst = 0;

    for (int i = 0; i < 4; i++) {
        for (int j = 0; j < 4; j++) {
            double sum = -(i == j);

            for (int k = 0; k < 4; k++)
                sum += a[4 * i + k] * a[4 * j + k];
            worst = larger(worst, fabs(sum));
        }
    }
    return worst;
}

/* Invert a 4x4 matrix by elimination with row exchange. */
static void invert4(const double in[16], double out[16])
{
    double m[4][8] = {{0}};

    for (int i = 0; i < 4; i++) {
        for (int j = 0; j < 4; j++)
            m[i][j] = in[4 * i + j];
        m[i][4 + i] = 1;
    }
    for (int c = 0; c < 4; c++) {
        int best = c;

        for (int i = c; i < 4; i++)
            best = fabs(m[i][c]) > fabs(m[best][c]) ? i : best;
        for (int j = 0; j < 8; j++) {
            double keep = m[c][j];

            m[c][j] = m[best][j];
            m[best][j] = keep;
        }
        for (int i = 0; i < 4; i++) {
            double f = m[i][c] / m[c][c];

            for (int j = 0; j < 8 && i != c; j++)
                m[i][j] -= f * m[c][j];
        }
        for (int j = 7; j >= 0; j--)
            m[c][j] /= m[c][c];
    }
    for (int i = 0; i < 16; i++)
        out[i] = m[i / 4][4 + i % 4];
}

/* The inverse of the sliced covariance is the upper block of the inverse of the 4-D covariance: a
 * second way to compute the same matrix. */
static double precision_error(const double a[16], const double scale[4])
{
    double sigma[16], inverse[16], worst = 0, size = 0;
    spin_slice s;

    spin_slice_of(a, scale, &s);
    for (int i = 0; i < 16; i++) {
        sigma[i] = 0;
        for (int k = 0; k < 4; k++)
            sigma[i] += a[i / 4 * 4 + k] * scale[k] * scale[k] * a[i % 4 * 4 + k];
    }
    invert4(sigma, inverse);
    const double c[9] = {s.cov6[0], s.cov6[1], s.cov6[2], s.cov6[1], s.cov6[3],
                         s.cov6[4], s.cov6[2], s.cov6[4], s.cov6[5]};
    for (int i = 0; i < 3; i++) {
        for (int j = 0; j < 3; j++) {
            double sum = -(i == j);

            for (int k = 0; k < 3; k++) {
                sum += c[3 * i + k] * inverse[4 * k + j];
                size = larger(size, fabs(c[3 * i + k] * inverse[4 * k + j]));
            }
            worst = larger(worst, fabs(sum));
        }
        /* and the velocity: inverse[i][3] = -(C^-1 v)[i] */
        double lost = inverse[4 * i + 3];

        for (int k = 0; k < 3; k++)
            lost += inverse[4 * i + k] * s.velocity[k];
        worst = larger(worst, fabs(lost) / (fabs(inverse[4 * i + 3]) + inverse[15] + 1));
    }
    return worst / (1 + size);
}

static void test_rotations(void)
{
    double worst = 0, worst_rotor = 0, worst_slice = 0, reversed = 0, rotor3 = 0;
    double one[4] = {1, 0, 0, 0}, rotor[8] = {1, 0, 0, 0, 0, 0, 0, 0}, a[16], b[16];

    spin_rotation4_of_pair(one, one, 0, a);
    near(off_rotation(a) + fabs(a[0] - 1) + fabs(a[15] - 1), 0, 1e-15, "1, 1 is the identity");
    spin_matrix4_of_rotor(rotor, a);
    near(off_rotation(a) + fabs(a[0] - 1) + fabs(a[15] - 1), 0, 1e-15, "so is the rotor 1");
    for (int i = 0; i < 2000; i++) {
        double l[4], r[4], scale[4], m[9];

        draw_n(l, 4, 3);
        draw_n(r, 4, 3);
        for (int k = 0; k < 4; k++)
            scale[k] = exp(2 * draw());
        spin_rotation4_of_pair(l, r, 0, a);
        spin_rotation4_of_pair(l, r, 1, b);
        for (int k = 0; k < 16; k++)
            reversed = larger(reversed, fabs(a[k] - b[15 - k]));
        worst = larger(worst, off_rotation(a));
        worst_slice = larger(worst_slice, precision_error(a, scale));
        /* A quaternion w, x, y, z is the purely spatial rotor w, -z, y, -x. */
        double norm = sqrt(l[0] * l[0] + l[1] * l[1] + l[2] * l[2] + l[3] * l[3]);
        double space[8] = {l[0] / norm, -l[3] / norm, l[2] / norm, -l[1] / norm, 0, 0, 0, 0};

        spin_matrix4_of_rotor(space, a);
        spin_matrix_of_quat(l, m);
        for (int k = 0; k < 9; k++)
            rotor3 = larger(rotor3, fabs(a[k / 3 * 4 + k % 3] - m[k]));
        /* (1 + e B) with a simple plane B through time is also a rotation. */
        double tilt[8] = {cos(l[0]), 0, 0, 0, sin(l[0]), 0, 0, 0};

        spin_matrix4_of_rotor(tilt, a);
        worst_rotor = larger(worst_rotor, off_rotation(a));
    }
    near(worst, 0, 1e-14, "a pair of quaternions is a rotation");
    near(reversed, 0, 0, "the older convention has its axes reversed");
    near(worst_rotor, 0, 1e-14, "a unit rotor in a plane through time is a rotation");
    near(rotor3, 0, 1e-14, "a rotor without time is a quaternion's rotation");
    near(worst_slice, 0, 1e-10, "slices agree with the inverse of the 4-D covariance");
}

/* The worked example, by hand. */
static void test_pair_example(void)
{
    const double l[4] = {-0.0785067, -0.1047020, -0.0832891, -0.4083459};
    const double r[4] = {0.0230827, -1.7591190, -0.2651121, 0.0939908};
    const double scale[4] = {exp(-2.8112040), exp(-3.1156142), exp(-2.7407246), exp(-0.4530409)};
    const double xyz[3] = {0.0953050, -0.3294455, 0.6597174}, dt = 2.565 - 2.5333602;
    const double mean[3] = {0.1159746, -0.4566727, 0.6562235};
    const double cov6[6] = {0.0041276, -0.0037688, -0.0004016, 0.0440410, 0.0030973, 0.0036963};
    double a[16];
    spin_slice s;

    spin_rotation4_of_pair(l, r, 0, a);
    spin_slice_of(a, scale, &s);
    for (int i = 0; i < 3; i++)
        near(xyz[i] + s.velocity[i] * dt, mean[i], 2e-6, "pair of quaternions: mean");
    near(error_of(s.cov6, cov6), 0, 5e-6, "pair of quaternions: covariance");
    near(spin_time_weight(dt, s.variance_t), 0.9759460, 2e-6, "pair of quaternions: weight");
}

/* The worked example, by hand. */
static void test_rotor_example(void)
{
    const double rotor[8] = {-0.1347521, -0.4475614, 0.4473197,  -0.2991245,
                             0.3929379,  -0.2652725, -0.1589602, -0.3484543};
    const double scale[4] = {exp(-3.4138556), exp(-3.0707800), exp(-3.2973638), exp(-0.2943364)};
    const double velocity[3] = {1.3167558, 5.5126490, -1.0303350};
    const double cov6[6] = {0.0033050, 0.0082454, -0.0012052, 0.0365135, -0.0068706, 0.0024178};
    double a[16];
    spin_slice s;

    spin_matrix4_of_rotor(rotor, a);
    spin_slice_of(a, scale, &s);
    for (int i = 0; i < 3; i++)
        near(s.velocity[i], velocity[i], 2e-5, "rotor: velocity");
    near(s.variance_t, 0.0113864, 1e-7, "rotor: variance of time");
    near(error_of(s.cov6, cov6), 0, 5e-6, "rotor: covariance");
    near(spin_time_weight(0.513 - 0.7107860, s.variance_t), 0.1794585, 1e-5, "rotor: weight");
}

static void test_fold(void)
{
    float sh[144], out[48];

    for (int i = 0; i < 144; i++)
        sh[i] = (float)draw();
    spin_sh_fold(0, 0.3, 1, sh, out);
    ok(memcmp(out, sh, sizeof out) == 0, "without terms in time SH stay what they are");
    spin_sh_fold(2, 2.5, 10, sh, out);
    near(out[5], sh[5] + 0.0f * sh[53] - sh[101], 1e-6, "a quarter of the clip: 0 and -1");
    spin_sh_fold(1, 5, 10, sh, out);
    near(out[47], sh[47] - sh[95], 1e-6, "half of it: -1");
}

TAP_MAIN
{
    test_quats();
    test_split();
    test_rotations();
    test_pair_example();
    test_rotor_example();
    test_fold();
}
