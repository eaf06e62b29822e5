/* A lazy table reads and ends with the values of a table whose lines are all updated in every
 * step, up to rounding; reading it between steps changes nothing; identical bits for any number
 * of threads.
 * K: adam network threads lazy */

#include "train/trainer.h"
#include "math/adam.h"
#include "tests/device/net.h"

enum { STEPS = 90, SETS = 7, POINTS = 24, LEVELS = 6 };

struct table {
    struct spin_device *d;
    struct spin_field field;
    struct spin_lazy_adam *lazy;
    size_t n;
    struct loans loans; /* the arrays on the device */
    struct spin_param_group group;
    float SPIN_DEV *z;
    float *host_z; /* [POINTS][LEVELS * 4] */
};

static void plan(struct spin_field *field)
{
    static const int base[4] = {4, 4, 4, 2}, finest[4] = {64, 64, 64, 8};

    ok(spin_field_plan(field, LEVELS, 4, 12, 16, 3, base, finest) == SPIN_OK, "plans a network");
}

static struct table table_of(int n_threads, int lazy)
{
    struct table t = {.d = check_device(n_threads)};
    float *host;

    plan(&t.field);
    t.n = t.field.n_table;
    t.loans.d = t.d;
    host = net_random(t.n, 1, -0.1f, 0.1f);
    t.group = (struct spin_param_group){.n = t.n};
    t.group.p = lend(&t.loans, host, t.n * sizeof *host);
    memset(host, 0, t.n * sizeof *host);
    t.group.g = lend(&t.loans, host, t.n * sizeof *host);
    t.group.m = lend(&t.loans, host, t.n * sizeof *host);
    t.group.v = lend(&t.loans, host, t.n * sizeof *host);
    t.host_z = net_floats((size_t)POINTS * LEVELS * 4);
    t.z = lend_both(&t.loans, t.host_z, (size_t)POINTS * LEVELS * 4 * sizeof *host);
    free(host);
    if (lazy && t.d->op->lazy_adam_enable(t.d, &t.field.grid, &t.group, STEPS, &t.lazy) != SPIN_OK)
        ok(0, "opens");
    return t;
}

static void table_free(struct table *t)
{
    if (t->lazy)
        t->d->op->lazy_adam_close(t->d, t->lazy);
    settle(&t->loans);
    free(t->host_z);
    check_device_free(t->d);
}

static float *fetch(struct table *t, const float SPIN_DEV *from, size_t n)
{
    float *to = net_floats(n);

    ok(t->d->op->download(t->d, to, from, n * sizeof *to) == SPIN_OK, "downloads");
    return to;
}

/* Updates every line in every step. */
static float *flush(struct table *t)
{
    float SPIN_DEV *out = lend_to(&t->loans, NULL, NULL, t->n * sizeof(float));
    float *flushed;

    t->d->op->lazy_adam_flush(t->d, t->lazy, out);
    flushed = fetch(t, out, t->n);
    t->loans.n--;
    t->d->op->release(t->d, out);
    return flushed;
}

/* The points of a set are used together; set k is used rarely if k is large. */
static int set_of(int step)
{
    int k = 0;

    while (k + 1 < SETS && step % (2 << k) == (2 << k) - 1)
        k++;
    return k;
}

static double rate(int step) { return spin_lr(2e-2, 1e-7, step, 10, STEPS); }

static void step(struct table *t, int k)
{
    float *x = net_random(POINTS * 4, 100 + (uint64_t)set_of(k), 0, 1);
    float *d_z = net_random((size_t)POINTS * LEVELS * 4, 200 + (uint64_t)k, -1e-3f, 1e-3f);
    const struct spin_grid *grid = &t->field.grid;
    struct loans l = {.d = t->d};
    struct spin_active all = lend_active(&l, NULL, POINTS);
    float SPIN_DEV *x_u = lend(&l, x, POINTS * 4 * sizeof *x);

    if (t->lazy)
        t->d->op->lazy_adam_grid(t->d, t->lazy, POINTS, x_u, t->z);
    else
        t->d->op->grid(t->d, grid, t->group.p, POINTS, x_u, t->z);
    t->d->op->grid_back(t->d, grid, t->group.p, &all, x_u,
                        lend(&l, d_z, (size_t)POINTS * LEVELS * 4 * sizeof *d_z), t->group.g, NULL);
    t->group.lr = rate(k);
    t->group.step = k;
    if (t->lazy)
        t->d->op->lazy_adam_step(t->d, t->lazy, rate(k));
    else
        t->d->op->adam(t->d, 1, &t->group);
    settle(&l);
    ok(t->d->op->download(t->d, t->host_z, t->z, (size_t)POINTS * LEVELS * 4 * sizeof(float)) ==
           SPIN_OK,
       "reads");
    free(x), free(d_z);
}

static double worst(const float *a, const float *b, size_t n)
{
    double most = 0;

    for (size_t i = 0; i < n; i++)
        most = larger(most, isfinite(a[i]) ? fabs((double)a[i] - (double)b[i]) : 1e30);
    return most;
}

/* Entries move by up to 0.02 a step. */
static void equals_dense(const char *path)
{
    struct table dense = table_of(1, 0), lazy = table_of(1, 1);
    float *settled, *p, *v, *g, *last;
    double read = 0, moved;
    size_t behind = 0;

    for (int k = 1; k <= STEPS; k++) {
        step(&dense, k);
        step(&lazy, k);
        read = larger(read, worst(lazy.host_z, dense.host_z, (size_t)POINTS * LEVELS * 4));
    }
    last = fetch(&lazy, lazy.lazy->last, lazy.lazy->n_lines);
    for (size_t i = 0; i < lazy.lazy->n_lines; i++)
        behind += last[i] < STEPS;
    ok(behind > lazy.lazy->n_lines / 2, "most lines are behind (%s)", path);
    ok(read < 2e-6, "every step reads what the dense table has: %.1e (%s)", read, path);
    p = fetch(&dense, dense.group.p, dense.n);
    v = fetch(&dense, dense.group.v, dense.n);
    g = fetch(&lazy, lazy.group.p, lazy.n);
    moved = worst(g, p, dense.n);
    free(g);
    ok(moved > 1e-3, "unsettled they differ: %.1e (%s)", moved, path);
    settled = flush(&lazy);
    moved = worst(settled, p, dense.n);
    ok(moved < 2e-4, "settled they are equal: %.1e (%s)", moved, path);
    for (size_t i = 0; i < dense.n; i++)
        if (v[i] < 1e-23f) /* gradients near the 1e-15: between the two exact ends */
            settled[i] = p[i];
    moved = worst(settled, p, dense.n);
    ok(moved < 4e-6, "where gradients count, to %.1e (%s)", moved, path);
    g = fetch(&lazy, lazy.group.g, lazy.n);
    for (size_t i = 0; i < lazy.n; i++)
        if (g[i] != 0.0f) {
            ok(0, "gradient %zu is left zero", i);
            break;
        }
    free(settled), free(p), free(v), free(g), free(last);
    table_free(&dense);
    table_free(&lazy);
}

static void same_bits(void)
{
    int threads[] = {1, 3, 2, 8}, n = 4;
    float *first = NULL;

    for (int i = 0; i < n; i++) {
        struct table t = table_of(threads[i], 1);
        float *p;

        if (!t.d->is_host) /* a set without gradients: once without reading the table, once with */
            n = 2;
        t.d->deterministic = true;
        for (int k = 1; k <= STEPS; k++) {
            step(&t, k);
            if (i % 2 && k % 10 == 0) /* reading changes nothing */
                free(flush(&t));
        }
        p = fetch(&t, t.group.p, t.n);
        if (first)
            check_same_bits(p, first, t.n * 4, "same bits for any number of threads");
        else
            first = net_copy(p, t.n);
        free(p);
        table_free(&t);
    }
    free(first);
}

/* Long enough for lines to fall behind and to be updated later. */
static void few_steps(void)
{
    struct table t = table_of(1, 1);
    float *p;
    size_t bad = 0;

    for (int k = 1; k <= 6; k++)
        step(&t, k);
    p = flush(&t);
    for (size_t i = 0; i < t.n; i++)
        bad += !isfinite(p[i]);
    ok(bad == 0, "six steps");
    free(p);
    table_free(&t);
}

static void when_it_pays(void)
{
    struct spin_field field;

    plan(&field);
    ok(!spin_lazy_pays(&field, 1e5, 100), "many splats on a small table: no");
    ok(spin_lazy_pays(&field, 5, 100), "few splats: yes");
    ok(!spin_lazy_pays(&field, 5, (int64_t)1 << 25), "more steps than a float can count: no");
    field.grid.n_levels = spin_lazy_level(&field.grid);
    ok(!spin_lazy_pays(&field, 5, 100), "no hashed level: no");
}

TAP_MAIN
{
    for (int i = 0; i < N_NET_PATHS; i++)
        if (net_path(net_paths[i]))
            PART(equals_dense, net_paths[i]);
    unsetenv("SPIN_CPU");
    PART(same_bits);
    PART(few_steps);
    PART(when_it_pays);
}
