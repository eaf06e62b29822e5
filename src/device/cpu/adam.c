/* Adam on the CPU: one pass over p, g, m and v that also clears g; and the same for a table whose
 * lines are left alone until they are needed (device.h, struct spin_lazy_adam). */
#include "device/cpu/cpu.h"

#include "device/cpu/denormals.h"
#include "math/adam.h"

#if defined(__AVX512F__)
#include <immintrin.h>
#endif

enum { CHUNK = 1 << 15, LINES = 4096, AHEAD = 8 };

struct job {
    size_t n;
    struct spin_adam_step step;
    float *p, *g, *m, *v;

    /* Lazy tables. */
    const struct spin_lazy_adam *lazy;
    size_t n_lines;
    const float *p_in, *m_in, *v_in;
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

static void adam_task(void *context, int task, int worker)
{
    const struct job *job = context;
    size_t first = (size_t)task * CHUNK;
    size_t n = job->n - first < CHUNK ? job->n - first : CHUNK;
    unsigned before = spin_denormals_off();

    (void)worker;
    step_range(job->step, n, job->p + first, job->g + first, job->m + first, job->v + first);
    spin_denormals_back(before);
}

void SPIN_CPU(adam)(struct spin_device *d, size_t n, float *p, float *g, float *m, float *v,
                    double lr, int64_t step)
{
    struct job job = {.n = n, .step = spin_adam_step_of(lr, step), .p = p, .g = g, .m = m, .v = v};

    spin_pool_run(spin_cpu_pool(d), (int)((n + CHUNK - 1) / CHUNK), adam_task, &job);
}

/* ---- lines ----------------------------------------------------------------------------------- */

/* The marked lines of [first, end), ascending. Without a branch: it would be guessed wrong. */
static size_t list_marked(const struct spin_lazy_adam *lazy, size_t first, size_t end,
                          uint32_t *list)
{
    float mark = (float)(lazy->done + 1);
    size_t n = 0, i = first;

#if defined(__AVX512F__)
    __m512i index = _mm512_setr_epi32(0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15);

    for (; i + 16 <= end; i += 16, index = _mm512_add_epi32(index, _mm512_set1_epi32(16))) {
        __mmask16 marked =
            _mm512_cmp_ps_mask(_mm512_loadu_ps(lazy->last + i), _mm512_set1_ps(mark), _CMP_EQ_OQ);

        _mm512_mask_compressstoreu_epi32(list + n, marked, index);
        n += (size_t)__builtin_popcount(marked);
    }
#endif
    for (; i < end; i++) {
        list[n] = (uint32_t)(i - first);
        n += lazy->last[i] == mark;
    }
    return n;
}

static void adam_lazy_task(void *context, int task, int worker)
{
    const struct job *job = context;
    size_t first = (size_t)task * LINES;
    size_t end = first + LINES < job->n_lines ? first + LINES : job->n_lines;
    uint32_t list[LINES];
    size_t n = list_marked(job->lazy, first, end, list);
    unsigned before = spin_denormals_off();

    (void)worker;
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

static size_t first_line(const struct spin_grid *grid)
{
    return (size_t)grid->offset[spin_lazy_level(grid)] * (size_t)grid->n_features;
}

void SPIN_CPU(lazy_adam)(struct spin_device *d, const struct spin_grid *grid,
                         const struct spin_lazy_adam *lazy, size_t n, float *p, float *g, float *m,
                         float *v, double lr)
{
    size_t before = first_line(grid);
    struct job job = {.step = spin_adam_step_of(lr, lazy->done + 1),
                      .p = p + before,
                      .g = g + before,
                      .m = m + before,
                      .v = v + before,
                      .lazy = lazy,
                      .n_lines = (n - before) / SPIN_LINE};

    SPIN_CPU(adam)(d, before, p, g, m, v, lr, lazy->done + 1);
    spin_pool_run(spin_cpu_pool(d), (int)((job.n_lines + LINES - 1) / LINES), adam_lazy_task, &job);
}

static void settle_task(void *context, int task, int worker)
{
    const struct job *job = context;
    size_t first = (size_t)task * LINES;
    size_t end = first + LINES < job->n_lines ? first + LINES : job->n_lines;
    unsigned before = spin_denormals_off();

    (void)worker;
    for (size_t line = first; line < end; line++) {
        const float *skipped_step = job->lazy->skipped_step + 2 * (size_t)job->lazy->last[line];

        for (size_t i = line * SPIN_LINE; i < (line + 1) * SPIN_LINE; i++) {
            float p = job->p_in[i], m = job->m_in[i], v = job->v_in[i];

            spin_adam_skip(skipped_step[0], skipped_step[1], 1, 1, &p, &m, &v);
            job->out[i] = p;
        }
    }
    spin_denormals_back(before);
}

void SPIN_CPU(lazy_flush)(struct spin_device *d, const struct spin_grid *grid,
                          const struct spin_lazy_adam *lazy, size_t n, const float *p,
                          const float *m, const float *v, float *out)
{
    size_t before = first_line(grid);
    struct job job = {.lazy = lazy,
                      .n_lines = (n - before) / SPIN_LINE,
                      .p_in = p + before,
                      .m_in = m + before,
                      .v_in = v + before,
                      .out = out + before};

    d->op->upload(d, out, p, before * sizeof *out);
    spin_pool_run(spin_cpu_pool(d), (int)((job.n_lines + LINES - 1) / LINES), settle_task, &job);
}
