/* Adam and the schedules: golden values of 12 steps, frames visited now and then, learning rates;
 * the same bits for any number of threads; zeros.
 * K: golden adam network threads */
#include "math/adam.h"
#include "tests/device/net.h"

static void golden(const char *path)
{
    struct spin_npz npz;
    struct spin_device *d;
    double *lr, *want;
    float *p, *grad, g[30], m[30] = {0}, v[30] = {0};
    double abs = check_tolerance("adam.npz", "p_abs", 2e-6);
    char what[64];

    if (!net_open("core/adam.npz", &npz))
        return;
    d = check_device(1);
    p = check_load_f32(&npz, "p0", NULL);
    grad = check_load_f32(&npz, "grad", NULL);
    lr = check_load(&npz, "lr", NULL);
    want = check_load(&npz, "p", NULL);
    for (int step = 1; step <= 12; step++) {
        float got[30];
        double *w = want + (step - 1) * 30;

        memcpy(g, grad + (step - 1) * 30, sizeof g);
        d->op->adam(d, 30, p, g, m, v, lr[step - 1], step);
        memcpy(got, p, sizeof got);
        got[2] = (float)w[2]; /* v vanishes in float: not for float32, says the fixture */
        snprintf(what, sizeof what, "golden p, step %d (%s)", step, path);
        check_close(got, w, 30, abs, 0, what);
    }
    for (int i = 0; i < 30; i++)
        if (g[i] != 0.0f)
            ok(0, "g[%d] is left zero", i);
    free(p), free(grad), free(lr), free(want);
    spin_npz_close(&npz);
    check_device_free(d);
}

/* A frame that is not in the batch keeps its moments and its step counter. */
static void golden_lazy(void)
{
    struct spin_npz npz;
    struct spin_device *d;
    float *p, *grad, m[15] = {0}, v[15] = {0};
    double *visited, *want;
    int64_t step[3] = {0};

    if (!net_open("core/adam_lazy.npz", &npz))
        return;
    d = check_device(1);
    p = check_load_f32(&npz, "p0", NULL);
    grad = check_load_f32(&npz, "grad", NULL);
    visited = check_load(&npz, "visited", NULL);
    want = check_load(&npz, "p", NULL);
    for (int i = 0; i < 6; i++) {
        for (int f = 0; f < 3; f++)
            if (visited[i * 3 + f] != 0)
                d->op->adam(d, 5, p + f * 5, grad + (i * 3 + f) * 5, m + f * 5, v + f * 5, 1e-3,
                            ++step[f]);
        check_close(p, want + i * 15, 15, check_tolerance("adam_lazy.npz", "p_abs", 1e-6), 0,
                    "golden p of frames visited now and then");
    }
    free(p), free(grad), free(visited), free(want);
    spin_npz_close(&npz);
    check_device_free(d);
}

static void golden_rates(void)
{
    static const struct {
        const char *key;
        double lr0;
    } groups[] = {{"lr_encoder", 8e-3}, {"lr_sh", 1e-3},      {"lr_scale", 3e-4},
                  {"lr_rot", 3e-5},     {"lr_opacity", 8e-4}, {"lr_position", 8e-4}};
    struct spin_npz npz;
    struct spin_array info;
    double rel = check_tolerance("lr.npz", "rel", 1e-6), *at, *want;
    float got[32];

    if (!net_open("core/lr.npz", &npz))
        return;
    at = check_load(&npz, "iteration", &info);
    for (size_t k = 0; k < sizeof groups / sizeof groups[0]; k++) {
        want = check_load(&npz, groups[k].key, NULL);
        for (size_t i = 0; i < info.count; i++)
            got[i] = (float)spin_lr(groups[k].lr0, 1e-7, (int64_t)at[i], 1000, 40000);
        check_close(got, want, (size_t)info.count, 0, rel, groups[k].key);
        free(want);
    }
    want = check_load(&npz, "lr_position_exp", NULL);
    for (size_t i = 0; i < info.count; i++)
        got[i] = (float)spin_lr_exp(8e-4, 8e-6, (int64_t)at[i], 40000);
    check_close(got, want, (size_t)info.count, 0, rel, "lr_position_exp");
    free(want), free(at);
    at = check_load(&npz, "iteration_refine", &info);
    want = check_load(&npz, "lr_position_refine", NULL);
    for (size_t i = 0; i < info.count; i++)
        got[i] = (float)spin_lr_exp(8e-4, 8e-6, (int64_t)at[i], 2000);
    check_close(got, want, (size_t)info.count, 0, rel, "lr_position_refine");
    free(want), free(at);
    spin_npz_close(&npz);
    near(spin_lr(1e-3, 1e-7, 1, 0, 1), 1e-7, 0, "a run of one iteration without warm-up");
    near(spin_lr(1e-3, 1e-7, 5, 5, 5), 1e-3, 0, "a run that is all warm-up");
}

static void threads_and_paths(void)
{
    size_t n = 100003;
    float *p0 = net_random(n, 1, -1, 1), *g0 = net_random(n, 2, -1e-3f, 1e-3f);
    float *m0 = net_random(n, 3, -1e-3f, 1e-3f), *v0 = net_random(n, 4, 0, 1e-6f), *first = NULL;
    int threads[] = {1, 2, 3, 8};

    for (int k = 0; k < 4; k++) {
        struct spin_device *d = check_device(threads[k]);
        float *p = net_copy(p0, n), *g = net_copy(g0, n), *m = net_copy(m0, n),
              *v = net_copy(v0, n);

        d->op->adam(d, n, p, g, m, v, 1e-2, 7);
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
    d->op->adam(d, 5, p, g, m, v, 1e-3, 1);
    ok(p[0] == 1.0f, "no gradient and no momentum: no move");
    ok(!isnan(p[1]) && !isnan(p[2]), "tiny and huge gradients give numbers");
    ok(isnan(p[3]) && !isnan(p[4]), "NaN stays in its own parameter");
    d->op->adam(d, 0, p, g, m, v, 1e-3, 1);
    check_device_free(d);
}

TAP_MAIN
{
    for (int i = 0; i < N_NET_PATHS; i++)
        if (net_path(net_paths[i]))
            golden(net_paths[i]);
    unsetenv("SPIN_CPU");
    golden_lazy();
    golden_rates();
    threads_and_paths();
    sane();
}
