/* Contraction to the unit cube: golden values and gradients, finite differences, the same bits for
 * any number of threads, distant points.
 * K: golden contract network threads */
#include "math/contract.h"
#include "tests/device/net.h"

static const struct spin_scene_transform identity = {.inv_radius = 1.0f};

static void golden(const char *path)
{
    struct spin_npz npz;
    struct spin_array info;
    struct spin_device *d;
    float *mu, *v, *x, *d_x, *got, *d_mu;
    double *want, *slope, abs = check_tolerance("contract.npz", "abs", 1e-6);
    double rel = check_tolerance("contract.npz", "rel", 1e-5);
    size_t n;
    char what[64];

    if (!net_open("core/contract.npz", &npz))
        return;
    d = check_device(1);
    mu = check_load_f32(&npz, "mu", &info);
    v = check_load_f32(&npz, "v", NULL);
    want = check_load(&npz, "normalised", NULL);
    slope = check_load(&npz, "grad_mu", NULL);
    n = (size_t)info.shape[0];
    x = net_floats(n * 4);
    d_x = net_floats(n * 4);
    got = net_floats(n * 3);
    d_mu = net_floats(n * 3);
    on_contract(d, &identity, n, mu, 0.25f, x);
    for (size_t i = 0; i < n; i++) {
        memcpy(got + i * 3, x + i * 4, 3 * sizeof *got);
        memcpy(d_x + i * 4, v + i * 3, 3 * sizeof *got);
        d_x[i * 4 + 3] = 1e3f; /* the gradient with respect to time is not used */
    }
    on_contract_back(d, &identity, n, NULL, mu, d_x, d_mu);
    snprintf(what, sizeof what, "golden normalised (%s)", path);
    check_close(got, want, n * 3, abs, rel, what);
    snprintf(what, sizeof what, "golden grad_mu (%s)", path);
    check_close(d_mu, slope, n * 3, abs, rel, what);
    ok(x[3] == 0.25f, "time is the fourth coordinate");
    free(mu), free(v), free(x), free(d_x), free(got), free(d_mu), free(want), free(slope);
    spin_npz_close(&npz);
    check_device_free(d);
}

/* The map in double, dotted with g. */
static double dotted(const struct spin_scene_transform *transform, const double p_w[3],
                     const float g[3])
{
    double p[3], r2 = 0, s = 1, sum = 0;

    for (int k = 0; k < 3; k++) {
        p[k] = (p_w[k] - transform->centre[k]) * transform->inv_radius;
        r2 += p[k] * p[k];
    }
    if (r2 > 1)
        s = (2 - 1 / sqrt(r2)) / sqrt(r2);
    for (int k = 0; k < 3; k++)
        sum += (s * p[k] / 4 + 0.5) * g[k];
    return sum;
}

static void differences(void)
{
    struct spin_scene_transform transform = {.centre = {0.5f, -1.25f, 2.0f}, .inv_radius = 0.4f};
    struct spin_device *d = check_device(1);
    size_t n = 2000;
    float *pos = net_random(n * 3, 1, -8.0f, 8.0f), *d_x = net_random(n * 4, 2, -1.0f, 1.0f);
    float *d_pos = net_floats(n * 3);
    double worst = 0;

    on_contract_back(d, &transform, n, NULL, pos, d_x, d_pos);
    for (size_t i = 0; i < n * 3; i++) {
        const float *at = pos + i / 3 * 3, *g = d_x + i / 3 * 4;
        double h = 1e-5, a[3] = {at[0], at[1], at[2]}, b[3] = {at[0], at[1], at[2]};

        a[i % 3] -= h;
        b[i % 3] += h;
        worst = larger(worst, fabs((dotted(&transform, b, g) - dotted(&transform, a, g)) / (2 * h) -
                                   d_pos[i]));
    }
    near(worst, 0, 2e-7, "slopes are central differences, with centre and radius");
    free(pos), free(d_x), free(d_pos);
    check_device_free(d);
}

/* An ablation: without contraction, points are only translated and scaled. */
static void uncontracted(void)
{
    struct spin_scene_transform transform = {
        .centre = {0.5f, 0, -0.25f}, .inv_radius = 0.5f, .raw = true};
    float pos[] = {1.5f, 0.5f, 0.75f, 9, -9, 0}, d_x[] = {1, 2, 3, 4, 5, 6, 7, 8};
    float want[] = {0.5f, 0.25f, 0.5f, 0.5f, 4.25f, -4.5f, 0.125f, 0.5f};
    float want_d[] = {0.5f, 1, 1.5f, 2.5f, 3, 3.5f}, x[8], d_pos[6] = {0};
    struct spin_device *d = check_device(1);

    on_contract(d, &transform, 2, pos, 0.5f, x);
    on_contract_back(d, &transform, 2, NULL, pos, d_x, d_pos);
    check_same_bits(x, want, sizeof x, "raw: outside stays outside");
    check_same_bits(d_pos, want_d, sizeof d_pos, "raw: the slope is the scale");
    check_device_free(d);
}

static void rows_and_threads(void)
{
    size_t n = 10001, n_rows;
    uint32_t *rows;
    float *pos = net_random(n * 3, 3, -4.0f, 4.0f), *d_x = net_random(n * 4, 4, -1.0f, 1.0f);
    float *x1 = net_floats(n * 4), *x = net_floats(n * 4), *d1 = net_floats(n * 3), *d2;
    int good = 1;

    n_rows = net_rows(n, &rows);
    for (int k = 0; k < check_n_threads(); k++) {
        struct spin_device *d = check_device(check_thread_counts[k]);

        d2 = net_floats(n * 3);
        on_contract(d, &identity, n, pos, 0.5f, k ? x : x1);
        on_contract_back(d, &identity, n_rows, rows, pos, d_x, d2);
        if (k) {
            check_same_bits(x, x1, n * 16, "forward: same bits for any number of threads");
            check_same_bits(d2, d1, n * 12, "backward: same bits for any number of threads");
        } else {
            memcpy(d1, d2, n * 12);
        }
        free(d2);
        check_device_free(d);
    }
    for (size_t i = 0; i < n; i++)
        if (i % 3 != 1)
            good &= d1[i * 3] == 0 && d1[i * 3 + 1] == 0 && d1[i * 3 + 2] == 0;
    ok(good && d1[3] != 0, "only the listed rows get a gradient");
    free(pos), free(d_x), free(x), free(x1), free(d1), free(rows);
}

/* Two frames of a batch get the gradients that their rows get as one frame. */
static void frames_of_a_batch(void)
{
    enum { FIRST = 300, N = 700 };
    struct spin_device *d = check_device(2);
    struct loans l = {.d = d};
    struct spin_frame_batch frames = {.n_frames = 2, .n = N};
    struct spin_active active = lend_active(&l, NULL, N);
    float *pos = net_random(N * 3, 7, -4.0f, 4.0f), *d_x = net_random(N * 4, 8, -1.0f, 1.0f);
    float *want = net_floats(N * 3), *got = net_floats(N * 3);

    on_contract_back(d, &identity, N, NULL, pos, d_x, want);
    for (int f = 0; f < 2; f++) {
        struct spin_frame_of_batch *frame = &frames.frame[f];

        frame->first = f ? FIRST : 0;
        frame->n = f ? N - FIRST : FIRST;
        frame->means = lend(&l, pos + 3 * frame->first, frame->n * 12);
        frame->d_means = lend_both(&l, got + 3 * frame->first, frame->n * 12);
    }
    d->op->contract_back(d, &identity, &frames, &active, lend(&l, d_x, N * 16));
    settle(&l);
    check_same_bits(got, want, N * 12, "backward: frames of a batch");
    free(pos), free(d_x), free(want), free(got);
    check_device_free(d);
}

static void sane(void)
{
    float pos[] = {0, 0,      0, 1e30f, -1e30f, 1e30f, INFINITY, -INFINITY, 0, 3e38f, 0,
                   0, 1e-40f, 0, 0,     1,      0,     0,        NAN,       0, 0};
    float x[28], d_x[28], d_pos[21] = {0};
    struct spin_device *d = check_device(1);
    int inside = 1;

    for (int i = 0; i < 28; i++)
        d_x[i] = 1.0f;
    on_contract(d, &identity, 7, pos, 7.0f, x);
    on_contract_back(d, &identity, 7, NULL, pos, d_x, d_pos);
    for (int i = 0; i < 24; i++)
        inside &= x[i] >= 0.0f && x[i] <= 1.0f;
    ok(inside, "huge and infinite points land in the cube");
    ok(x[12] == 1.0f && x[13] == 0.5f, "the far end of an axis is its border");
    ok(net_n_nan(d_pos, 18) == 0, "their gradients are numbers");
    ok(x[3] == 1.0f, "time is clamped to [0, 1]");
    check_device_free(d);
}

TAP_MAIN
{
    for (int i = 0; i < N_NET_PATHS; i++)
        if (net_path(net_paths[i]))
            golden(net_paths[i]);
    unsetenv("SPIN_CPU");
    differences();
    uncontracted();
    rows_and_threads();
    frames_of_a_batch();
    sane();
}
