/* Adam on the CPU: one pass over p, g, m and v that also clears g. */
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

static void adam_task(void *context, int task)
{
    const struct job *job = context;
    size_t first = (size_t)task * CHUNK;
    size_t n = job->n - first < CHUNK ? job->n - first : CHUNK;
    unsigned before = spin_denormals_off();

    step_range(job->step, n, job->p + first, job->g + first, job->m + first, job->v + first);
    spin_denormals_back(before);
}

void SPIN_CPU(adam)(struct spin_device *d, int n_groups, const struct spin_param_group *group)
{
    double start = spin_now_s();

    for (int k = 0; k < n_groups; k++) {
        const struct spin_param_group *one = &group[k];
        struct job job = {.n = one->n,
                          .step = spin_adam_step_of(one->lr, one->step),
                          .p = one->p,
                          .g = one->g,
                          .m = one->m,
                          .v = one->v};

        spin_pool_run(spin_cpu_pool(d), (int)((one->n + CHUNK - 1) / CHUNK), adam_task, &job);
    }
    spin_cpu_spent(d, SPIN_OP_ADAM, start);
}

/* ---- Whether they are still numbers ----------------------------------------------------------- */

enum { FINITE_CHUNK = 1 << 16 };
struct finite {
    size_t n;
    const float *values;
    uint32_t *count;
};

/* The exponent alone tells: compilers take such a loop many values at a time. */
static void finite_task(void *context, int task)
{
    const struct finite *job = context;
    size_t first = (size_t)task * FINITE_CHUNK;
    size_t end = first + FINITE_CHUNK < job->n ? first + FINITE_CHUNK : job->n;
    uint32_t bad = 0;

    for (size_t i = first; i < end; i++)
        bad += (spin_bits_of_float(job->values[i]) & 0x7f800000u) == 0x7f800000u;
    if (bad)
        __atomic_fetch_add(job->count, bad, __ATOMIC_RELAXED);
}

void SPIN_CPU(not_finite)(struct spin_device *d, size_t n, const float *values, uint32_t *count)
{
    double start = spin_now_s();
    struct finite job = {n, values, count};

    spin_pool_run(spin_cpu_pool(d), (int)((n + FINITE_CHUNK - 1) / FINITE_CHUNK), finite_task,
                  &job);
    spin_cpu_spent(d, SPIN_OP_ADAM, start);
}
