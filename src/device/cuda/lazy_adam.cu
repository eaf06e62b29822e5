/* Lazy Adam, see struct spin_lazy_adam in device.h. The host computes the sums for skipped steps,
 * as for the CPU device, and uploads them. */
#include "device/cuda/cuda.h"

#include <math.h>
#include <stdlib.h>

#include "device/cuda/cell.h"
#include "math/adam.h"

/* REACH: number of steps after which the effect of a gradient is neglected. It has then decayed by
 * the factor (.9 / sqrt(.999))^400 = 6e-19. */
enum { REACH = 400 };

struct cuda_lazy_adam {
    struct spin_lazy_adam open; /* the first member, since verbs receive a pointer to it */
    struct spin_grid grid;
    struct spin_param_group table;
    size_t before; /* number of floats of the table before the first line */
    int64_t steps;
    double *sum; /* [steps + 1][2] in host memory: the two sums of spin_adam_skip() */
    /* [steps + 1][2] in host memory, indexed by the last step that a line took: the arguments drift
     * and tiny of spin_adam_skip(). */
    float *skipped;
    /* Two arrays [steps + 1][2] in device memory: a copy of `skipped`, and the powers .9^t and
     * .999^t, indexed by the number of missed steps t. */
    float *card;
};

/* Arguments of the kernels. p, g, m and v start at the first line. */
struct lines {
    float *p, *g, *m, *v, *last;
    size_t n, before;
    const float *skipped, *decay;
    int64_t done;
};

static struct lines lines_of(const struct cuda_lazy_adam *own)
{
    const struct spin_param_group *t = &own->table;
    struct lines lines = {t->p + own->before, t->g + own->before, t->m + own->before,
                          t->v + own->before, own->open.last,     own->open.n_lines,
                          own->before,        own->card,          own->card + 2 * (own->steps + 1),
                          own->open.done};

    return lines;
}

spin_status cuda_lazy_adam_enable(struct spin_device *d, const struct spin_grid *grid,
                                  const struct spin_param_group *table, int64_t steps,
                                  struct spin_lazy_adam **out)
{
    size_t n = (size_t)steps + 1;
    struct cuda_lazy_adam *own = (struct cuda_lazy_adam *)calloc(
        1, sizeof *own + n * 2 * (sizeof(double) + 2 * sizeof(float)));
    void *last = NULL, *card = NULL;
    float *decay;

    *out = NULL;
    if (!own)
        return cuda_no_memory();
    own->grid = *grid;
    own->table = *table;
    own->steps = steps;
    own->before = (size_t)grid->offset[spin_lazy_level(grid)] * (size_t)grid->n_features;
    own->open.n_lines = (table->n - own->before) / SPIN_LINE;
    own->sum = (double *)(own + 1);
    own->skipped = (float *)(own->sum + 2 * n);
    decay = own->skipped + 2 * n;
    for (size_t i = 0; i < n; i++) {
        own->skipped[2 * i + 1] = 1e-15f;
        decay[2 * i] = (float)pow((double)0.9f, (double)i);
        decay[2 * i + 1] = (float)pow((double)0.999f, (double)i);
    }
    if (d->op->reserve(d, own->open.n_lines * sizeof(float), &last) != SPIN_OK ||
        d->op->reserve(d, 4 * n * sizeof(float), &card) != SPIN_OK) {
        d->op->release(d, last);
        free(own);
        return SPIN_E_MEMORY;
    }
    own->open.last = (float *)last;
    own->card = (float *)card;
    /* two arrays: `skipped`, then the powers for the number of missed steps */
    d->op->upload(d, own->card, own->skipped, 4 * n * sizeof(float));
    *out = &own->open;
    return SPIN_OK;
}

void cuda_lazy_adam_close(struct spin_device *d, struct spin_lazy_adam *lazy)
{
    struct cuda_lazy_adam *own = (struct cuda_lazy_adam *)lazy;

    if (!own)
        return;
    d->op->release(d, own->open.last);
    d->op->release(d, own->card);
    free(own);
}

/* ---- Forward --------------------------------------------------------------------------------- */

/* Applies the Adam steps that a line has missed since step `from`. */
static __device__ void catch_up_line(const struct lines &lines, size_t line, int64_t from)
{
    const float *skipped = lines.skipped + 2 * from, *decay = lines.decay + 2 * (lines.done - from);

    for (size_t i = line * SPIN_LINE; i < (line + 1) * SPIN_LINE; i++)
        spin_adam_skip(skipped[0], skipped[1], decay[0], decay[1], &lines.p[i], &lines.m[i],
                       &lines.v[i]);
}

/* Applies missed Adam steps to the lines that the points need, and marks these lines. There is one
 * thread per point and hashed level. The thread that is the first to mark a line also updates it.
 */
static __global__ void need_kernel(struct spin_grid grid, int first_level, struct lines lines,
                                   size_t n, const float *x_u)
{
    size_t i = GPU_INDEX(), before = SIZE_MAX;
    struct cuda_cell cell;
    float mark = (float)(lines.done + 1);

    if (i >= n || !cuda_cell_of(grid, first_level + (int)blockIdx.y, x_u + 4 * i, &cell))
        return;
    for (int k = 0; k < CUDA_CORNERS; k++) {
        size_t at = cuda_corner_row(cell, k) * (size_t)grid.n_features - lines.before;
        size_t line = at / SPIN_LINE;
        float last;

        if (line == before) /* corners that are neighbours along x mostly share a line */
            continue;
        before = line;
        last = atomicExch(&lines.last[line], mark);
        if (last != mark && last != (float)lines.done)
            catch_up_line(lines, line, (int64_t)last);
    }
}

void cuda_lazy_adam_grid(struct spin_device *d, struct spin_lazy_adam *lazy, size_t n,
                         const float *x_u, float *z)
{
    const struct cuda_lazy_adam *own = (const struct cuda_lazy_adam *)lazy;
    int first = spin_lazy_level(&own->grid), levels = own->grid.n_levels - first;

    if (n > 0 && levels > 0) {
        cuda_clocked clocked(d, SPIN_OP_GRID);
        GPU_LAUNCH(gpu_of(d), need_kernel, dim3(gpu_blocks(n), (unsigned)levels), GPU_BLOCK,
                   own->grid, first, lines_of(own), n, x_u);
    }
    cuda_grid(d, &own->grid, own->table.p, n, x_u, z);
}

/* ---- Adam step ------------------------------------------------------------------------------- */

static __global__ void step_kernel(struct lines lines, struct spin_adam_step step)
{
    size_t i = GPU_INDEX();

    if (i >= lines.n * SPIN_LINE || lines.last[i / SPIN_LINE] != (float)(lines.done + 1))
        return;
    spin_adam_one(step, lines.g[i], &lines.p[i], &lines.m[i], &lines.v[i]);
    lines.g[i] = 0;
}

void cuda_lazy_adam_step(struct spin_device *d, struct spin_lazy_adam *lazy, double lr)
{
    const struct cuda_lazy_adam *own = (const struct cuda_lazy_adam *)lazy;
    /* the dense levels, which are not divided into lines */
    struct spin_param_group first = own->table;

    first.n = own->before;
    first.lr = lr;
    first.step = lazy->done + 1;
    cuda_adam(d, 1, &first);
    cuda_clocked clocked(d, SPIN_OP_ADAM);
    GPU_EACH(gpu_of(d), lazy->n_lines * SPIN_LINE, step_kernel, lines_of(own),
             spin_adam_step_of(lr, first.step));
    cuda_lazy_adam_advance(d, lazy, lr);
}

void cuda_lazy_adam_advance(struct spin_device *d, struct spin_lazy_adam *lazy, double lr)
{
    struct cuda_lazy_adam *own = (struct cuda_lazy_adam *)lazy;
    int64_t step = ++lazy->done, first = step > REACH ? step - REACH : 0;
    struct spin_adam_step s = spin_adam_step_of(lr, step);
    double one = (double)s.rate / (double)s.inv_root, other = (double)s.rate;

    for (int64_t j = step - 1; j >= first; j--) {
        one *= (double)0.9f / sqrt((double)0.999f);
        other *= (double)0.9f;
        own->sum[2 * j] += one;
        own->sum[2 * j + 1] += other;
        own->skipped[2 * j] = (float)own->sum[2 * j];
        own->skipped[2 * j + 1] = (float)(1e-15 * own->sum[2 * j] / own->sum[2 * j + 1]);
    }
    d->op->upload(d, own->card + 2 * first, own->skipped + 2 * first,
                  2 * (size_t)(step - first) * sizeof(float));
}

/* ---- Flush ----------------------------------------------------------------------------------- */

/* Sets `out` to the table as if every line had taken every step. */
static __global__ void flush_kernel(struct lines lines, const float *table, float *out)
{
    size_t i = GPU_INDEX(), at = i - lines.before;
    const float *skipped;
    float p, m, v;

    if (i >= lines.before + lines.n * SPIN_LINE)
        return;
    p = table[i];
    if (i >= lines.before) {
        skipped = lines.skipped + 2 * (int64_t)lines.last[at / SPIN_LINE];
        m = lines.m[at];
        v = lines.v[at];
        spin_adam_skip(skipped[0], skipped[1], 1, 1, &p, &m, &v);
    }
    out[i] = p;
}

void cuda_lazy_adam_flush(struct spin_device *d, struct spin_lazy_adam *lazy, float *out)
{
    const struct cuda_lazy_adam *own = (const struct cuda_lazy_adam *)lazy;

    cuda_clocked clocked(d, SPIN_OP_ADAM);
    GPU_EACH(gpu_of(d), own->before + lazy->n_lines * SPIN_LINE, flush_kernel, lines_of(own),
             own->table.p, out);
}
