/* Time of the network's ops per Gaussian: encoder, heads and their backward passes, and Adam per
 * parameter. The grid is that of design performance.md 3: 16 levels of 4 features, 16 to 2048 in
 * space, 8 to 128 in time. Points lie on thin surfaces, in Morton order.
 *
 *     bench-net [log2 rows per level, 19]
 *
 * The least of several runs; with one thread (processor time, so that a busy machine does not
 * show) and with all (time on the wall). */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "base/log.h"
#include "device/device.h"
#include "math/grid.h"
#include "math/mlp.h"
#include "math/rng.h"

enum { LEVELS = 16, FEATURES = 4, WIDTH = LEVELS * FEATURES };

struct data {
    struct spin_device *d;
    struct spin_norm norm;
    struct spin_grid grid;
    struct spin_heads heads;
    size_t n, n_table;
    float *pos, *d_pos, *x_u, *d_x_u, *z, *d_z, *raw, *d_raw, *attr, *param, *d_param;
    float *table, *d_table, *m, *v;
    uint32_t *rows;
};

static void run_contract(struct data *b)
{
    b->d->op->contract(b->d, &b->norm, b->n, b->pos, 0.37f, b->x_u);
}
static void run_grid(struct data *b)
{
    b->d->op->grid(b->d, &b->grid, b->table, b->n, b->x_u, b->z);
}
static void run_mlp(struct data *b)
{
    b->d->op->mlp(b->d, &b->heads, b->param, b->n, b->z, b->raw);
}
static void run_attr(struct data *b) { b->d->op->attr(b->d, b->n, b->raw, b->attr); }
static void run_attr_back(struct data *b)
{
    b->d->op->attr_back(b->d, b->n, NULL, b->raw, b->attr, b->d_raw);
}
static void run_mlp_back(struct data *b)
{
    b->d->op->mlp_back(b->d, &b->heads, b->param, b->n, NULL, b->z, b->d_raw, b->d_param, b->d_z);
}
static void run_grid_back(struct data *b)
{
    b->d->op->grid_back(b->d, &b->grid, b->table, b->n, NULL, b->x_u, b->d_z, b->d_table, b->d_x_u);
}
static void run_grid_back_table(struct data *b)
{
    b->d->op->grid_back(b->d, &b->grid, b->table, b->n, NULL, b->x_u, b->d_z, b->d_table, NULL);
}
static void run_contract_back(struct data *b)
{
    b->d->op->contract_back(b->d, &b->norm, b->n, NULL, b->pos, b->d_x_u, b->d_pos);
}
static void run_active(struct data *b) { b->d->op->active(b->d, b->n, b->attr, b->d_pos, b->rows); }
static void run_adam(struct data *b)
{
    b->d->op->adam(b->d, b->n_table, b->table, b->d_table, b->m, b->v, 1e-3, 10);
}

static const struct {
    const char *name;
    void (*run)(struct data *);
    int per_parameter;
} benches[] = {
    {"contract", run_contract, 0},
    {"grid", run_grid, 0},
    {"mlp", run_mlp, 0},
    {"attr", run_attr, 0},
    {"active", run_active, 0},
    {"attr_back", run_attr_back, 0},
    {"mlp_back", run_mlp_back, 0},
    {"grid_back", run_grid_back, 0},
    {"grid_back, table only", run_grid_back_table, 0},
    {"contract_back", run_contract_back, 0},
    {"adam, dense", run_adam, 1},
};

static void *take(struct spin_device *d, size_t bytes)
{
    void *block = NULL;

    if (d->op->reserve(d, bytes, &block) != SPIN_OK) {
        fprintf(stderr, "bench-net: %s\n", spin_last_error());
        exit(1);
    }
    return block;
}

static float *random_floats(struct spin_device *d, size_t n, uint64_t stream, float size)
{
    float *x = take(d, n * sizeof *x);

    for (size_t i = 0; i < n; i++)
        x[i] = size * (2.0f * spin_rng_uniform(1, stream, i) - 1.0f);
    return x;
}

static uint64_t spread(uint64_t x)
{
    uint64_t y = 0;

    for (int i = 0; i < 21; i++)
        y |= (x >> i & 1) << (3 * i);
    return y;
}

static uint64_t morton(const float *p)
{
    uint64_t key = 0;

    for (int d = 0; d < 3; d++)
        key |= spread((uint64_t)((p[d] * 0.25f + 0.5f) * 2097151.0f)) << d;
    return key;
}

static int compare(const void *a, const void *b)
{
    uint64_t x = morton(a), y = morton(b);

    return (x > y) - (x < y);
}

/* Eight spheres of radius 0.2 to 0.55, surfaces one thousandth thick. */
static void make_points(float *pos, size_t n)
{
    for (size_t i = 0; i < n; i++) {
        float g[3], r, size = 0.2f + 0.05f * (float)(i % 8);

        for (uint64_t k = 0; k < 3; k++)
            g[k] = spin_rng_normal(2, k, i);
        r = sqrtf(g[0] * g[0] + g[1] * g[1] + g[2] * g[2]) + 1e-6f;
        for (uint64_t k = 0; k < 3; k++)
            pos[i * 3 + k] = spin_rng_uniform(3, k, i % 8) - 0.5f + size * g[k] / r +
                             0.001f * spin_rng_normal(4, k, i);
    }
    qsort(pos, n, 3 * sizeof *pos, compare);
}

static void make(struct data *b, struct spin_device *d, size_t n, int log2_rows)
{
    static const int base[4] = {16, 16, 16, 8}, finest[4] = {2048, 2048, 2048, 128};
    static const int n_out[SPIN_HEADS] = {3, 4, 48, 1};

    memset(b, 0, sizeof *b);
    b->d = d;
    b->n = n;
    b->norm.inv_radius = 1.0f;
    b->grid.n_levels = LEVELS;
    b->grid.n_features = FEATURES;
    for (int l = 0; l < LEVELS; l++) {
        int hashed;

        b->grid.offset[l + 1] = b->grid.offset[l] + (uint32_t)spin_grid_level(
                                                        l, LEVELS, base, finest, log2_rows,
                                                        b->grid.scale[l], b->grid.res[l], &hashed);
        b->grid.hashed[l] = (uint8_t)hashed;
    }
    b->heads.n_in = WIDTH;
    b->heads.hidden = 64;
    for (int h = 0; h < SPIN_HEADS; h++) {
        b->heads.n_out[h] = n_out[h];
        b->heads.offset[h + 1] = b->heads.offset[h] + spin_head_layout(WIDTH, 64, n_out[h]).size;
    }
    b->n_table = (size_t)b->grid.offset[LEVELS] * FEATURES;
    b->pos = take(d, n * 3 * sizeof(float));
    make_points(b->pos, n);
    b->d_pos = take(d, n * 3 * sizeof(float));
    b->x_u = take(d, n * 4 * sizeof(float));
    b->d_x_u = take(d, n * 4 * sizeof(float));
    b->z = take(d, n * WIDTH * sizeof(float));
    b->d_z = take(d, n * WIDTH * sizeof(float));
    b->raw = take(d, n * SPIN_ATTR * sizeof(float));
    b->attr = take(d, n * SPIN_ATTR * sizeof(float));
    b->d_raw = random_floats(d, n * SPIN_ATTR, 5, 1.0f);
    b->param = random_floats(d, b->heads.offset[SPIN_HEADS], 6, 0.125f);
    b->d_param = take(d, b->heads.offset[SPIN_HEADS] * sizeof(float));
    b->table = random_floats(d, b->n_table, 7, 0.5f);
    b->d_table = take(d, b->n_table * sizeof(float));
    b->m = take(d, b->n_table * sizeof(float));
    b->v = take(d, b->n_table * sizeof(float));
    b->rows = take(d, n * sizeof(uint32_t));
}

static void give_back(struct data *b)
{
    struct spin_device *d = b->d;
    size_t n = b->n;

    d->op->release(d, b->pos, n * 3 * sizeof(float));
    d->op->release(d, b->d_pos, n * 3 * sizeof(float));
    d->op->release(d, b->x_u, n * 4 * sizeof(float));
    d->op->release(d, b->d_x_u, n * 4 * sizeof(float));
    d->op->release(d, b->z, n * WIDTH * sizeof(float));
    d->op->release(d, b->d_z, n * WIDTH * sizeof(float));
    d->op->release(d, b->raw, n * SPIN_ATTR * sizeof(float));
    d->op->release(d, b->attr, n * SPIN_ATTR * sizeof(float));
    d->op->release(d, b->d_raw, n * SPIN_ATTR * sizeof(float));
    d->op->release(d, b->param, b->heads.offset[SPIN_HEADS] * sizeof(float));
    d->op->release(d, b->d_param, b->heads.offset[SPIN_HEADS] * sizeof(float));
    d->op->release(d, b->table, b->n_table * sizeof(float));
    d->op->release(d, b->d_table, b->n_table * sizeof(float));
    d->op->release(d, b->m, b->n_table * sizeof(float));
    d->op->release(d, b->v, b->n_table * sizeof(float));
    d->op->release(d, b->rows, n * sizeof(uint32_t));
}

static double cpu_s(void)
{
    struct timespec t;

    clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

static void measure(struct data *b, double (*now)(void))
{
    for (size_t i = 0; i < sizeof benches / sizeof benches[0]; i++) {
        double least = 1e30, spent = 0,
               count = (double)(benches[i].per_parameter ? b->n_table : b->n);

        for (int k = 0; k < 7 && (k < 3 || spent < 0.4); k++) {
            double start = now(), s;

            benches[i].run(b);
            s = now() - start;
            spent += s;
            least = s < least ? s : least;
        }
        printf("  %-22s %8.3f ms  %8.2f ns each\n", benches[i].name, least * 1e3,
               least * 1e9 / count);
    }
}

int main(int argc, char **argv)
{
    static const size_t sizes[] = {10000, 50000};
    int log2_rows = argc > 1 ? atoi(argv[1]) : 19;

    for (int threads = 1; threads >= 0; threads--) {
        for (size_t i = 0; i < 2; i++) {
            struct spin_device d;
            struct data b;

            if (spin_device_open("cpu", threads, &d) != SPIN_OK) {
                fprintf(stderr, "bench-net: %s\n", spin_last_error());
                return 1;
            }
            make(&b, &d, sizes[i], log2_rows);
            printf("%s, %zu Gaussians, %zu parameters in the grid\n", d.description, b.n,
                   b.n_table);
            measure(&b, threads == 1 ? cpu_s : spin_now_s);
            give_back(&b);
            spin_device_close(&d);
        }
    }
    return 0;
}
