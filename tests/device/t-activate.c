/* Activated attributes: golden values and gradients, finite differences, threads, extreme values;
 * the list of rows with a gradient.
 * K: golden attr network threads */
#include "tests/device/net.h"

static void copy_columns(float *rows, const float *part, size_t n, int at, int width)
{
    for (size_t i = 0; i < n; i++)
        memcpy(rows + i * SPIN_ATTR + at, part + i * (size_t)width, (size_t)width * sizeof *rows);
}

static void compare(struct spin_npz *npz, const char *key, const float *rows, size_t n, int at,
                    int width, const char *path)
{
    double *want = check_load(npz, key, NULL);
    float *got = net_floats(n * (size_t)width);
    char what[64];

    for (size_t i = 0; i < n; i++)
        memcpy(got + i * (size_t)width, rows + i * SPIN_ATTR + at, (size_t)width * sizeof *got);
    snprintf(what, sizeof what, "golden %s (%s)", key, path);
    check_close(got, want, n * (size_t)width, check_tolerance("activations.npz", "abs", 1e-7),
                check_tolerance("activations.npz", "rel", 2e-5), what);
    free(want), free(got);
}

static void golden(const char *path)
{
    struct spin_npz npz;
    struct spin_array info;
    struct spin_device *d;
    const char *raw_keys[] = {"shat", "rhat", "ohat"}, *grad_keys[] = {"vs", "vr", "vo"};
    int at[] = {SPIN_ATTR_SCALE, SPIN_ATTR_ROTATION, SPIN_ATTR_OPACITY}, width[] = {3, 4, 1};
    float *raw, *d_attr, *attr, *d_raw;
    size_t n;

    if (!net_open("core/activations.npz", &npz))
        return;
    free(check_load(&npz, "ohat", &info));
    n = (size_t)info.shape[0];
    d = check_device(1);
    raw = net_random(n * SPIN_ATTR, 1, -1, 1);
    d_attr = net_random(n * SPIN_ATTR, 2, -1, 1);
    attr = net_floats(n * SPIN_ATTR);
    d_raw = net_floats(n * SPIN_ATTR);
    for (int k = 0; k < 3; k++) {
        float *r = check_load_f32(&npz, raw_keys[k], &info);
        float *g = check_load_f32(&npz, grad_keys[k], NULL);

        copy_columns(raw, r, n, at[k], width[k]);
        copy_columns(d_attr, g, n, at[k], width[k]);
        free(r), free(g);
    }
    on_activate(d, n, raw, attr);
    on_activate_back(d, n, NULL, raw, d_attr, d_raw);
    compare(&npz, "scale", attr, n, SPIN_ATTR_SCALE, 3, path);
    compare(&npz, "rot", attr, n, SPIN_ATTR_ROTATION, 4, path);
    compare(&npz, "opacity", attr, n, SPIN_ATTR_OPACITY, 1, path);
    compare(&npz, "grad_shat", d_raw, n, SPIN_ATTR_SCALE, 3, path);
    compare(&npz, "grad_rhat", d_raw, n, SPIN_ATTR_ROTATION, 4, path);
    compare(&npz, "grad_ohat", d_raw, n, SPIN_ATTR_OPACITY, 1, path);
    check_same_bits(attr + SPIN_ATTR_SH, raw + SPIN_ATTR_SH, 48 * sizeof *raw, "colour as it is");
    check_same_bits(d_raw + SPIN_ATTR_SH, d_attr + SPIN_ATTR_SH, 48 * sizeof *raw,
                    "its gradient as it is");
    free(raw), free(d_attr), free(attr), free(d_raw);
    spin_npz_close(&npz);
    check_device_free(d);
}

/* The attributes of one row in double, dotted with g. */
static double dotted(const double *h, const float *g)
{
    double sum = g[55] / (1 + exp(-h[55])), transform = 0;

    for (int k = 0; k < 3; k++)
        sum += g[k] * exp(h[k]);
    for (int k = 3; k < 7; k++)
        transform += h[k] * h[k];
    for (int k = 3; k < 7; k++)
        sum += g[k] * h[k] / sqrt(transform);
    for (int k = 7; k < 55; k++)
        sum += g[k] * h[k];
    return sum;
}

static void differences(void)
{
    struct spin_device *d = check_device(1);
    size_t n = 50;
    float *raw = net_random(n * SPIN_ATTR, 3, -2, 2), *g = net_random(n * SPIN_ATTR, 4, -1, 1);
    float *d_raw = net_floats(n * SPIN_ATTR);
    double worst = 0, h = 1e-5;

    on_activate_back(d, n, NULL, raw, g, d_raw);
    for (size_t i = 0; i < n; i++) {
        double row[SPIN_ATTR], up, down;

        for (int k = 0; k < SPIN_ATTR; k++)
            row[k] = raw[i * SPIN_ATTR + (size_t)k];
        for (int k = 0; k < SPIN_ATTR; k++) {
            double keep = row[k];

            row[k] = keep + h;
            up = dotted(row, g + i * SPIN_ATTR);
            row[k] = keep - h;
            down = dotted(row, g + i * SPIN_ATTR);
            row[k] = keep;
            worst = larger(worst, fabs((up - down) / (2 * h) - d_raw[i * SPIN_ATTR + (size_t)k]));
        }
    }
    near(worst, 0, 3e-6, "slopes are central differences");
    free(raw), free(g), free(d_raw);
    check_device_free(d);
}

static void rows_and_threads(void)
{
    size_t n = 5003, n_rows;
    uint32_t *rows, *found = net_alloc(n, sizeof *found);
    float *raw = net_random(n * SPIN_ATTR, 5, -3, 3), *g = net_random(n * SPIN_ATTR, 6, -1, 1);
    float *attr[2], *d_raw[2], *full = net_floats(n * SPIN_ATTR), *d_pos = net_floats(n * 3);
    int good = 1;

    n_rows = net_rows(n, &rows);
    for (int k = 0; k < 2; k++) {
        attr[k] = net_floats(n * SPIN_ATTR);
        d_raw[k] = net_floats(n * SPIN_ATTR);
    }
    for (size_t i = 0; i < n; i++)
        if (i % 3 != 1)
            memset(g + i * SPIN_ATTR, 0, SPIN_ATTR * sizeof *g);
    g[2 * SPIN_ATTR + 5] = -0.0f;                              /* counts as zero */
    memset(g + SPIN_ATTR + 1, 0, (SPIN_ATTR - 1) * sizeof *g); /* the first value alone */
    memset(g + 4 * SPIN_ATTR, 0, (SPIN_ATTR - 1) * sizeof *g); /* the last alone */
    for (int k = 0; k < check_n_threads(); k++) {
        struct spin_device *d = check_device(check_thread_counts[k]);
        size_t n_found = on_nonzero_grad(d, n, g, d_pos, found);

        ok(n_found == n_rows && memcmp(found, rows, n_rows * sizeof *rows) == 0,
           "active lists the rows with a gradient, %d threads", check_thread_counts[k]);
        on_activate(d, n, raw, attr[k > 0]);
        on_activate_back(d, n_rows, rows, raw, g, d_raw[k > 0]);
        on_activate_back(d, n, NULL, raw, g, full);
        if (k) {
            check_same_bits(attr[1], attr[0], n * SPIN_ATTR * 4, "attr: same bits for any threads");
            check_same_bits(d_raw[1], d_raw[0], n * SPIN_ATTR * 4,
                            "back: same bits for any threads");
        }
        check_device_free(d);
    }
    for (size_t i = 0; i < n_rows; i++)
        good &= memcmp(d_raw[0] + i * SPIN_ATTR, full + rows[i] * SPIN_ATTR, SPIN_ATTR * 4) == 0;
    ok(good, "listed rows are the same rows, compact");
    for (int k = 0; k < 2; k++)
        free(attr[k]), free(d_raw[k]);
    free(raw), free(g), free(full), free(rows), free(found), free(d_pos);
}

static void active_edges(void)
{
    struct spin_device *d = check_device(2);
    size_t n = 3000;
    float *g = net_floats(n * SPIN_ATTR), *d_pos = net_floats(n * 3);
    uint32_t *rows = net_alloc(n, sizeof *rows);

    ok(on_nonzero_grad(d, n, g, d_pos, rows) == 0, "active of nothing");
    ok(on_nonzero_grad(d, 0, g, d_pos, rows) == 0, "active of no rows");
    d_pos[2999 * 3 + 2] = 1e-40f;
    g[SPIN_ATTR * 17 + 55] = NAN;
    ok(on_nonzero_grad(d, n, g, d_pos, rows) == 2 && rows[0] == 17 && rows[1] == 2999,
       "active sees the last column, NaN and a denormal position gradient");
    free(g), free(d_pos), free(rows);
    check_device_free(d);
}

static void sane(void)
{
    struct spin_device *d = check_device(1);
    static const float extremes[] = {0, 1e-30f, 1e30f, -1e30f, 3e38f, -3e38f, 1e-40f, 88, -88, 200};
    size_t n = sizeof extremes / sizeof extremes[0];
    float *raw = net_floats(n * SPIN_ATTR), *g = net_random(n * SPIN_ATTR, 8, -1, 1);
    float *attr = net_floats(n * SPIN_ATTR), *d_raw = net_floats(n * SPIN_ATTR);
    int good = 1;

    for (size_t i = 0; i < n * SPIN_ATTR; i++)
        raw[i] = extremes[i / SPIN_ATTR];
    on_activate(d, n, raw, attr);
    on_activate_back(d, n, NULL, raw, g, d_raw);
    ok(net_n_nan(attr, n * SPIN_ATTR) == 0 && net_n_nan(d_raw, n * SPIN_ATTR) == 0,
       "no NaN comes out");
    for (size_t i = 0; i < n; i++)
        good &= attr[i * SPIN_ATTR] > 0 && isfinite(attr[i * SPIN_ATTR]) &&
                attr[i * SPIN_ATTR + 55] >= 0 && attr[i * SPIN_ATTR + 55] <= 1;
    ok(good, "scales are positive and finite, opacities in [0, 1]");
    near(attr[2 * SPIN_ATTR + 3], 0.5, 1e-6, "a quaternion of 1e30 has unit length");
    free(raw), free(g), free(attr), free(d_raw);
    check_device_free(d);
}

TAP_MAIN
{
    for (int i = 0; i < N_NET_PATHS; i++)
        if (net_path(net_paths[i]))
            golden(net_paths[i]);
    unsetenv("SPIN_CPU");
    differences();
    rows_and_threads();
    active_edges();
    sane();
}
