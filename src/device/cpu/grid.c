/* The 4-D hash grid on the CPU, forward and backward.
 *
 * Points are processed in blocks of 64. For each level, the table rows and weights of all corners
 * of a block are computed first, in loops over points that the compiler vectorises. Then the
 * features of each corner are read from the table as one short vector. Meanwhile the table rows of
 * the next level or block are prefetched, since the encoder spends most of its time waiting for
 * memory. Compiled with -ffp-contract=off, so that every SIMD path gives the same bits.
 *
 * In the backward pass, each level is one task, which visits the points in order, so the sums in
 * the table do not depend on the number of threads. Each level has its own gradients of the
 * positions. A second pass adds these over the levels, pairwise as in a binary tree: levels 0 and
 * 1, levels 2 and 3, then the sums of these pairs, and so on. */
#include "device/cpu/cpu.h"

#include <string.h>

#include "device/cpu/denormals.h"
#include "device/cpu/lazy_adam.h"
#include "math/adam.h"
#include "math/grid.h"

enum { BLOCK = 64, CORNERS = 16, CHUNK = 4096 };

/* Four features of a row. A wider row consists of several quads; a narrower row is padded with
 * zeros. */
typedef float quad __attribute__((vector_size(16)));

static inline __attribute__((always_inline)) quad quad_load(const float *p, int lanes)
{
    quad v = {0, 0, 0, 0};

    if (lanes == 4)
        memcpy(&v, p, sizeof v);
    else
        for (int i = 0; i < lanes; i++)
            v[i] = p[i];
    return v;
}

static inline __attribute__((always_inline)) void quad_store(float *p, quad v, int lanes)
{
    if (lanes == 4)
        memcpy(p, &v, sizeof v);
    else
        for (int i = 0; i < lanes; i++)
            p[i] = v[i];
}

static size_t row_of(const uint32_t *rows, size_t i) { return rows ? rows[i] : i; }

/* ---- Rows and weights of a block ------------------------------------------------------------- */

/* Up to 64 points, stored by axis. Unused entries, and points that are NaN or outside [0,1]^4, have
 * x = 0 and inside = 0. */
struct points {
    float x[4][BLOCK];
    uint32_t inside[BLOCK];
};

/* Constants of a level, from which table rows are computed. In a dense level, the upper vertex of a
 * cell may lie beyond the border, where its weight is 0. The last vertex is read instead, which
 * avoids a modulo and keeps every index inside the table. */
struct level {
    float scale[4];
    /* factor of each coordinate in the row index: the stride of a dense level, the hash prime of a
     * hashed level */
    uint32_t step[4];
    uint32_t top[4]; /* last vertex of each axis */
    uint32_t n_rows, mask;
    int hashed; /* 0: dense; 1: hashed, n_rows is a power of two; 2: hashed, any other n_rows */
    size_t first_row;
};

struct corners {
    /* table row of each corner, counted from the first row of the level */
    uint32_t row[CORNERS][BLOCK];
    float weight[CORNERS][BLOCK];
    float w[4][BLOCK];     /* weight of the upper vertex on each axis */
    float slope[4][BLOCK]; /* d w / d x_u, used for the three axes of space only */
};

static void level_set(struct level *at, const struct spin_grid *grid, int level)
{
    static const uint32_t primes[4] = {SPIN_GRID_PRIME_X, SPIN_GRID_PRIME_Y, SPIN_GRID_PRIME_Z,
                                       SPIN_GRID_PRIME_T};
    uint32_t stride = 1;

    at->first_row = grid->offset[level];
    at->n_rows = grid->offset[level + 1] - grid->offset[level];
    at->mask = at->n_rows - 1;
    at->hashed = !grid->hashed[level] ? 0 : (at->n_rows & at->mask) == 0 ? 1 : 2;
    for (int d = 0; d < 4; d++) {
        at->scale[d] = grid->scale[level][d];
        at->step[d] = at->hashed ? primes[d] : stride;
        at->top[d] = at->hashed ? 0x7fffffff : grid->res[level][d] - 1;
        stride *= grid->res[level][d];
    }
}

static void points_set(struct points *p, const float *x_u, const uint32_t *rows, size_t first,
                       int m)
{
    memset(p, 0, sizeof *p);
    for (int b = 0; b < m; b++) {
        const float *x = x_u + row_of(rows, first + (size_t)b) * 4;
        int inside = 1;

        for (int d = 0; d < 4; d++)
            inside &= x[d] >= 0.0f && x[d] <= 1.0f;
        if (!inside)
            continue;
        p->inside[b] = 1;
        for (int d = 0; d < 4; d++)
            p->x[d][b] = x[d];
    }
}

static void corners_set(struct corners *c, const struct points *p, const struct level *at)
{
    uint32_t low[4][BLOCK], high[4][BLOCK], xy[4][BLOCK], zt[4][BLOCK];
    float wxy[4][BLOCK], wzt[4][BLOCK];

    for (int d = 0; d < 4; d++) {
        float scale = at->scale[d];
        uint32_t step = at->step[d];
        int32_t top = (int32_t)at->top[d];

        for (int b = 0; b < BLOCK; b++) {
            float pos = p->x[d][b] * scale;
            int32_t cell = (int32_t)pos;
            float r = pos - (float)cell;
            int32_t lower = cell < top ? cell : top, upper = cell + 1 < top ? cell + 1 : top;

            c->w[d][b] = spin_smoothstep(r);
            c->slope[d][b] = spin_smoothstep_slope(r) * scale;
            low[d][b] = (uint32_t)lower * step;
            high[d][b] = (uint32_t)upper * step;
        }
    }
    for (int k = 0; k < 4; k++) {
        const uint32_t *x = k & 1 ? high[0] : low[0], *y = k & 2 ? high[1] : low[1];
        const uint32_t *z = k & 1 ? high[2] : low[2], *t = k & 2 ? high[3] : low[3];

        for (int b = 0; b < BLOCK; b++) {
            float wx = k & 1 ? c->w[0][b] : 1.0f - c->w[0][b];
            float wy = k & 2 ? c->w[1][b] : 1.0f - c->w[1][b];
            float wz = k & 1 ? c->w[2][b] : 1.0f - c->w[2][b];
            float wt = k & 2 ? c->w[3][b] : 1.0f - c->w[3][b];

            wxy[k][b] = wx * wy;
            wzt[k][b] = wz * wt;
            xy[k][b] = at->hashed ? x[b] ^ y[b] : x[b] + y[b];
            zt[k][b] = at->hashed ? z[b] ^ t[b] : z[b] + t[b];
        }
    }
    for (int k = 0; k < CORNERS; k++) {
        const uint32_t *lo = xy[k & 3], *hi = zt[k >> 2];

        for (int b = 0; b < BLOCK; b++)
            c->weight[k][b] = wxy[k & 3][b] * wzt[k >> 2][b];
        if (at->hashed)
            for (int b = 0; b < BLOCK; b++)
                c->row[k][b] = (lo[b] ^ hi[b]) & at->mask;
        else
            for (int b = 0; b < BLOCK; b++)
                c->row[k][b] = lo[b] + hi[b];
        if (at->hashed == 2)
            for (int b = 0; b < BLOCK; b++)
                c->row[k][b] = (lo[b] ^ hi[b]) % at->n_rows;
    }
}

/* Table rows to prefetch, in one or two tables. If `c` is NULL, none are prefetched. */
struct ahead {
    const struct corners *c;
    const float *first, *second;
};

/* Prefetches the rows of point b into the second-level cache. In the first-level cache they would
 * evict the rows that are being read. */
static inline __attribute__((always_inline)) void prefetch_rows(const struct ahead *a, int b,
                                                                int width)
{
    if (!a->c)
        return;
    for (int k = 0; k < CORNERS; k++) {
        size_t at = (size_t)a->c->row[k][b] * (size_t)width;

        __builtin_prefetch(a->first + at, 0, 2);
        if (a->second)
            __builtin_prefetch(a->second + at, 0, 2);
    }
}

/* ---- Forward --------------------------------------------------------------------------------- */

struct grid_job {
    const struct spin_grid *grid;
    const float *table, *x_u, *d_z;
    size_t n;
    const uint32_t *rows;
    float *z, *d_table;
    quad *d_x; /* [n_levels][n] */
    float *d_x_u;
    const struct spin_cpu_lazy_adam *lazy;
    float *p, *m, *v; /* the table and its moments, used with lazy Adam */
};

/* Up to 64 points and their corners in one level. */
struct block {
    int m;
    struct points p;
    struct corners c;
};

static void block_set(struct block *b, const struct grid_job *job, const struct level *at,
                      size_t first)
{
    b->m = job->n - first < BLOCK ? (int)(job->n - first) : BLOCK;
    points_set(&b->p, job->x_u, job->rows, first, b->m);
    corners_set(&b->c, &b->p, at);
}

/* Interpolates a group of `lanes` features, up to four, of each point of a block. A table row has
 * `width` floats. */
static inline __attribute__((always_inline)) void
gather_features(const float *table, const struct corners *c, const struct points *p, int m,
                int width, int lanes, float *z, size_t z_width, const struct ahead *next)
{
    for (int b = 0; b < m; b++) {
        quad sum = {0, 0, 0, 0};

        prefetch_rows(next, b, width);
        if (p->inside[b])
            for (int k = 0; k < CORNERS; k++)
                sum += c->weight[k][b] *
                       quad_load(table + (size_t)c->row[k][b] * (size_t)width, lanes);
        quad_store(z + (size_t)b * z_width, sum, lanes);
    }
}

/* Writes the features z of one level for the m points of a block. */
static void gather_level(const struct grid_job *job, int level, const struct level *at,
                         const struct corners *c, const struct points *p, size_t first, int m,
                         const struct ahead *next)
{
    static const struct ahead nothing;
    size_t width = (size_t)job->grid->n_features, z_width = (size_t)job->grid->n_levels * width;
    const float *table = job->table + at->first_row * width;
    float *z = job->z + first * z_width + (size_t)level * width;

    switch (job->grid->n_features) {
    case 1:
        gather_features(table, c, p, m, 1, 1, z, z_width, next);
        break;
    case 2:
        gather_features(table, c, p, m, 2, 2, z, z_width, next);
        break;
    case 4:
        gather_features(table, c, p, m, 4, 4, z, z_width, next);
        break;
    default:
        gather_features(table, c, p, m, 8, 4, z, z_width, next);
        gather_features(table + 4, c, p, m, 8, 4, z + 4, z_width, &nothing);
    }
}

static void grid_task(void *context, size_t first, size_t end)
{
    const struct grid_job *job = context;
    int m = (int)(end - first);
    struct points p;
    struct corners c[2];
    struct level at[2];

    points_set(&p, job->x_u, NULL, first, m);
    level_set(&at[0], job->grid, 0);
    corners_set(&c[0], &p, &at[0]);
    for (int level = 0; level < job->grid->n_levels; level++) {
        int now = level & 1;
        struct ahead next = {0};

        if (level + 1 < job->grid->n_levels) {
            level_set(&at[!now], job->grid, level + 1);
            corners_set(&c[!now], &p, &at[!now]);
            next.c = &c[!now];
            next.first = job->table + at[!now].first_row * (size_t)job->grid->n_features;
        }
        gather_level(job, level, &at[now], &c[now], &p, first, m, &next);
    }
}

void SPIN_CPU(grid)(struct spin_device *d, const struct spin_grid *grid, const float *table,
                    size_t n, const float *x_u, float *z)
{
    struct grid_job job = {.grid = grid, .table = table, .n = n, .x_u = x_u, .z = z};
    SPIN_CPU_CLOCK(d, SPIN_OP_GRID);

    spin_pool_rows(spin_cpu_pool(d), n, BLOCK, grid_task, &job);
}

/* ---- Forward, with lazy Adam ----------------------------------------------------------------- */

/* Applies the Adam steps that a line has missed. `from` is the last step that the line took, and
 * `at` the index of the line's first value. */
static void catch_up_line(const struct grid_job *job, float from, size_t at)
{
    const struct spin_cpu_lazy_adam *lazy = job->lazy;
    size_t step = (size_t)from, missed = (size_t)lazy->public.done - step;
    float skipped_step = lazy->skipped_step[2 * step],
          skipped_eps = lazy->skipped_step[2 * step + 1];
    float decay_m = lazy->moment_decay[2 * missed], decay_v = lazy->moment_decay[2 * missed + 1];
    float *restrict p = job->p + at, *restrict m = job->m + at, *restrict v = job->v + at;

    for (size_t i = 0; i < SPIN_LINE; i++)
        spin_adam_skip(skipped_step, skipped_eps, decay_m, decay_v, &p[i], &m[i], &v[i]);
}

/* Applies missed Adam steps to the lines (struct spin_lazy_adam) that the corners of a block need,
 * and marks these lines. `begin` is the index of the first value that belongs to a line, and `line`
 * is the first line of the level. */
static void update_lines(const struct grid_job *job, const struct corners *c,
                         const struct points *p, int m, size_t begin, size_t line,
                         const struct ahead *next)
{
    float mark = (float)(job->lazy->public.done + 1), done = (float)job->lazy->public.done;
    float *lines = job->lazy->public.last;
    uint32_t width = (uint32_t)job->grid->n_features;

    for (int b = 0; b < m; b++) {
        size_t before = SIZE_MAX;

        for (int k = 0; k < CORNERS && next->c; k++)
            __builtin_prefetch(lines + line + (size_t)next->c->row[k][b] * width / SPIN_LINE, 0, 2);
        if (!p->inside[b])
            continue;
        for (int k = 0; k < CORNERS; k++) {
            size_t at = line + (size_t)c->row[k][b] * width / SPIN_LINE;
            float last;

            if (at == before) /* corners that are neighbours along x mostly share a line */
                continue;
            before = at;
            last = lines[at];
            if (last == mark)
                continue;
            if (last != done)
                catch_up_line(job, last, begin + at * SPIN_LINE);
            lines[at] = mark;
        }
    }
}

/* Runs as one task per level, so that no line is updated twice. */
static void grid_lazy_task(void *context, int task)
{
    const struct grid_job *job = context;
    const struct spin_grid *grid = job->grid;
    int level = grid->n_levels - 1 - task, lazy_level = spin_lazy_level(grid);
    size_t width = (size_t)grid->n_features, begin = grid->offset[lazy_level] * width;
    unsigned before = spin_denormals_off();
    struct level at;
    struct block block[2];

    level_set(&at, grid, level);
    block_set(&block[0], job, &at, 0);
    for (size_t first = 0, i = 0; first < job->n; first += BLOCK, i++) {
        struct block *b = &block[i & 1], *after = &block[~i & 1];
        struct ahead next = {0};

        if (first + BLOCK < job->n) {
            block_set(after, job, &at, first + BLOCK);
            next.c = &after->c;
            next.first = job->table + at.first_row * width;
        }
        if (level >= lazy_level)
            update_lines(job, &b->c, &b->p, b->m, begin, (at.first_row * width - begin) / SPIN_LINE,
                         &next);
        gather_level(job, level, &at, &b->c, &b->p, first, b->m, &next);
    }
    spin_denormals_back(before);
}

void SPIN_CPU(lazy_adam_grid)(struct spin_device *d, struct spin_lazy_adam *lazy, size_t n,
                              const float *x_u, float *z)
{
    const struct spin_cpu_lazy_adam *own = (const struct spin_cpu_lazy_adam *)lazy;
    const struct spin_param_group *table = &own->table;
    struct grid_job job = {.grid = &own->grid,
                           .table = table->p,
                           .n = n,
                           .x_u = x_u,
                           .z = z,
                           .lazy = own,
                           .p = table->p,
                           .m = table->m,
                           .v = table->v};
    SPIN_CPU_CLOCK(d, SPIN_OP_GRID);

    spin_pool_run(spin_cpu_pool(d), own->grid.n_levels, grid_lazy_task, &job);
}

/* ---- Backward -------------------------------------------------------------------------------- */

/* Interpolates from a to b along one axis, with weight w: a + w (b - a). */
static inline __attribute__((always_inline)) quad mix(quad a, quad b, float w)
{
    return a + w * (b - a);
}

#if defined(__clang__) || __GNUC__ >= 12
#define SHUFFLE(a, b, ...) __builtin_shufflevector(a, b, __VA_ARGS__)
#else
typedef int quad_of_ints __attribute__((vector_size(16)));
#define SHUFFLE(a, b, ...) __builtin_shuffle(a, b, (quad_of_ints){__VA_ARGS__})
#endif

/* Returns the gradient with respect to the smoothstep weights of x, y and z. For each of these
 * axes, the features at the upper corners minus those at the lower ones are interpolated along the
 * other axes, t first; the result is the dot product with g. */
static inline __attribute__((always_inline)) quad slopes(const quad v[CORNERS], quad g,
                                                         const struct corners *c, int b)
{
    float wx = c->w[0][b], wy = c->w[1][b], wz = c->w[2][b], wt = c->w[3][b];
    quad xyz[8], xy[4], dz[4], x[2], dy[2], gx, gy, gz, pair_lo, pair_hi, pair, last, sum;

    for (int k = 0; k < 8; k++)
        xyz[k] = mix(v[k], v[k + 8], wt);
    for (int k = 0; k < 4; k++) {
        dz[k] = xyz[k + 4] - xyz[k];
        xy[k] = xyz[k] + wz * dz[k];
    }
    for (int k = 0; k < 2; k++) {
        dy[k] = xy[k + 2] - xy[k];
        x[k] = xy[k] + wy * dy[k];
    }
    gx = (x[1] - x[0]) * g;
    gy = mix(dy[0], dy[1], wx) * g;
    gz = mix(mix(dz[0], dz[1], wx), mix(dz[2], dz[3], wx), wy) * g;

    /* The three dot products, each over four features, are computed together. */
    pair_lo = SHUFFLE(gx, gy, 0, 4, 1, 5);
    pair_hi = SHUFFLE(gx, gy, 2, 6, 3, 7);
    pair = pair_lo + pair_hi;                /* lanes: x0+x2, y0+y2, x1+x3, y1+y3 */
    last = gz + SHUFFLE(gz, gz, 2, 3, 0, 1); /* lanes: z0+z2, z1+z3, ... */
    sum = SHUFFLE(pair, last, 0, 1, 4, 4) + SHUFFLE(pair, last, 2, 3, 5, 5);
    return sum;
}

/* The adjoint of gather_features(). If d_x is not NULL, also adds the gradient of the positions,
 * which includes the slopes of smoothstep, to d_x. */
static inline __attribute__((always_inline)) void
scatter_gradients(const float *table, float *d_table, const struct corners *c,
                  const struct points *p, int m, int width, int lanes, const float *d_z,
                  size_t z_width, quad *d_x, const struct ahead *next)
{
    for (int b = 0; b < m; b++) {
        quad g = quad_load(d_z + (size_t)b * z_width, lanes);

        prefetch_rows(next, b, width);
        if (!p->inside[b])
            continue;
        for (int k = 0; k < CORNERS; k++) {
            float *at = d_table + (size_t)c->row[k][b] * (size_t)width;

            quad_store(at, quad_load(at, lanes) + c->weight[k][b] * g, lanes);
        }
        if (d_x) {
            quad v[CORNERS], slope = {c->slope[0][b], c->slope[1][b], c->slope[2][b], 0.0f};

            for (int k = 0; k < CORNERS; k++)
                v[k] = quad_load(table + (size_t)c->row[k][b] * (size_t)width, lanes);
            d_x[b] += slopes(v, g, c, b) * slope;
        }
    }
}

static void grid_back_task(void *context, int task)
{
    const struct grid_job *job = context;
    const struct spin_grid *grid = job->grid;
    int level = grid->n_levels - 1 - task; /* the finest levels first, as they take longest */
    size_t width = (size_t)grid->n_features, z_width = (size_t)grid->n_levels * width;
    static const struct ahead nothing;
    const float *table = job->table;
    float *d_table = job->d_table;
    struct level at;
    struct block block[2];

    level_set(&at, grid, level);
    table += at.first_row * width;
    d_table += at.first_row * width;
    block_set(&block[0], job, &at, 0);
    for (size_t first = 0, i = 0; first < job->n; first += BLOCK, i++) {
        const struct corners *c = &block[i & 1].c;
        const struct points *p = &block[i & 1].p;
        int m = block[i & 1].m;
        const float *d_z = job->d_z + first * z_width + (size_t)level * width;
        quad *d_x = job->d_x ? job->d_x + (size_t)level * job->n + first : NULL;
        struct ahead next = {0};

        if (first + BLOCK < job->n) {
            block_set(&block[~i & 1], job, &at, first + BLOCK);
            next = (struct ahead){&block[~i & 1].c, d_table, d_x ? table : NULL};
        }
        if (d_x)
            memset(d_x, 0, (size_t)m * sizeof *d_x);
        switch (grid->n_features) {
        case 1:
            scatter_gradients(table, d_table, c, p, m, 1, 1, d_z, z_width, d_x, &next);
            break;
        case 2:
            scatter_gradients(table, d_table, c, p, m, 2, 2, d_z, z_width, d_x, &next);
            break;
        case 4:
            scatter_gradients(table, d_table, c, p, m, 4, 4, d_z, z_width, d_x, &next);
            break;
        default:
            scatter_gradients(table, d_table, c, p, m, 8, 4, d_z, z_width, d_x, &next);
            scatter_gradients(table + 4, d_table + 4, c, p, m, 8, 4, d_z + 4, z_width, d_x,
                              &nothing);
        }
    }
}

static void sum_levels_task(void *context, size_t first, size_t end)
{
    const struct grid_job *job = context;
    int n_levels = job->grid->n_levels;
    quad sum[SPIN_MAX_LEVELS];

    for (size_t i = first; i < end; i++) {
        for (int level = 0; level < n_levels; level++)
            sum[level] = job->d_x[(size_t)level * job->n + i];
        for (int step = 1; step < n_levels; step *= 2)
            for (int level = 0; level + step < n_levels; level += 2 * step)
                sum[level] += sum[level + step];
        sum[0][3] = 0.0f; /* the gradient with respect to time is not used */
        quad_store(job->d_x_u + i * 4, sum[0], 4);
    }
}

void SPIN_CPU(grid_back)(struct spin_device *d, const struct spin_grid *grid, const float *table,
                         const struct spin_active *active, const float *x_u, const float *d_z,
                         float *d_table, float *d_x_u)
{
    struct grid_job job = {.grid = grid,
                           .table = table,
                           .n = *active->n,
                           .rows = active->row,
                           .x_u = x_u,
                           .d_z = d_z,
                           .d_table = d_table,
                           .d_x_u = d_x_u};
    SPIN_CPU_CLOCK(d, SPIN_OP_GRID_BACK);

    if (d_x_u) {
        job.d_x = spin_cpu_scratch_need(d, SPIN_SCRATCH_GRID,
                                        (size_t)grid->n_levels * job.n * sizeof(quad));
        if (!job.d_x)
            return;
    }
    spin_pool_run(spin_cpu_pool(d), grid->n_levels, grid_back_task, &job);
    if (d_x_u)
        spin_pool_rows(spin_cpu_pool(d), job.n, CHUNK, sum_levels_task, &job);
}
