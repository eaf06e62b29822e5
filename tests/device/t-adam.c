/* Adam and the schedules: golden values of 12 steps, frames that are visited only in some steps,
 * learning rates; the same bits for any number of threads; zeros.
 * K: golden adam network threads */
#include "math/adam.h"
#include "tests/device/net.h"

/* Whether a gradient's square underflows in float32: golden values that depend on it cannot be
 * compared. */
static int vanishes(const float *grad, size_t n_steps, size_t n, size_t column)
{
    for (size_t i = 0; i < n_steps; i++) {
        double g = grad[i * n + column];

        if (g != 0 && 1e-3 * g * g < 1.2e-38)
            return 1;
    }
    return 0;
}

static void golden(const char *path)
{
    struct spin_npz npz;
    struct spin_array info;
    struct spin_device *d;
    double *lr, *want;
    float *p, *grad, *g, *m, *v, *got;
    double abs = check_tolerance("adam.npz", "p_abs", 2e-6);
    size_t n, n_steps, moved = 0;
    char what[64];

    if (!net_open("core/adam.npz", &npz))
        return;
    d = check_device(1);
    p = check_load_f32(&npz, "p0", NULL);
    grad = check_load_f32(&npz, "grad", &info);
    n_steps = (size_t)info.shape[0], n = (size_t)info.shape[1];
    lr = check_load(&npz, "lr", NULL);
    want = check_load(&npz, "p", NULL);
    g = net_floats(n), m = net_floats(n), v = net_floats(n), got = net_floats(n);
    for (size_t step = 1; step <= n_steps; step++) {
        double *w = want + (step - 1) * n;

        memcpy(g, grad + (step - 1) * n, n * sizeof *g);
        on_adam(d, n, p, g, m, v, lr[step - 1], (int64_t)step);
        memcpy(got, p, n * sizeof *p);
        for (size_t i = 0; i < n; i++)
            if (vanishes(grad, n_steps, n, i))
                got[i] = (float)w[i];
        snprintf(what, sizeof what, "golden p, step %zu (%s)", step, path);
        check_close(got, w, n, abs, 0, what);
    }
    for (size_t i = 0; i < n; i++)
        moved += g[i] != 0.0f;
    ok(moved == 0, "the gradient is left zero");
    free(p), free(grad), free(lr), free(want), free(g), free(m), free(v), free(got);
    spin_npz_close(&npz);
    check_device_free(d);
}

/* The first step has the length of the learning rate, whatever the gradient. */
static double first_move(const float *p0, const double *p, const double *visited, size_t n_frames,
                         size_t n)
{
    double most = 0;

    for (size_t i = 0; i < n_frames * n; i++)
        if (visited[i / n] != 0)
            most = larger(most, fabs(p[i] - p0[i]));
    return most;
}

/* A frame that is not in the batch keeps its moments and its step counter. */
static void golden_lazy(void)
{
    struct spin_npz npz;
    struct spin_array info;
    struct spin_device *d;
    float *p, *grad, *m, *v;
    double *visited, *want, lr;
    size_t n_steps, n_frames, n;
    int64_t *step;

    if (!net_open("core/adam_lazy.npz", &npz))
        return;
    d = check_device(1);
    p = check_load_f32(&npz, "p0", NULL);
    grad = check_load_f32(&npz, "grad", &info);
    n_steps = (size_t)info.shape[0], n_frames = (size_t)info.shape[1], n = (size_t)info.shape[2];
    visited = check_load(&npz, "visited", NULL);
    want = check_load(&npz, "p", NULL);
    m = net_floats(n_frames * n), v = net_floats(n_frames * n);
    step = net_alloc(n_frames, sizeof *step);
    lr = check_setting_or("adam_lazy.npz", "lr", first_move(p, want, visited, n_frames, n));
    for (size_t i = 0; i < n_steps; i++) {
        for (size_t f = 0; f < n_frames; f++)
            if (visited[i * n_frames + f] != 0)
                on_adam(d, n, p + f * n, grad + (i * n_frames + f) * n, m + f * n, v + f * n, lr,
                        ++step[f]);
        check_close(p, want + i * n_frames * n, n_frames * n,
                    check_tolerance("adam_lazy.npz", "p_abs", 1e-6), 0,
                    "golden p of frames visited now and then");
    }
    free(p), free(grad), free(visited), free(want), free(m), free(v), free(step);
    spin_npz_close(&npz);
    check_device_free(d);
}

/* Value at `when` of a schedule that is linear in the logarithm, from its ends at[0] and at[n - 1];
 * the reference's manifest does not name the two rates. */
static double at_line(const double *at, const double *want, size_t n, double when)
{
    double slope = log(want[n - 1] / want[0]) / (at[n - 1] - at[0]);

    return want[0] * exp(slope * (when - at[0]));
}

static void golden_exponential(struct spin_npz *npz, const char *key, const char *at_key,
                               const char *setting, double last)
{
    struct spin_array info;
    double *at = check_load(npz, at_key, &info), *want = check_load(npz, key, NULL);
    size_t n = (size_t)info.count;
    char name[64];
    double from, to;
    float *got = net_floats(n);

    snprintf(name, sizeof name, "%s.from", setting);
    from = check_setting_or("lr.npz", name, at_line(at, want, n, 0));
    snprintf(name, sizeof name, "%s.to", setting);
    to = check_setting_or("lr.npz", name, at_line(at, want, n, last));
    for (size_t i = 0; i < n; i++)
        got[i] = (float)spin_lr_exp(from, to, (int64_t)at[i], (int64_t)last);
    check_close(got, want, n, 0, check_tolerance("lr.npz", "rel", 1e-6), key);
    free(at), free(want), free(got);
}

static void golden_rates(void)
{
    static const char *const groups[] = {"encoder", "sh", "scale", "rot", "opacity", "position"};
    struct spin_npz npz;
    struct spin_array info;
    double rel = check_tolerance("lr.npz", "rel", 1e-6), *at, *want, last, warmup, end;
    float *got;

    if (!net_open("core/lr.npz", &npz))
        return;
    at = check_load(&npz, "iteration", &info);
    got = net_floats((size_t)info.count);
    last = check_setting("lr.npz", "iterations");
    warmup = check_setting("lr.npz", "warmup");
    end = check_setting("lr.npz", "lr_end");
    for (size_t k = 0; k < sizeof groups / sizeof groups[0]; k++) {
        char key[64];
        double lr0;

        snprintf(key, sizeof key, "lr0.%s", groups[k]);
        lr0 = check_setting("lr.npz", key);
        snprintf(key, sizeof key, "lr_%s", groups[k]);
        want = check_load(&npz, key, NULL);
        for (size_t i = 0; i < info.count; i++)
            got[i] = (float)spin_lr(lr0, end, (int64_t)at[i], (int64_t)warmup, (int64_t)last);
        check_close(got, want, (size_t)info.count, 0, rel, key);
        free(want);
    }
    golden_exponential(&npz, "lr_position_exp", "iteration", "position_exp", last);
    golden_exponential(&npz, "lr_position_refine", "iteration_refine", "position_refine",
                       check_setting_or("lr.npz", "position_refine.iterations", 2000));
    free(at), free(got);
    spin_npz_close(&npz);
    near(spin_lr(1e-3, 1e-7, 1, 0, 1), 1e-7, 0, "a run of one iteration without warm-up");
    near(spin_lr(1e-3, 1e-7, 5, 5, 5), 1e-3, 0, "a run that is all warm-up");
}

static void threads_and_paths(void)
{
    size_t n = check_device_is_cpu() ? 100003 : 10007;
    float *p0 = net_random(n, 1, -1, 1), *g0 = net_random(n, 2, -1e-3f, 1e-3f);
    float *m0 = net_random(n, 3, -1e-3f, 1e-3f), *v0 = net_random(n, 4, 0, 1e-6f), *first = NULL;

    for (int k = 0; k < check_n_threads(); k++) {
        struct spin_device *d = check_device(check_thread_counts[k]);
        float *p = net_copy(p0, n), *g = net_copy(g0, n), *m = net_copy(m0, n),
              *v = net_copy(v0, n);

        on_adam(d, n, p, g, m, v, 1e-2, 7);
        if (first)
            check_same_bits(p, first, n * 4, "same bits for any number of threads");
        else
            first = net_copy(p, n);
        free(p), free(g), free(m), free(v);
        check_device_free(d);
    }
    free(p0), free(g0), free(m0), free(v0), free(first);
}

static void sane(void)
{
    struct spin_device *d = check_device(1);
    float p[] = {1, 1, 1, 1, 1}, g[] = {0, 1e-30f, 1e30f, NAN, 0}, m[5] = {0}, v[5] = {0};

    m[4] = 1e-39f;
    on_adam(d, 5, p, g, m, v, 1e-3, 1);
    ok(p[0] == 1.0f, "no gradient and no momentum: no move");
    ok(!isnan(p[1]) && !isnan(p[2]), "tiny and huge gradients give numbers");
    ok(isnan(p[3]) && !isnan(p[4]), "NaN stays in its own parameter");
    on_adam(d, 0, p, g, m, v, 1e-3, 1);
    check_device_free(d);
}

/* Many groups in one call, some of them empty, give the same result as separate calls. */
static void many_groups(void)
{
    enum { GROUPS = 70, MOST = 700 };
    struct spin_device *d = check_device(2);
    struct spin_param_group group[GROUPS];
    struct loans l = {.d = d};
    size_t n = 0, at = 0;
    float *value[4], *alone[4];
    float SPIN_DEV *card[4];

    for (int k = 0; k < GROUPS; k++)
        n += (size_t)(k * k * 37 % MOST);
    for (int i = 0; i < 4; i++) {
        value[i] = net_random(n, 60 + (uint64_t)i, i == 3 ? 0.1f : -1, 1);
        alone[i] = net_copy(value[i], n);
        card[i] = lend_both(&l, value[i], n * sizeof(float));
    }
    for (int k = 0; k < GROUPS; k++) {
        size_t some = (size_t)(k * k * 37 % MOST);

        group[k] = (struct spin_param_group){.p = card[0] + at,
                                             .g = card[1] + at,
                                             .m = card[2] + at,
                                             .v = card[3] + at,
                                             .n = some,
                                             .lr = 0.01 * (k + 1),
                                             .step = k + 1};
        at += some;
    }
    d->op->adam(d, GROUPS, group);
    settle(&l);
    for (int k = 0; k < GROUPS; k++) {
        at = k == 0 ? 0 : at + group[k - 1].n;
        if (group[k].n > 0)
            on_adam(d, group[k].n, alone[0] + at, alone[1] + at, alone[2] + at, alone[3] + at,
                    group[k].lr, group[k].step);
    }
    for (int i = 0; i < 4; i++)
        check_same_bits(value[i], alone[i], n * sizeof(float), "many groups: each as if alone");
    for (int i = 0; i < 4; i++)
        free(value[i]), free(alone[i]);
    check_device_free(d);
}

/* NaN and infinity are counted at any position; large and tiny values are not. */
static void not_finite(void)
{
    enum { MOST = 200001 };
    static float values[MOST];
    struct spin_device *d = check_device(2);
    struct loans l = {.d = d};
    uint32_t count = 5;
    float SPIN_DEV *at;
    uint32_t SPIN_DEV *counted;

    for (int i = 0; i < MOST; i++)
        values[i] = i % 3 ? 3.4e38f : i % 2 ? -1e-45f : -0.0f;
    values[0] = NAN;
    values[70000] = -NAN;
    values[131072] = INFINITY;
    values[MOST - 1] = -INFINITY;
    at = lend(&l, values, sizeof values);
    counted = lend_both(&l, &count, sizeof count);
    d->op->not_finite(d, MOST, at, counted);
    d->op->not_finite(d, 70000, at + 1, counted); /* including the second bad value */
    d->op->not_finite(d, 69999, at + 1, counted); /* excluding it */
    d->op->not_finite(d, 0, at, counted);
    settle(&l);
    ok(count == 5 + 4 + 1, "not_finite counts NaN and infinity (%u)", count);
    check_device_free(d);
}

TAP_MAIN
{
    not_finite();
    for (int i = 0; i < N_NET_PATHS; i++)
        if (net_path(net_paths[i]))
            golden(net_paths[i]);
    unsetenv("SPIN_CPU");
    golden_lazy();
    golden_rates();
    threads_and_paths();
    sane();
    many_groups();
}
