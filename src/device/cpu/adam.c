/* Adam on the CPU. One pass over the parameters p, their gradients g and the moments m and v
 * updates p, m and v, and sets g to zero. */
#include "device/cpu/cpu.h"

#include "device/cpu/denormals.h"
#include "math/adam.h"
#include "math/approx.h"

enum { CHUNK = 1 << 15 };

struct job {
    size_t n;
    struct spin_adam_step step;
    float *p, *g, *m, *v;
};

static void step_range(struct spin_adam_step step, size_t n, float *restrict p, float *restrict g,
                       float *restrict m, float *restrict v)
{
    for (size_t i = 0; i < n; i++) {
        spin_adam_one(step, g[i], &p[i], &m[i], &v[i]);
        g[i] = 0.0f;
    }
}

static void adam_task(void *context, size_t first, size_t end)
{
    const struct job *job = context;
    unsigned before = spin_denormals_off();

    step_range(job->step, end - first, job->p + first, job->g + first, job->m + first,
               job->v + first);
    spin_denormals_back(before);
}

void SPIN_CPU(adam)(struct spin_device *d, int n_groups, const struct spin_param_group *group)
{
    SPIN_CPU_CLOCK(d, SPIN_OP_ADAM);

    for (int k = 0; k < n_groups; k++) {
        const struct spin_param_group *one = &group[k];
        struct job job = {.n = one->n,
                          .step = spin_adam_step_of(one->lr, one->step),
                          .p = one->p,
                          .g = one->g,
                          .m = one->m,
                          .v = one->v};

        spin_pool_rows(spin_cpu_pool(d), one->n, CHUNK, adam_task, &job);
    }
}

/* ---- Nonfinite values ------------------------------------------------------------------------ */

enum { FINITE_CHUNK = 1 << 16 };
struct finite {
    size_t n;
    const float *values;
    uint32_t *count;
};

/* Counts the values that are NaN or infinite, by a test that compilers vectorise: all bits of their
 * exponent are 1. */
static void finite_task(void *context, size_t first, size_t end)
{
    const struct finite *job = context;
    uint32_t bad = 0;

    for (size_t i = first; i < end; i++)
        bad += (spin_bits_of_float(job->values[i]) & 0x7f800000u) == 0x7f800000u;
    if (bad)
        __atomic_fetch_add(job->count, bad, __ATOMIC_RELAXED);
}

void SPIN_CPU(not_finite)(struct spin_device *d, size_t n, const float *values, uint32_t *count)
{
    SPIN_CPU_CLOCK(d, SPIN_OP_ADAM);
    struct finite job = {n, values, count};

    spin_pool_rows(spin_cpu_pool(d), n, FINITE_CHUNK, finite_task, &job);
}
