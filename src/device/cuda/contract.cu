/* Maps means to the unit cube, propagates gradients back, and adds up the statistics for
 * densification. Compiled without fused multiply-add, as for the CPU, since positions in the grid
 * are defined with one rounding per operation. */
#include "device/cuda/cuda.h"
#include "math/contract.h"

static __device__ spin_vec3 normalised(const struct spin_scene_transform &transform, const float *p)
{
    return spin_v3(spin_contract_axis(p[0], transform.centre[0], transform.inv_radius),
                   spin_contract_axis(p[1], transform.centre[1], transform.inv_radius),
                   spin_contract_axis(p[2], transform.centre[2], transform.inv_radius));
}

static __global__ void contract_kernel(struct spin_scene_transform transform, size_t n,
                                       const float *means, float t, float *x_u)
{
    size_t i = GPU_INDEX();
    spin_vec3 u;

    if (i >= n)
        return;
    u = normalised(transform, means + 3 * i);
    if (!transform.raw)
        u = spin_contract(u);
    x_u[4 * i] = u.x;
    x_u[4 * i + 1] = u.y;
    x_u[4 * i + 2] = u.z;
    x_u[4 * i + 3] = spin_clamp_unit(t);
}

void cuda_contract(struct spin_device *d, const struct spin_scene_transform *transform,
                   const struct spin_frame_batch *frames, float *x_u)
{
    cuda_clocked clocked(d, SPIN_OP_CONTRACT);
    for (int f = 0; f < frames->n_frames; f++) {
        const auto *frame = &frames->frame[f];

        GPU_EACH(gpu_of(d), frame->n, contract_kernel, *transform, frame->n, frame->means, frame->t,
                 x_u + 4 * frame->first);
    }
}

static __global__ void contract_back_kernel(struct spin_scene_transform transform,
                                            struct cuda_rows rows, const float *means,
                                            const float *d_x_u, float *d_means)
{
    size_t i = GPU_INDEX(), row;
    spin_vec3 g;

    if (!cuda_row(rows, i, &row))
        return;
    g = spin_v3(d_x_u[4 * i], d_x_u[4 * i + 1], d_x_u[4 * i + 2]);
    if (!transform.raw)
        g = spin_contract_adj(normalised(transform, means + 3 * row), g);
    d_means[3 * row] += g.x * transform.inv_radius;
    d_means[3 * row + 1] += g.y * transform.inv_radius;
    d_means[3 * row + 2] += g.z * transform.inv_radius;
}

void cuda_contract_back(struct spin_device *d, const struct spin_scene_transform *transform,
                        const struct spin_frame_batch *frames, const struct spin_active *active,
                        const float *d_x_u)
{
    cuda_clocked clocked(d, SPIN_OP_CONTRACT);
    for (int f = 0; f < frames->n_frames; f++) {
        const auto *frame = &frames->frame[f];

        GPU_EACH(gpu_of(d), active->most, contract_back_kernel, *transform,
                 cuda_rows_of(active, frame->first, frame->n), frame->means, d_x_u, frame->d_means);
    }
}

/* Converts gradients from pixel coordinates u to normalised device coordinates x, where u = ((x +
 * 1) width - 1) / 2, and adds their lengths. */
static __global__ void densify_stats_kernel(size_t n, bool absolute, float half_width,
                                            float half_height, const struct spin_splat2d *splat2d,
                                            const struct spin_splat2d_grad *d_splat2d, float *sum,
                                            uint32_t *seen)
{
    size_t i = GPU_INDEX();
    float x, y;

    if (i >= n || splat2d[i].radius_px <= 0)
        return;
    x = half_width * (absolute ? d_splat2d[i].absolute_u_px : d_splat2d[i].u_px);
    y = half_height * (absolute ? d_splat2d[i].absolute_v_px : d_splat2d[i].v_px);
    sum[i] += sqrtf(x * x + y * y);
    seen[i]++;
}

void cuda_densify_stats(struct spin_device *d, const struct spin_view_batch *views,
                        const struct spin_frame_batch *frames, const struct spin_splat2d *splat2d,
                        const struct spin_splat2d_grad *d_splat2d)
{
    cuda_clocked clocked(d, SPIN_OP_PROJECT_BACK);
    for (int k = 0; k < views->n_views; k++) {
        const auto *view = &views->view[k];
        const auto *frame = &frames->frame[view->frame];

        if (frame->gradient)
            GPU_EACH(gpu_of(d), view->n, densify_stats_kernel, view->n, views->absolute,
                     0.5f * (float)view->camera.width, 0.5f * (float)view->camera.height,
                     splat2d + view->first, d_splat2d + view->first, frame->gradient, frame->seen);
    }
}
