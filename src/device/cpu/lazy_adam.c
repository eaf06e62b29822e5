/* Lazy Adam, see struct spin_lazy_adam in device.h. */
#include "device/cpu/lazy_adam.h"

#include "base/base.h"
#include "device/cpu/cpu.h"
#include "device/cpu/denormals.h"
#include "math/adam.h"

#if defined(__AVX512F__)
#include <immintrin.h>
#endif

/* REACH: number of steps after which the effect of a gradient is neglected. It has then decayed by
 * the factor (.9 / sqrt(.999))^400 = 6e-19. */
enum { LINES = 4096, AHEAD = 8, REACH = 400 };

struct job {
    const struct spin_cpu_lazy_adam *lazy;
    size_t n_lines;
    struct spin_adam_step step;
    float *p, *g, *m, *v; /* the arrays of the table, starting at the first line */
    float *out;
};

static void step_range(struct spin_adam_step step, size_t n, float *restrict p, float *restrict g,
                       float *restrict m, float *restrict v)
{
    for (size_t i = 0; i < n; i++) {
        spin_adam_one(step, g[i], &p[i], &m[i], &v[i]);
        g[i] = 0.0f;
    }
}

/* Lists the marked lines of [first, end) in ascending order, and returns their number. The code is
 * branchless, since a branch would be mispredicted often. */
static size_t list_marked(const struct spin_cpu_lazy_adam *lazy, size_t first, size_t end,
                          uint32_t *list)
{
    float mark = (float)(lazy->public.done + 1);
    size_t n = 0, i = first;

#if defined(__AVX512F__)
    __m512i index = _mm512_setr_epi32(0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15);

    for (; i + 16 <= end; i += 16, index = _mm512_add_epi32(index, _mm512_set1_epi32(16))) {
        __mmask16 marked = _mm512_cmp_ps_mask(_mm512_loadu_ps(lazy->public.last + i),
                                              _mm512_set1_ps(mark), _CMP_EQ_OQ);

        _mm512_mask_compressstoreu_epi32(list + n, marked, index);
        n += (size_t)__builtin_popcount(marked);
    }
#endif
    for (; i < end; i++) {
        list[n] = (uint32_t)(i - first);
        n += lazy->public.last[i] == mark;
    }
    return n;
}

static void step_task(void *context, size_t first, size_t end)
{
    const struct job *job = context;
    uint32_t list[LINES];
    size_t n = list_marked(job->lazy, first, end, list);
    unsigned before = spin_denormals_off();

    for (size_t i = 0; i < n; i++) {
        size_t at = (first + list[i]) * SPIN_LINE;

        if (i + AHEAD < n) {
            size_t next = (first + list[i + AHEAD]) * SPIN_LINE;

            __builtin_prefetch(job->p + next, 1);
            __builtin_prefetch(job->g + next, 1);
            __builtin_prefetch(job->m + next, 1);
            __builtin_prefetch(job->v + next, 1);
        }
        step_range(job->step, SPIN_LINE, job->p + at, job->g + at, job->m + at, job->v + at);
    }
    spin_denormals_back(before);
}

/* Returns the number of floats of the table before the first line. */
static size_t first_line(const struct spin_grid *grid)
{
    return (size_t)grid->offset[spin_lazy_level(grid)] * (size_t)grid->n_features;
}

spin_status SPIN_CPU(lazy_adam_enable)(struct spin_device *d, const struct spin_grid *grid,
                                       const struct spin_param_group *table, int64_t steps,
                                       struct spin_lazy_adam **out)
{
    size_t n = (size_t)steps + 1;
    struct spin_cpu_lazy_adam *lazy;
    void *block = NULL, *last = NULL;

    *out = NULL;
    SPIN_TRY(spin_alloc(1, sizeof *lazy + n * (4 * sizeof(float) + 2 * sizeof(double)), &block));
    lazy = block;
    lazy->grid = *grid;
    lazy->table = *table;
    lazy->public.n_lines = (table->n - first_line(grid)) / SPIN_LINE;
    lazy->sum = (double *)(lazy + 1);
    lazy->skipped_step = (float *)(lazy->sum + 2 * n);
    lazy->moment_decay = lazy->skipped_step + 2 * n;
    for (size_t i = 0; i < n; i++) {
        lazy->moment_decay[2 * i] = (float)pow((double)0.9f, (double)i);
        lazy->moment_decay[2 * i + 1] = (float)pow((double)0.999f, (double)i);
        lazy->skipped_step[2 * i + 1] = 1e-15f;
    }
    if (d->op->reserve(d, lazy->public.n_lines * sizeof(float), &last) != SPIN_OK) {
        free(block);
        return SPIN_E_MEMORY;
    }
    lazy->public.last = last;
    *out = &lazy->public;
    return SPIN_OK;
}

void SPIN_CPU(lazy_adam_close)(struct spin_device *d, struct spin_lazy_adam *lazy)
{
    if (lazy)
        d->op->release(d, lazy->last);
    free(lazy);
}

void SPIN_CPU(lazy_adam_advance)(struct spin_device *d, struct spin_lazy_adam *lazy, double lr)
{
    struct spin_cpu_lazy_adam *own = (struct spin_cpu_lazy_adam *)lazy;
    int64_t step = ++lazy->done, first = step > REACH ? step - REACH : 0;
    struct spin_adam_step s = spin_adam_step_of(lr, step);
    double one = (double)s.rate / (double)s.inv_root, other = (double)s.rate;

    (void)d;
    for (int64_t j = step - 1; j >= first; j--) {
        one *= (double)0.9f / sqrt((double)0.999f);
        other *= (double)0.9f;
        own->sum[2 * j] += one;
        own->sum[2 * j + 1] += other;
        own->skipped_step[2 * j] = (float)own->sum[2 * j];
        own->skipped_step[2 * j + 1] = (float)(1e-15 * own->sum[2 * j] / own->sum[2 * j + 1]);
    }
}

void SPIN_CPU(lazy_adam_step)(struct spin_device *d, struct spin_lazy_adam *lazy, double lr)
{
    const struct spin_cpu_lazy_adam *own = (const struct spin_cpu_lazy_adam *)lazy;
    /* the dense levels, which are not divided into lines */
    struct spin_param_group first = own->table;
    size_t before = first_line(&own->grid);
    struct job job = {.step = spin_adam_step_of(lr, lazy->done + 1),
                      .p = own->table.p + before,
                      .g = own->table.g + before,
                      .m = own->table.m + before,
                      .v = own->table.v + before,
                      .lazy = own,
                      .n_lines = lazy->n_lines};

    first.n = before;
    first.lr = lr;
    first.step = lazy->done + 1;
    SPIN_CPU(adam)(d, 1, &first);
    SPIN_CPU_CLOCK(d, SPIN_OP_ADAM);
    spin_pool_rows(spin_cpu_pool(d), job.n_lines, LINES, step_task, &job);
    SPIN_CPU(lazy_adam_advance)(d, lazy, lr);
}

static void flush_task(void *context, size_t first, size_t end)
{
    const struct job *job = context;
    unsigned before = spin_denormals_off();

    for (size_t line = first; line < end; line++) {
        const float *skipped_step =
            job->lazy->skipped_step + 2 * (size_t)job->lazy->public.last[line];

        for (size_t i = line * SPIN_LINE; i < (line + 1) * SPIN_LINE; i++) {
            float p = job->p[i], m = job->m[i], v = job->v[i];

            spin_adam_skip(skipped_step[0], skipped_step[1], 1, 1, &p, &m, &v);
            job->out[i] = p;
        }
    }
    spin_denormals_back(before);
}

void SPIN_CPU(lazy_adam_flush)(struct spin_device *d, struct spin_lazy_adam *lazy, float *out)
{
    const struct spin_cpu_lazy_adam *own = (const struct spin_cpu_lazy_adam *)lazy;
    size_t before = first_line(&own->grid);
    struct job job = {.lazy = own,
                      .n_lines = lazy->n_lines,
                      .p = own->table.p + before,
                      .m = own->table.m + before,
                      .v = own->table.v + before,
                      .out = out + before};

    memcpy(out, own->table.p, before * sizeof *out);
    spin_pool_rows(spin_cpu_pool(d), job.n_lines, LINES, flush_task, &job);
}
