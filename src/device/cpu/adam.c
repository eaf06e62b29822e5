/* Adam on the CPU: one pass over p, g, m and v that also clears g. */
#include "device/cpu/cpu.h"

#include "device/cpu/denormals.h"
#include "math/adam.h"

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
