/* K: export merge lod */
#include "geometry/merge_splats.h"

#include "base/base.h"
#include "math/activate.h"
#include "math/covariance.h"
#include "math/sh.h"
#include "tests/tap.h"

#define close_to(got, want, tolerance, ...) ok(fabs((got) - (want)) <= (tolerance), __VA_ARGS__)

static void start(struct spin_splats *s, size_t n, int degree)
{
    ok(spin_splats_reserve(s, n, SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES, degree) == SPIN_OK,
       "memory for %zu splats", n);
    memset(s->sh, 0, n * 3 * (size_t)spin_sh_count(degree) * sizeof *s->sh);
}

/* A splat with standard deviations `size`, an opacity, and the same value in all SH. */
static void put(struct spin_splats *s, size_t i, double x, double y, double z, const double size[3],
                double opacity, double colour)
{
    const float quat[4] = {1, 0, 0, 0}, at[3] = {(float)x, (float)y, (float)z};
    size_t n = 3 * (size_t)spin_sh_count(s->sh_degree);

    memcpy(s->means + 3 * i, at, sizeof at);
    memcpy(s->quats + 4 * i, quat, sizeof quat);
    for (size_t c = 0; c < 3; c++)
        s->log_scales[3 * i + c] = (float)log(size[c]);
    s->logit_opacities[i] = (float)log(opacity / (1 - opacity));
    for (size_t k = 0; k < n; k++)
        s->sh[n * i + k] = (float)colour;
}

static double opacity_of(const struct spin_splats *s, size_t i)
{
    return spin_sigmoid_of((double)s->logit_opacities[i]);
}

static void covariance(const struct spin_splats *s, size_t i, double cov[6])
{
    double scale[3], quat[4];

    for (size_t c = 0; c < 3; c++)
        scale[c] = exp((double)s->log_scales[3 * i + c]);
    for (size_t c = 0; c < 4; c++)
        quat[c] = (double)s->quats[4 * i + c];
    spin_covariance_of(scale, quat, cov);
}

/* Two splats of different size and opacity: all values by the formulas of a mixture. */
static void check_pair(void)
{
    struct spin_splats in = {0}, out = {0};
    const double size_a[3] = {0.3, 0.2, 0.1}, size_b[3] = {0.2, 0.1, 0.1};
    /* Areas: the roots of the sums of squared products of two standard deviations. */
    double area_a = sqrt(pow(0.06, 2) + pow(0.03, 2) + pow(0.02, 2));
    double area_b = sqrt(pow(0.02, 2) + pow(0.02, 2) + pow(0.01, 2));
    double wa = 0.4 * area_a, wb = 0.2 * area_b, share = wb / (wa + wb), error = 0;
    double want[6] = {0}, cov[6], area;

    start(&in, 2, 1);
    put(&in, 0, 1, 2, 3, size_a, 0.4, 0.5);
    put(&in, 1, 1.5, 2, 2.8, size_b, 0.2, -0.25);
    ok(spin_merge_splats(&in, 1, &out, &error) == SPIN_OK && out.n == 1, "two splats become one");
    close_to((double)out.means[0], 1 + 0.5 * share, 1e-6, "x is the weighted mean");
    close_to((double)out.means[1], 2, 1e-6, "y is the weighted mean");
    close_to((double)out.means[2], 3 - 0.2 * share, 1e-6, "z is the weighted mean");
    for (int i = 0, at = 0; i < 3; i++) {
        const double off[3] = {0.5, 0, -0.2};

        for (int j = i; j < 3; j++, at++)
            want[at] = (i == j ? (1 - share) * pow(size_a[i], 2) + share * pow(size_b[i], 2) : 0) +
                       share * (1 - share) * off[i] * off[j];
    }
    covariance(&out, 0, cov);
    for (int at = 0; at < 6; at++)
        close_to(cov[at], want[at], 1e-6, "element %d of the covariance is that of the mixture",
                 at);
    area = sqrt(want[0] * want[3] - want[1] * want[1] + want[0] * want[5] - want[2] * want[2] +
                want[3] * want[5] - want[4] * want[4]);
    close_to(opacity_of(&out, 0), (wa + wb) / area, 1e-5, "opacity times area is the sum of both");
    for (int k = 0; k < 12; k++)
        close_to((double)out.sh[k], 0.5 * (1 - share) - 0.25 * share, 1e-6, "coefficient %d", k);
    close_to(error,
             wa * wb / (wa + wb) *
                 (3 * pow(SPIN_SH_C0 * 0.75, 2) + 0.3 * fmax(0, area / (area_a + area_b) - 0.8)),
             1e-7, "the cost has a part of the colour and one of the area");
    spin_splats_free(&in);
    spin_splats_free(&out);
}

/* Equal opaque splats at one place have more weight than an opacity of 1 can express. */
static void check_opaque(void)
{
    struct spin_splats in = {0}, out = {0};
    const double size[3] = {0.1, 0.1, 0.1};
    double error = 1, cov[6];

    start(&in, 2, 0);
    put(&in, 0, 0, 0, 0, size, 0.9, 0.5);
    put(&in, 1, 0, 0, 0, size, 0.9, 0.5);
    ok(spin_merge_splats(&in, 1, &out, &error) == SPIN_OK && out.n == 1, "two opaque splats");
    close_to(opacity_of(&out, 0), 0.999, 1e-4, "the opacity is nearly 1");
    covariance(&out, 0, cov);
    close_to(cov[0], 0.01 * sqrt(1.8 / 0.999), 1e-5,
             "the area takes the square root of the excess");
    close_to(error, 1, 1e-12, "equal splats cost nothing, and the sum is kept");
    spin_splats_free(&in);
    spin_splats_free(&out);
}

/* A chequered wall, in whose middle every splat has a twin: the twins go first, and the squares do
 * not mix. */
static void check_order(void)
{
    enum { SIDE = 40, N = SIDE * SIDE };
    struct spin_splats in = {0}, out = {0}, again = {0};
    const double size[3] = {0.3, 0.3, 0.01};
    double error = 0, cheap = 0, mixed = 0;
    size_t n = 0;

    start(&in, N + 100, 0);
    for (int i = 0; i < N; i++)
        put(&in, n++, i % SIDE, i / SIDE, 0, size, 0.5, (i % SIDE / 8 + i / SIDE / 8) % 2 ? 1 : -1);
    for (int i = 0; i < 100; i++) {
        memcpy(in.means + 3 * n, in.means + 3 * i, 3 * sizeof *in.means);
        put(&in, n++, i % SIDE, i / SIDE, 0, size, 0.25,
            (i % SIDE / 8 + i / SIDE / 8) % 2 ? 1 : -1);
    }
    ok(spin_merge_splats(&in, N, &out, &cheap) == SPIN_OK && out.n == N, "100 merges");
    close_to(cheap, 0, 1e-9, "the twins are merged first, at no cost");
    ok(spin_merge_splats(&in, N / 4, &out, &error) == SPIN_OK && out.n == N / 4,
       "several rounds reach a quarter exactly");
    for (size_t i = 0; i < out.n; i++)
        mixed += fabs((double)out.sh[3 * i]) < 0.99;
    ok(mixed == 0, "no splat has a mixed colour (%g have)", mixed);
    ok(error > 0, "merging neighbours has a cost");
    ok(spin_merge_splats(&in, N / 4, &again, &error) == SPIN_OK &&
           memcmp(again.means, out.means, out.n * 3 * sizeof *out.means) == 0,
       "a second call gives the same splats");
    ok(spin_merge_splats(&in, N + 100, &out, &error) == SPIN_OK && out.n == N + 100,
       "nothing is merged if all may stay");
    ok(spin_merge_splats(&in, 1, &out, &error) == SPIN_OK && out.n == 1, "down to a single splat");
    spin_splats_free(&in);
    spin_splats_free(&out);
    spin_splats_free(&again);
}

/* Equal splats: a round merges pairs that have no splat in common. Rows that a frame lacks, and
 * rows to skip, take no part. */
static void check_plan(void)
{
    enum { N = 8 };
    struct spin_splats in = {0}, out = {0};
    struct spin_merge_plan plan;
    const double size[3] = {0.1, 0.1, 0.1};
    unsigned char skip[N] = {0};
    int uses[N] = {0};
    bool disjoint = true;
    uint32_t into;

    start(&in, N, 0);
    for (size_t i = 0; i < N; i++)
        put(&in, i, 0, 0, 0, size, 0.3, 0.5);
    ok(spin_merge_plan_make(&in, 1, NULL, N - 3, &plan) == SPIN_OK && plan.n == 3, "three merges");
    for (size_t i = 0; i < plan.n; i++)
        disjoint = disjoint && ++uses[plan.pair[i][0]] == 1 && ++uses[plan.pair[i][1]] == 1;
    ok(disjoint, "of six splats");
    into = plan.pair[0][0];
    ok(spin_merge_plan_apply(&plan, &in, NULL, &out) == SPIN_OK && opacity_of(&out, into) > 0.5,
       "two become one");
    skip[plan.pair[0][1]] = 1;
    ok(spin_merge_plan_apply(&plan, &in, skip, &out) == SPIN_OK && out.n == N, "one is skipped");
    close_to(opacity_of(&out, into), 0.3, 1e-6, "the other stays as it is");
    in.n = plan.pair[2][1];
    ok(spin_merge_plan_apply(&plan, &in, NULL, &out) == SPIN_OK && out.n == in.n,
       "a frame that lacks a row");
    in.n = N;
    spin_merge_plan_free(&plan);
    spin_splats_free(&in);
    spin_splats_free(&out);
}

TAP_MAIN
{
    check_pair();
    check_opaque();
    check_order();
    check_plan();
}
