/* quat: quaternion product and rotation agree, and the covariance of a quaternion that is not of
 * unit length is the rasteriser's.
 * K: math */
#include "math/covariance.h"
#include "math/quat.h"
#include "tests/tap.h"

/* q p q* / |q|^2 written out with the product. */
static double rotation_error(const float q[4], const float p[3])
{
    float pure[4] = {0, p[0], p[1], p[2]}, back[4] = {q[0], -q[1], -q[2], -q[3]}, half[4], full[4];
    float norm = q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3], out[3];
    double worst = 0;

    spin_quat_product(q, pure, half);
    spin_quat_product(half, back, full);
    spin_quat_rotate(q, p, out);
    for (int d = 0; d < 3; d++)
        worst = larger(worst, fabs(full[1 + d] / norm - out[d]));
    return worst;
}

TAP_MAIN
{
    const float i[4] = {0, 1, 0, 0}, j[4] = {0, 0, 1, 0};
    const double scale[3] = {0.5, 1, 2}, unit[4] = {0.5, -0.5, 0.5, 0.5};
    const double twice[4] = {1, 0, 0, 1};
    double got[6], want[6], worst = 0;
    float k[4];

    spin_quat_product(i, j, k);
    ok(k[0] == 0 && k[1] == 0 && k[2] == 0 && k[3] == 1, "i j = k");
    for (int n = 0; n < 50; n++) {
        float v[7];

        for (int c = 0; c < 7; c++)
            v[c] = (float)sin(1.7 * n + 2.3 * c + 0.1);
        worst = larger(worst, rotation_error(v, v + 4));
    }
    near(worst, 0, 2e-6, "rotating is q p q* for any length of q");
    spin_covariance_unnormalised(scale, unit, got);
    spin_covariance_of(scale, unit, want);
    worst = 0;
    for (int c = 0; c < 6; c++)
        worst = larger(worst, fabs(got[c] - want[c]));
    near(worst, 0, 1e-12, "a unit quaternion gives the usual covariance");
    /* R of (1, 0, 0, 1) without normalising: -1 -2 0 / 2 -1 0 / 0 0 1 */
    spin_covariance_unnormalised(scale, twice, got);
    near(got[0], 1 * 0.25 + 4 * 1, 1e-12, "xx of one that is too long");
    near(got[1], -2 * 0.25 + 2 * 1, 1e-12, "its xy");
    near(got[5], 4, 1e-12, "its zz");
}
