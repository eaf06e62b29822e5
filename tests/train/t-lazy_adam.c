/* A lazy table: what it reads and what it ends as are those of a table whose every line takes every
 * step, but for rounding; looking at it between steps changes nothing; the same bits for any number
 * of threads.
 * K: adam network threads lazy */
#include <math.h>

#include "train/lazy_adam.h"
#include "math/adam.h"
#include "tests/device/net.h"

enum { STEPS = 90, SETS = 7, POINTS = 24, LEVELS = 6 };

struct table {
    struct spin_device *d;
    struct spin_field field;
    struct spin_lazy_table lazy;
    size_t n;
    float *p, *g, *m, *v, *z;
};

static void plan(struct spin_field *field)
{
    static const int base[4] = {4, 4, 4, 2}, finest[4] = {64, 64, 64, 8};

    ok(spin_field_plan(field, LEVELS, 4, 12, 16, 3, base, finest) == SPIN_OK, "plans a network");
}

static struct table table_of(int n_threads, int lazy)
{
    struct table t = {.d = check_device(n_threads)};

    plan(&t.field);
    t.n = t.field.n_table;
    t.p = net_random(t.n, 1, -0.1f, 0.1f);
    t.g = net_floats(t.n);
    t.m = net_floats(t.n);
    t.v = net_floats(t.n);
    t.z = net_floats((size_t)POINTS * LEVELS * 4);
    if (lazy && spin_lazy_enable(&t.lazy, t.d, &t.field, STEPS) != SPIN_OK)
        ok(0, "opens");
    return t;
}

static void table_free(struct table *t)
{
    spin_lazy_close(&t->lazy, t->d);
    free(t->p), free(t->g), free(t->m), free(t->v), free(t->z);
    check_device_free(t->d);
}

/* The points of a set are needed together; set k comes rarely when k is large. */
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

    if (t->lazy.lazy.last)
        t->d->op->lazy_grid(t->d, grid, &t->lazy.lazy, t->p, t->m, t->v, POINTS, x, t->z);
    else
        t->d->op->grid(t->d, grid, t->p, POINTS, x, t->z);
    t->d->op->grid_back(t->d, grid, t->p, POINTS, NULL, x, d_z, t->g, NULL);
    if (t->lazy.lazy.last) {
        t->d->op->lazy_adam(t->d, grid, &t->lazy.lazy, t->n, t->p, t->g, t->m, t->v, rate(k));
        spin_lazy_advance(&t->lazy, rate(k));
    } else {
        t->d->op->adam(t->d, t->n, t->p, t->g, t->m, t->v, rate(k), k);
    }
    free(x), free(d_z);
}

static double worst(const float *a, const float *b, size_t n)
{
    double most = 0;

    for (size_t i = 0; i < n; i++)
        most = fmax(most, isfinite(a[i]) ? fabs((double)a[i] - (double)b[i]) : 1e30);
    return most;
}

/* Entries move by up to 0.02 a step. */
static void equals_dense(const char *path)
{
    struct table dense = table_of(1, 0), lazy = table_of(1, 1);
    float *settled = net_floats(dense.n);
    double read = 0, moved;
    size_t behind = 0;

    for (int k = 1; k <= STEPS; k++) {
        step(&dense, k);
        step(&lazy, k);
        read = fmax(read, worst(lazy.z, dense.z, (size_t)POINTS * LEVELS * 4));
    }
    for (size_t i = 0; i < lazy.lazy.n_lines; i++)
        behind += lazy.lazy.lazy.last[i] < STEPS;
    ok(behind > lazy.lazy.n_lines / 2, "most lines are behind (%s)", path);
    ok(read < 2e-6, "every step reads what the dense table has: %.1e (%s)", read, path);
    moved = worst(lazy.p, dense.p, dense.n);
    ok(moved > 1e-3, "unsettled they differ: %.1e (%s)", moved, path);
    lazy.d->op->lazy_flush(lazy.d, &lazy.field.grid, &lazy.lazy.lazy, lazy.n, lazy.p, lazy.m,
                           lazy.v, settled);
    moved = worst(settled, dense.p, dense.n);
    ok(moved < 2e-4, "settled they are equal: %.1e (%s)", moved, path);
    for (size_t i = 0; i < dense.n; i++)
        if (dense.v[i] < 1e-23f) /* gradients near the 1e-15: between the two exact ends */
            settled[i] = dense.p[i];
    moved = worst(settled, dense.p, dense.n);
    ok(moved < 4e-6, "where gradients count, to %.1e (%s)", moved, path);
    for (size_t i = 0; i < lazy.n; i++)
        if (lazy.g[i] != 0.0f) {
            ok(0, "gradient %zu is left zero", i);
            break;
        }
    free(settled);
    table_free(&dense);
    table_free(&lazy);
}

static void same_bits(void)
{
    int threads[] = {1, 2, 3, 8};
    float *first = NULL;

    for (int i = 0; i < 4; i++) {
        struct table t = table_of(threads[i], 1);
        float *settled = net_floats(t.n);

        for (int k = 1; k <= STEPS; k++) {
            step(&t, k);
            if (i > 1 && k % 10 == 0) /* looking changes nothing */
                t.d->op->lazy_flush(t.d, &t.field.grid, &t.lazy.lazy, t.n, t.p, t.m, t.v, settled);
        }
        if (first)
            check_same_bits(t.p, first, t.n * 4, "same bits for any number of threads");
        else
            first = net_copy(t.p, t.n);
        free(settled);
        table_free(&t);
    }
    free(first);
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
            equals_dense(net_paths[i]);
    unsetenv("SPIN_CPU");
    same_bits();
    when_it_pays();
}
