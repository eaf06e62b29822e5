/* Adam, one thread a parameter; clears the gradient. */
#include "device/cuda/cuda.h"
#include "math/adam.h"

static __global__ void adam_kernel(struct spin_adam_step step, size_t n, float *p, float *g,
                                   float *m, float *v)
{
    size_t i = GPU_INDEX();

    if (i >= n)
        return;
    spin_adam_one(step, g[i], &p[i], &m[i], &v[i]);
    g[i] = 0;
}

void cuda_adam(struct spin_device *d, int n_groups, const struct spin_param_group *group)
{
    cuda_begin(d, SPIN_OP_ADAM);
    for (int k = 0; k < n_groups; k++)
        GPU_EACH(gpu_of(d), group[k].n, adam_kernel, spin_adam_step_of(group[k].lr, group[k].step),
                 group[k].n, group[k].p, group[k].g, group[k].m, group[k].v);
    cuda_end(d, SPIN_OP_ADAM);
}
