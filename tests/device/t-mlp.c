/* The four heads: golden values and gradients, a reference in double and its finite differences for
 * several shapes, the same bits for any number of threads, listed rows, NaN.
 * K: golden decoder mlp network threads */
#include "math/mlp.h"
#include "tests/device/net.h"

static const int n_out[SPIN_HEADS] = {3, 4, 48, 1};
static const int column_of[SPIN_HEADS] = {SPIN_ATTR_SCALE, SPIN_ATTR_ROTATION, SPIN_ATTR_SH,
                                          SPIN_ATTR_OPACITY};

static struct spin_heads make_heads(int n_in, int hidden, int relu)
{
    struct spin_heads heads;

    memset(&heads, 0, sizeof heads);
    heads.n_in = n_in;
    heads.hidden = hidden;
    heads.relu = relu;
    for (int h = 0; h < SPIN_HEADS; h++) {
        heads.n_out[h] = n_out[h];
        heads.offset[h + 1] = heads.offset[h] + spin_head_layout(n_in, hidden, n_out[h]).size;
    }
    return heads;
}

/* ---- golden ---------------------------------------------------------------------------------- */

/* The six pieces of a head, named "prefix" + w1, b1, ...: `put` copies them from the fixture to
 * `at`, otherwise they are compared. */
static void each_piece(struct spin_npz *npz, const char *prefix, float *at, int put,
                       const char *path)
{
    static const char *const names[] = {"w1", "b1", "w2", "b2", "w3", "b3"};

    for (int i = 0; i < 6; i++) {
        struct spin_array info;
        char key[64], what[96];
        double *values;

        snprintf(key, sizeof key, "%s%s", prefix, names[i]);
        values = check_load(npz, key, &info);
        if (put) {
            for (size_t k = 0; k < info.count; k++)
                at[k] = (float)values[k];
        } else {
            snprintf(what, sizeof what, "golden %s (%s)", key, path);
            check_rel_to_absmax(at, values, (size_t)info.count,
                                check_tolerance("decoder.npz", "rel_to_absmax", 2e-5), what);
        }
        at += info.count;
        free(values);
    }
}

/* Heads of the width of the fixture's first layer, which is [hidden][in]. */
static struct spin_heads heads_of(struct spin_npz *npz, const char *w1, int relu)
{
    struct spin_array info;

    free(check_load(npz, w1, &info));
    return make_heads((int)info.shape[1], (int)info.shape[0], relu);
}

static float *rows_of(struct spin_npz *npz, size_t *n, size_t *n_in)
{
    struct spin_array info;
    float *z = check_load_f32(npz, "z", &info);

    *n = (size_t)info.shape[0];
    *n_in = (size_t)info.shape[1];
    return z;
}

static void columns_get(float *part, const float *rows, size_t n, int head)
{
    for (size_t i = 0; i < n; i++)
        memcpy(part + i * (size_t)n_out[head], rows + i * SPIN_ATTR + column_of[head],
               (size_t)n_out[head] * sizeof *part);
}

/* The fixture's loss is on the activated attributes, so its upstream gradient goes through
 * activate_back. */
static void golden_decoder(const char *path)
{
    static const char *const names[SPIN_HEADS] = {"scale", "rot", "sh", "opacity"};
    struct spin_heads heads;
    size_t n, n_param, n_in;
    float *param, *d_param, *z, *raw, *d_attr, *d_raw, *d_z, *part;
    double *want, tol = check_tolerance("decoder.npz", "rel_to_absmax", 2e-5);
    struct spin_npz npz;
    struct spin_device *d;
    char key[64], what[96];

    if (!net_open("core/decoder.npz", &npz))
        return;
    heads = heads_of(&npz, "scale_w1", 0);
    n_param = heads.offset[SPIN_HEADS];
    d = check_device(2);
    z = rows_of(&npz, &n, &n_in);
    param = net_floats(n_param), d_param = net_floats(n_param);
    raw = net_floats(n * SPIN_ATTR), d_attr = net_floats(n * SPIN_ATTR);
    d_raw = net_floats(n * SPIN_ATTR), d_z = net_floats(n * n_in), part = net_floats(n * 48);
    for (int h = 0; h < SPIN_HEADS; h++) {
        float *v;

        snprintf(key, sizeof key, "%s_", names[h]);
        each_piece(&npz, key, param + heads.offset[h], 1, path);
        snprintf(key, sizeof key, "v_%s", names[h]);
        v = check_load_f32(&npz, key, NULL);
        for (size_t i = 0; i < n; i++)
            memcpy(d_attr + i * SPIN_ATTR + column_of[h], v + i * (size_t)n_out[h],
                   (size_t)n_out[h] * sizeof *v);
        free(v);
    }
    on_mlp(d, &heads, param, n, z, raw);
    on_activate_back(d, n, NULL, raw, d_attr, d_raw);
    on_mlp_back(d, &heads, param, n, NULL, z, d_raw, d_param, d_z);
    for (int h = 0; h < SPIN_HEADS; h++) {
        snprintf(key, sizeof key, "raw_%s", names[h]);
        want = check_load(&npz, key, NULL);
        columns_get(part, raw, n, h);
        snprintf(what, sizeof what, "golden %s (%s)", key, path);
        check_rel_to_absmax(part, want, n * (size_t)n_out[h], tol, what);
        free(want);
        snprintf(key, sizeof key, "grad_%s_", names[h]);
        each_piece(&npz, key, d_param + heads.offset[h], 0, path);
    }
    want = check_load(&npz, "grad_z", NULL);
    snprintf(what, sizeof what, "golden grad_z (%s)", path);
    check_rel_to_absmax(d_z, want, n * n_in, tol, what);
    free(want), free(z), free(param), free(d_param), free(raw), free(d_attr), free(d_raw),
        free(d_z);
    free(part);
    spin_npz_close(&npz);
    check_device_free(d);
}

static void golden_relu(const char *path)
{
    struct spin_heads heads;
    size_t n, n_param, n_in;
    float *param, *d_param, *z, *v, *raw, *d_raw, *d_z, *part;
    double *want, tol = check_tolerance("head_relu.npz", "rel_to_absmax", 2e-5);
    struct spin_npz npz;
    struct spin_device *d;
    char what[96];

    if (!net_open("core/head_relu.npz", &npz))
        return;
    heads = heads_of(&npz, "w1", 1);
    n_param = heads.offset[SPIN_HEADS];
    d = check_device(2);
    z = rows_of(&npz, &n, &n_in);
    param = net_floats(n_param), d_param = net_floats(n_param);
    raw = net_floats(n * SPIN_ATTR), d_raw = net_floats(n * SPIN_ATTR);
    d_z = net_floats(n * n_in), part = net_floats(n * 48);
    v = check_load_f32(&npz, "v", NULL);
    each_piece(&npz, "", param, 1, path);
    for (size_t i = 0; i < n; i++)
        memcpy(d_raw + i * SPIN_ATTR, v + i * 3, 3 * sizeof *v);
    on_mlp(d, &heads, param, n, z, raw);
    on_mlp_back(d, &heads, param, n, NULL, z, d_raw, d_param, d_z);
    columns_get(part, raw, n, SPIN_HEAD_SCALE);
    want = check_load(&npz, "y", NULL);
    snprintf(what, sizeof what, "golden relu y (%s)", path);
    check_rel_to_absmax(part, want, n * 3, tol, what);
    free(want);
    want = check_load(&npz, "grad_z", NULL);
    snprintf(what, sizeof what, "golden relu grad_z (%s)", path);
    check_rel_to_absmax(d_z, want, n * n_in, tol, what);
    free(want), free(z), free(v), free(param), free(d_param), free(raw), free(d_raw), free(d_z);
    free(part);
    spin_npz_close(&npz);
    check_device_free(d);
}

/* ---- reference ------------------------------------------------------------------------------- */

static double plain_activation(double x, int relu)
{
    return relu ? (x > 0 ? x : 0) : x * 0.5 * erfc(-x / sqrt(2));
}

static void plain_layer(const double *w, const double *b, int in, int out, const double *x,
                        double *y)
{
    for (int o = 0; o < out; o++) {
        y[o] = b[o];
        for (int i = 0; i < in; i++)
            y[o] += w[o * in + i] * x[i];
    }
}

static void plain(const struct spin_heads *heads, const double *param, const double *z, double *raw)
{
    double h1[256], h2[256];
    int hidden = heads->hidden;

    for (int h = 0; h < SPIN_HEADS; h++) {
        struct spin_head_layout at = spin_head_layout(heads->n_in, hidden, n_out[h]);
        const double *p = param + heads->offset[h];

        plain_layer(p + at.w1, p + at.b1, heads->n_in, hidden, z, h1);
        for (int i = 0; i < hidden; i++)
            h1[i] = plain_activation(h1[i], heads->relu);
        plain_layer(p + at.w2, p + at.b2, hidden, hidden, h1, h2);
        for (int i = 0; i < hidden; i++)
            h2[i] = plain_activation(h2[i], heads->relu);
        plain_layer(p + at.w3, p + at.b3, hidden, n_out[h], h2, raw + column_of[h]);
    }
}

/* d_raw . heads(z) over all rows, with param and z moved by `step` along their directions. */
static double plain_dot(const struct spin_heads *heads, const float *param,
                        const float *d_param_dir, const float *z, const float *z_dir, size_t n,
                        const float *d_raw, double step)
{
    size_t n_param = heads->offset[SPIN_HEADS], n_in = (size_t)heads->n_in;
    double *p = net_alloc(n_param, sizeof *p), *x = net_alloc(n_in, sizeof *x), raw[SPIN_ATTR],
           sum = 0;

    for (size_t i = 0; i < n_param; i++)
        p[i] = param[i] + (d_param_dir ? step * d_param_dir[i] : 0);
    for (size_t i = 0; i < n; i++) {
        for (size_t k = 0; k < n_in; k++)
            x[k] = z[i * n_in + k] + (z_dir ? step * z_dir[i * n_in + k] : 0);
        plain(heads, p, x, raw);
        for (int k = 0; k < SPIN_ATTR; k++)
            sum += raw[k] * d_raw[i * SPIN_ATTR + (size_t)k];
    }
    free(p), free(x);
    return sum;
}

static void against_plain(int n_in, int hidden, int relu, size_t n)
{
    struct spin_heads heads = make_heads(n_in, hidden, relu);
    size_t n_param = heads.offset[SPIN_HEADS], n_z = n * (size_t)n_in, worst_head = 0;
    float range = 1.5f / sqrtf((float)hidden);
    float *param = net_random(n_param, 1, -range, range), *z = net_random(n_z, 2, -2, 2);
    float *d_raw = net_random(n * SPIN_ATTR, 3, -1, 1), *raw = net_floats(n * SPIN_ATTR);
    float *d_param = net_floats(n_param), *d_z = net_random(n_z, 4, 8, 9);
    float *direction = net_random(n_param, 5, -1, 1), *z_dir = net_random(n_z, 6, -1, 1);
    double *p = net_alloc(n_param, sizeof *p), *want = net_alloc(n * SPIN_ATTR, sizeof *want);
    double h = relu ? 1e-8 : 1e-6, slope, worst = 0; /* small, so that no kink lies in between */
    struct spin_device *d = check_device(2);
    char what[96];

    on_mlp(d, &heads, param, n, z, raw);
    on_mlp_back(d, &heads, param, n, NULL, z, d_raw, d_param, d_z);
    for (size_t i = 0; i < n_param; i++)
        p[i] = param[i];
    for (size_t i = 0; i < n; i++) {
        double x[256];

        for (int k = 0; k < n_in; k++)
            x[k] = z[i * (size_t)n_in + (size_t)k];
        plain(&heads, p, x, want + i * SPIN_ATTR);
    }
    snprintf(what, sizeof what, "%d -> %d%s, %zu rows: equals a plain version", n_in, hidden,
             relu ? " relu" : "", n);
    check_rel_to_absmax(raw, want, n * SPIN_ATTR, 3e-6, what);

    /* Each head separately, so that a small one is not hidden in the sum; then z. */
    for (int k = 0; k < SPIN_HEADS; k++) {
        float *only = net_floats(n_param);
        size_t from = heads.offset[k], count = heads.offset[k + 1] - from;
        double got;

        memcpy(only + from, direction + from, count * sizeof *only);
        got = net_dot(d_param, only, n_param);
        slope = (plain_dot(&heads, param, only, z, NULL, n, d_raw, h) -
                 plain_dot(&heads, param, only, z, NULL, n, d_raw, -h)) /
                (2 * h);
        if (!(fabs(got - slope) / (1 + fabs(slope)) <= worst)) {
            worst = fabs(got - slope) / (1 + fabs(slope));
            worst_head = (size_t)k;
        }
        free(only);
    }
    ok(worst < 2e-5, "weight slopes are central differences (worst %.2g, head %zu)", worst,
       worst_head);
    slope = (plain_dot(&heads, param, NULL, z, z_dir, n, d_raw, h) -
             plain_dot(&heads, param, NULL, z, z_dir, n, d_raw, -h)) /
            (2 * h);
    near(net_dot(d_z, z_dir, n_z), slope, 2e-5 * (1 + fabs(slope)), "and those of z");
    free(param), free(z), free(d_raw), free(raw), free(d_param), free(d_z), free(direction);
    free(z_dir), free(p), free(want);
    check_device_free(d);
}

/* ---- same results ---------------------------------------------------------------------------- */

static void threads_same(size_t n)
{
    struct spin_heads heads = make_heads(64, 64, 0);
    size_t n_param = heads.offset[SPIN_HEADS], n_rows;
    uint32_t *rows;
    float *param = net_random(n_param, 11, -0.2f, 0.2f), *z = net_random(n * 64, 12, -1, 1);
    float *d_raw = net_random(n * SPIN_ATTR, 13, -1, 1), *first[3] = {NULL, NULL, NULL};

    n_rows = net_rows(n, &rows);
    for (int k = 0; k < check_n_threads(); k++) {
        struct spin_device *d = check_device(check_thread_counts[k]);
        float *raw = net_floats(n * SPIN_ATTR), *d_param = net_floats(n_param);
        float *d_z = net_floats(n * 64);

        on_mlp(d, &heads, param, n, z, raw);
        on_mlp_back(d, &heads, param, n_rows, rows, z, d_raw, d_param, d_z);
        if (k == 0) {
            first[0] = raw;
            first[1] = d_param;
            first[2] = d_z;
        } else {
            check_same_bits(raw, first[0], n * SPIN_ATTR * 4, "raw: same bits for any threads");
            check_same_bits(d_param, first[1], n_param * 4, "d_param: same bits for any threads");
            check_same_bits(d_z, first[2], n * 64 * 4, "d_z: same bits for any threads");
            free(raw), free(d_param), free(d_z);
        }
        check_device_free(d);
    }
    for (int i = 0; i < 3; i++)
        free(first[i]);
    free(param), free(z), free(d_raw), free(rows);
}

static void rows_are_compact(void)
{
    struct spin_heads heads = make_heads(16, 16, 0);
    struct spin_device *d = check_device(2);
    size_t n = 400, n_param = heads.offset[SPIN_HEADS], n_rows;
    uint32_t *rows;
    float *param = net_random(n_param, 21, -0.3f, 0.3f), *z = net_random(n * 16, 22, -1, 1);
    float *d_raw = net_random(n * SPIN_ATTR, 23, -1, 1), *listed = net_floats(n * 16);
    float *p1 = net_floats(n_param), *p2 = net_floats(n_param);
    float *z1 = net_floats(n * 16), *z2 = net_floats(n * 16);
    double *twice = net_alloc(n_param, sizeof *twice);

    n_rows = net_rows(n, &rows);
    for (size_t i = 0; i < n_rows; i++)
        memcpy(listed + i * 16, z + rows[i] * 16, 64);
    on_mlp_back(d, &heads, param, n_rows, rows, z, d_raw, p1, z1);
    on_mlp_back(d, &heads, param, n_rows, NULL, listed, d_raw, p2, z2);
    check_same_bits(p1, p2, n_param * 4, "listed rows: same weight gradient as the rows alone");
    check_same_bits(z1, z2, n * 64, "listed rows: same d_z");
    for (size_t i = 0; i < n_param; i++)
        twice[i] = 2.0 * p1[i];
    on_mlp_back(d, &heads, param, n_rows, rows, z, d_raw, p1, z1);
    check_rel_to_absmax(p1, twice, n_param, 1e-6, "weight gradients add up over calls");
    memcpy(p2, p1, n_param * 4);
    on_mlp_back(d, &heads, param, 0, rows, z, d_raw, p1, z1);
    on_mlp(d, &heads, param, 0, z, z1);
    check_same_bits(p1, p2, n_param * 4, "no rows: nothing happens");
    free(param), free(z), free(d_raw), free(listed), free(p1), free(p2), free(z1), free(z2);
    free(twice), free(rows);
    check_device_free(d);
}

static void sane(void)
{
    struct spin_heads heads = make_heads(64, 64, 0);
    struct spin_device *d = check_device(1);
    size_t n = 100, n_param = heads.offset[SPIN_HEADS];
    float *param = net_random(n_param, 31, -0.2f, 0.2f), *z = net_random(n * 64, 32, -1, 1);
    float *raw = net_floats(n * SPIN_ATTR), *d_raw = net_random(n * SPIN_ATTR, 33, -1, 1);
    float *d_param = net_floats(n_param), *d_z = net_floats(n * 64);

    z[7 * 64 + 3] = NAN;
    on_mlp(d, &heads, param, n, z, raw);
    ok(net_n_nan(raw, n * SPIN_ATTR) == SPIN_ATTR && isnan(raw[7 * SPIN_ATTR]),
       "NaN stays in its row");
    z[7 * 64 + 3] = 1e15f;
    z[8 * 64] = -1e-40f;
    on_mlp(d, &heads, param, n, z, raw);
    on_mlp_back(d, &heads, param, n, NULL, z, d_raw, d_param, d_z);
    ok(net_n_nan(raw, n * SPIN_ATTR) + net_n_nan(d_param, n_param) + net_n_nan(d_z, n * 64) == 0,
       "huge and denormal features give numbers");
    free(param), free(z), free(raw), free(d_raw), free(d_param), free(d_z);
    check_device_free(d);
}

TAP_MAIN
{
    for (int i = 0; i < N_NET_PATHS; i++) {
        if (!net_path(net_paths[i]))
            continue;
        PART(golden_decoder, net_paths[i]);
        PART(golden_relu, net_paths[i]);
        PART(against_plain, 64, 64, 0, 97);
        PART(against_plain, 16, 16, 0, 12);
        PART(against_plain, 12, 20, 0, 5);
        PART(against_plain, 4, 100, 1, 31);
    }
    unsetenv("SPIN_CPU");
    PART(against_plain, 20, 256, 0, 3);
    PART(against_plain, 128, 48, 0, 1);
    /* Wide, and more rows than one slice of a sum in CUDA. */
    PART(against_plain, 72, 16, 0, 1100);
    PART(threads_same, 95);
    PART(threads_same, 7000);
    PART(rows_are_compact);
    PART(sane);
}
