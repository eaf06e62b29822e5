/* What every splat adds to the heads' outputs by itself, and back (the layout is in device.h). */
#include "device/cpu/cpu.h"

enum { CHUNK = 1024 };

struct job {
    size_t n, n_all;
    const uint32_t *rows;
    const float *from;
    float *to;
};

/* Where splat i's value of column k lies in the groups of n splats. */
static size_t place(size_t n, size_t i, size_t k)
{
    if (k < SPIN_ATTR_ROTATION)
        return 3 * i + k;
    if (k < SPIN_ATTR_SH)
        return 3 * n + 4 * i + k - SPIN_ATTR_ROTATION;
    if (k < SPIN_RESIDUAL - 1)
        return 7 * n + 3 * i + k - SPIN_ATTR_SH;
    return 10 * n + i;
}

/* The same column in a row of attributes. */
static size_t column(size_t k) { return k < SPIN_RESIDUAL - 1 ? k : SPIN_ATTR_OPACITY; }

static void own_task(void *context, int task, int worker)
{
    const struct job *job = context;
    size_t first = (size_t)task * CHUNK;
    size_t end = first + CHUNK < job->n ? first + CHUNK : job->n;

    (void)worker;
    for (size_t i = first; i < end; i++)
        for (size_t k = 0; k < SPIN_RESIDUAL; k++)
            job->to[i * SPIN_ATTR + column(k)] += job->from[place(job->n, i, k)];
}

void SPIN_CPU(residual)(struct spin_device *d, size_t n, const float *residual, float *raw)
{
    struct job job = {.n = n, .from = residual, .to = raw};

    spin_pool_run(spin_cpu_pool(d), (int)((n + CHUNK - 1) / CHUNK), own_task, &job);
}

static void own_back_task(void *context, int task, int worker)
{
    const struct job *job = context;
    size_t first = (size_t)task * CHUNK;
    size_t end = first + CHUNK < job->n ? first + CHUNK : job->n;

    (void)worker;
    for (size_t i = first; i < end; i++)
        for (size_t k = 0; k < SPIN_RESIDUAL; k++)
            job->to[place(job->n_all, job->rows ? job->rows[i] : i, k)] +=
                job->from[i * SPIN_ATTR + column(k)];
}

void SPIN_CPU(residual_back)(struct spin_device *d, size_t n, size_t n_rows, const uint32_t *rows,
                             const float *d_raw, float *d_residual)
{
    struct job job = {.n = n_rows, .n_all = n, .rows = rows, .from = d_raw, .to = d_residual};

    spin_pool_run(spin_cpu_pool(d), (int)((n_rows + CHUNK - 1) / CHUNK), own_back_task, &job);
}
