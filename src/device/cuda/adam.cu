/* Runs Adam with one thread per parameter. Each thread also sets the gradient to zero. One launch
 * processes up to MOST_GROUPS groups of parameters, which are passed as arguments. Each group has
 * its own blocks. */
#include "device/cuda/cuda.h"
#include "math/adam.h"
#include "math/approx.h"

enum { MOST_GROUPS = 64 };
struct groups {
    int n;
    struct {
        float *p, *g, *m, *v;
        size_t n;
        struct spin_adam_step step;
        unsigned end; /* index after the last block of the group */
    } group[MOST_GROUPS];
};
static_assert(sizeof(struct groups) <= 4000, "a launch has 4096 bytes of arguments");

static __global__ void adam_kernel(struct groups groups)
{
    int k = 0;
    unsigned first;
    size_t i;

    while (blockIdx.x >= groups.group[k].end)
        k++;
    first = k > 0 ? groups.group[k - 1].end : 0;
    i = (size_t)(blockIdx.x - first) * blockDim.x + threadIdx.x;
    if (i >= groups.group[k].n)
        return;
    spin_adam_one(groups.group[k].step, groups.group[k].g[i], &groups.group[k].p[i],
                  &groups.group[k].m[i], &groups.group[k].v[i]);
    groups.group[k].g[i] = 0;
}

static void launch_groups(struct spin_device *d, struct groups *groups)
{
    if (groups->n > 0)
        GPU_LAUNCH(gpu_of(d), adam_kernel, groups->group[groups->n - 1].end, GPU_BLOCK, *groups);
    groups->n = 0;
}

void cuda_adam(struct spin_device *d, int n_groups, const struct spin_param_group *group)
{
    struct groups groups = {};

    cuda_clocked clocked(d, SPIN_OP_ADAM);
    for (int k = 0; k < n_groups; k++) {
        unsigned first = groups.n > 0 ? groups.group[groups.n - 1].end : 0;

        if (group[k].n == 0)
            continue;
        groups.group[groups.n++] = {group[k].p,
                                    group[k].g,
                                    group[k].m,
                                    group[k].v,
                                    group[k].n,
                                    spin_adam_step_of(group[k].lr, group[k].step),
                                    first + gpu_blocks(group[k].n)};
        if (groups.n == MOST_GROUPS)
            launch_groups(d, &groups);
    }
    launch_groups(d, &groups);
}

/* ---- Nonfinite values ------------------------------------------------------------------------ */

static __global__ void not_finite_kernel(size_t n, const float *values, uint32_t *count)
{
    size_t stride = (size_t)gridDim.x * blockDim.x;
    uint32_t bad = 0;

    for (size_t i = GPU_INDEX(); i < n; i += stride)
        bad += (spin_bits_of_float(values[i]) & 0x7f800000u) == 0x7f800000u;
    if (bad)
        atomicAdd(count, bad);
}

void cuda_not_finite(struct spin_device *d, size_t n, const float *values, uint32_t *count)
{
    enum { MOST = 1024 };
    unsigned blocks = n > 0 ? gpu_blocks(n) : 1;

    cuda_clocked clocked(d, SPIN_OP_ADAM);
    GPU_LAUNCH(gpu_of(d), not_finite_kernel, blocks < MOST ? blocks : (unsigned)MOST, GPU_BLOCK, n,
               values, count);
}
