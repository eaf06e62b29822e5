/* Rotation of a scene: places, splats' rotations and SH.
 * K: sh export turn */
#include "math/scene_rotation.h"
#include "math/rng.h"
#include "tests/tap.h"

static spin_vec3 direction(uint64_t i)
{
    float v[3], length = 0;

    for (uint64_t c = 0; c < 3; c++) {
        v[c] = spin_rng_normal(1, 2, 3 * i + c);
        length += v[c] * v[c];
    }
    length = sqrtf(length);
    return spin_v3(v[0] / length, v[1] / length, v[2] / length);
}

/* f'(R d) = f(d), checked with the basis alone. */
static void test_sh(const char *what, const double q[4], int degree)
{
    int n = spin_sh_count(degree);
    float sh[3 * SPIN_SH_MAX], turned[3 * SPIN_SH_MAX], worst = 0;
    struct spin_scene_rotation t;

    spin_scene_rotation_from(q, &t);
    for (int i = 0; i < 3 * n; i++)
        sh[i] = spin_rng_normal(3, 1, (uint64_t)i);
    spin_scene_rotation_sh(&t, n, sh, turned);
    for (uint64_t i = 0; i < 200; i++) {
        spin_vec3 d = direction(i);
        float before[SPIN_SH_MAX], after[SPIN_SH_MAX], sum[2] = {0, 0};

        spin_sh_basis(degree, d, before);
        spin_sh_basis(degree, spin_scene_rotation_place(&t, d), after);
        for (int k = 0; k < n; k++) {
            sum[0] += before[k] * sh[3 * k + 1];
            sum[1] += after[k] * turned[3 * k + 1];
        }
        worst = spin_maxf(worst, fabsf(sum[0] - sum[1]));
    }
    near((double)worst, 0, 3e-6 * n, what);
}

/* The axes of a splat rotate with its position. */
static void test_rotation(const double q[4])
{
    struct spin_scene_rotation t, splat, both;
    float r[4] = {0.5f, -0.5f, 0.7f, 0.1f}, out[4], worst = 0, norm = 0;
    double a[4], b[4];

    for (int k = 0; k < 4; k++)
        norm += r[k] * r[k];
    for (int k = 0; k < 4; k++) {
        r[k] /= sqrtf(norm);
        a[k] = (double)r[k];
    }
    spin_scene_rotation_from(q, &t);
    spin_scene_rotation_from(a, &splat);
    spin_scene_rotation_quat(&t, r, out);
    for (int k = 0; k < 4; k++)
        b[k] = (double)out[k];
    spin_scene_rotation_from(b, &both);
    for (uint64_t i = 0; i < 20; i++) {
        spin_vec3 d = direction(i),
                  one = spin_scene_rotation_place(&t, spin_scene_rotation_place(&splat, d));
        spin_vec3 two = spin_scene_rotation_place(&both, d);

        worst =
            spin_maxf(worst, fabsf(one.x - two.x) + fabsf(one.y - two.y) + fabsf(one.z - two.z));
    }
    near((double)worst, 0, 3e-6, "rotations turn as places do");
}

static void test_half_turns(void)
{
    /* The signs for x and z are those of the formats' papers. */
    static const char signs[3][17] = {"+--+-++-+-+--+-+", "", "+-+-+-+-+-+-+-+-"};
    struct spin_scene_rotation t;

    for (int axis = 0; axis < 3; axis++) {
        double q[4] = {0, axis == 0, axis == 1, axis == 2};
        float sh[3 * SPIN_SH_MAX], out[3 * SPIN_SH_MAX];
        int good = 1;

        spin_scene_rotation_from(q, &t);
        for (int i = 0; i < 3 * SPIN_SH_MAX; i++)
            sh[i] = (float)i + 0.1f;
        spin_scene_rotation_sh(&t, SPIN_SH_MAX, sh, out);
        for (int i = 0; i < 3 * SPIN_SH_MAX; i++) {
            /* Not constants, which a compiler may round differently from a fused multiply-add. */
            volatile float x = 0.48f, y = 0.6f, z = 0.64f;
            spin_vec3 d = spin_v3(x, y, z);
            float before[SPIN_SH_MAX], after[SPIN_SH_MAX];

            spin_sh_basis(3, d, before);
            spin_sh_basis(3, spin_scene_rotation_place(&t, d), after);
            good &= fabsf(before[i / 3]) == fabsf(after[i / 3]);
            good &= out[i] == (before[i / 3] == after[i / 3] ? sh[i] : -sh[i]);
            if (axis != 1)
                good &= out[i] == (signs[axis][i / 3] == '-' ? -sh[i] : sh[i]);
        }
        ok(good && t.kind == SPIN_TURN_SIGNS, "half a turn about axis %d changes signs only", axis);
    }
}

TAP_MAIN
{
    static const double none[4] = {1, 0, 0, 0}, skew[4] = {0.18257418583505536, 0.3651483716701107,
                                                           0.5477225575051661, 0.7302967433402214};
    static const double r = 0.70710678118654752;
    const double quarter[4] = {r, -r, 0, 0};
    double joined[4];
    struct spin_scene_rotation t;

    for (int degree = 0; degree <= 3; degree++)
        test_sh("a colour turns with the scene", skew, degree);
    test_sh("by a quarter turn too", quarter, 3);
    test_rotation(skew);
    test_half_turns();
    spin_scene_rotation_from(none, &t);
    ok(t.kind == SPIN_TURN_NONE, "no turn is none");
    spin_scene_rotation_from(quarter, &t);
    ok(t.kind == SPIN_TURN_ANY && t.m[5] == 1 && t.m[7] == -1, "a quarter turn about x: z to y");
    spin_scene_rotation_join(quarter, quarter, joined);
    near(fabs(joined[1]), 1, 1e-12, "two quarters are a half");
}
