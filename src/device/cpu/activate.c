/* Head outputs to finished attributes and back, and the list of splats that have a gradient. */
#include "device/cpu/cpu.h"

#include <string.h>

#include "math/activate.h"

enum { CHUNK = 1024 };

struct job {
    size_t n;
    const uint32_t *rows;
    const float *raw, *d_attr, *d_pos_w;
    float *out;
    uint32_t *found; /* [n], a chunk's own at its place */
    uint32_t *count; /* [chunks] */
};

static int n_chunks(size_t n) { return (int)((n + CHUNK - 1) / CHUNK); }

static void attr_task(void *context, int task, int worker)
{
    const struct job *job = context;
    size_t first = (size_t)task * CHUNK;
    size_t end = first + CHUNK < job->n ? first + CHUNK : job->n;

    (void)worker;
    for (size_t i = first; i < end; i++) {
        const float *h = job->raw + i * SPIN_ATTR;
        float *a = job->out + i * SPIN_ATTR;

        for (int k = 0; k < 3; k++)
            a[SPIN_ATTR_SCALE + k] = spin_scale_of(h[SPIN_ATTR_SCALE + k]);
        spin_rotation_of(h + SPIN_ATTR_ROTATION, a + SPIN_ATTR_ROTATION);
        memcpy(a + SPIN_ATTR_SH, h + SPIN_ATTR_SH, 48 * sizeof *a);
        a[SPIN_ATTR_OPACITY] = spin_opacity_of(h[SPIN_ATTR_OPACITY]);
    }
}

void SPIN_CPU(attr)(struct spin_device *d, size_t n, const float *raw, float *attr)
{
    struct job job = {.n = n, .raw = raw, .out = attr};

    spin_pool_run(spin_cpu_pool(d), n_chunks(n), attr_task, &job);
}

static void attr_back_task(void *context, int task, int worker)
{
    const struct job *job = context;
    size_t first = (size_t)task * CHUNK;
    size_t end = first + CHUNK < job->n ? first + CHUNK : job->n;

    (void)worker;
    for (size_t i = first; i < end; i++) {
        size_t row = job->rows ? job->rows[i] : i;
        const float *h = job->raw + row * SPIN_ATTR, *g = job->d_attr + row * SPIN_ATTR;
        float *d_h = job->out + i * SPIN_ATTR;

        for (int k = 0; k < 3; k++)
            d_h[SPIN_ATTR_SCALE + k] =
                spin_scale_adj(h[SPIN_ATTR_SCALE + k], g[SPIN_ATTR_SCALE + k]);
        spin_rotation_adj(h + SPIN_ATTR_ROTATION, g + SPIN_ATTR_ROTATION, d_h + SPIN_ATTR_ROTATION);
        memcpy(d_h + SPIN_ATTR_SH, g + SPIN_ATTR_SH, 48 * sizeof *d_h);
        d_h[SPIN_ATTR_OPACITY] = spin_opacity_adj(h[SPIN_ATTR_OPACITY], g[SPIN_ATTR_OPACITY]);
    }
}

void SPIN_CPU(activate_back)(struct spin_device *d, size_t n_rows, const uint32_t *rows,
                             const float *raw, const float *d_attr, float *d_raw)
{
    struct job job = {.n = n_rows, .rows = rows, .raw = raw, .d_attr = d_attr, .out = d_raw};

    spin_pool_run(spin_cpu_pool(d), n_chunks(n_rows), attr_back_task, &job);
}

/* All bits but the signs, or-ed: not zero when any value is (NaN counts, -0 does not). */
static uint32_t any_set(const float *x, int n)
{
    uint32_t bits = 0;

    for (int i = 0; i < n; i++)
        bits |= spin_bits_of_float(x[i]);
    return bits & 0x7fffffffu;
}

static void active_task(void *context, int task, int worker)
{
    const struct job *job = context;
    size_t first = (size_t)task * CHUNK;
    size_t end = first + CHUNK < job->n ? first + CHUNK : job->n;
    uint32_t *found = job->found + first, n = 0;

    (void)worker;
    for (size_t i = first; i < end; i++)
        if (any_set(job->d_attr + i * SPIN_ATTR, SPIN_ATTR) ||
            (job->d_pos_w && any_set(job->d_pos_w + i * 3, 3)))
            found[n++] = (uint32_t)i;
    job->count[task] = n;
}

/* Every chunk lists its own, then the lists are put together in order. */
size_t SPIN_CPU(active)(struct spin_device *d, size_t n, const float *d_attr, const float *d_pos_w,
                        uint32_t *rows)
{
    int chunks = n_chunks(n);
    uint32_t *scratch =
        spin_cpu_scratch_need(d, SPIN_SCRATCH_ACTIVE, (n + (size_t)chunks + 1) * sizeof *scratch);
    struct job job = {.n = n, .d_attr = d_attr, .d_pos_w = d_pos_w, .found = scratch};
    size_t total = 0;

    if (!scratch)
        return 0;
    job.count = scratch + n;
    spin_pool_run(spin_cpu_pool(d), chunks, active_task, &job);
    for (int c = 0; c < chunks; c++) {
        memcpy(rows + total, job.found + (size_t)c * CHUNK, job.count[c] * sizeof *rows);
        total += job.count[c];
    }
    return total;
}

struct regularise_back {
    const uint32_t *rows;
    size_t n_rows;
    float d_scale, d_opacity;
    float *d_attr;
};

static void shrink_task(void *context, int task, int worker)
{
    const struct regularise_back *job = context;
    size_t first = (size_t)task * CHUNK;
    size_t end = first + CHUNK < job->n_rows ? first + CHUNK : job->n_rows;

    (void)worker;
    for (size_t i = first; i < end; i++) {
        float *g = job->d_attr + (size_t)job->rows[i] * SPIN_ATTR;

        for (int k = 0; k < 3; k++)
            g[SPIN_ATTR_SCALE + k] += job->d_scale;
        g[SPIN_ATTR_OPACITY] += job->d_opacity;
    }
}

void SPIN_CPU(regularise_back)(struct spin_device *d, size_t n_rows, const uint32_t *rows,
                               float d_scale, float d_opacity, float *d_attr)
{
    struct regularise_back job = {rows, n_rows, d_scale, d_opacity, d_attr};

    spin_pool_run(spin_cpu_pool(d), n_chunks(n_rows), shrink_task, &job);
}
