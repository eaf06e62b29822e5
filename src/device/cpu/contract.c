/* Maps the means of splats to the unit cube of the hash grid, and propagates gradients back.
 * Compiled with -ffp-contract=off, so that every SIMD path gives the same bits. */
#include "device/cpu/cpu.h"
#include "math/contract.h"

enum { CHUNK = 4096 };

struct job {
    const struct spin_scene_transform *transform;
    size_t n, first_row; /* `first_row`: index of the frame's first row in the batch */
    const uint32_t *rows;
    const float *pos_w, *d_x_u;
    float t, *x_u, *d_pos_w;
};

static inline spin_vec3 normalised(const struct spin_scene_transform *transform, const float *p)
{
    return spin_v3(spin_contract_axis(p[0], transform->centre[0], transform->inv_radius),
                   spin_contract_axis(p[1], transform->centre[1], transform->inv_radius),
                   spin_contract_axis(p[2], transform->centre[2], transform->inv_radius));
}

static void contract_task(void *context, size_t first, size_t end)
{
    const struct job *job = context;
    float t = spin_clamp_unit(job->t);
    bool raw = job->transform->raw;

    for (size_t i = first; i < end; i++) {
        spin_vec3 p = normalised(job->transform, job->pos_w + i * 3);
        spin_vec3 u = raw ? p : spin_contract(p);

        job->x_u[i * 4] = u.x;
        job->x_u[i * 4 + 1] = u.y;
        job->x_u[i * 4 + 2] = u.z;
        job->x_u[i * 4 + 3] = t;
    }
}

void SPIN_CPU(contract)(struct spin_device *d, const struct spin_scene_transform *transform,
                        const struct spin_frame_batch *frames, float *x_u)
{
    SPIN_CPU_CLOCK(d, SPIN_OP_CONTRACT);

    for (int f = 0; f < frames->n_frames; f++) {
        const struct spin_frame_of_batch *frame = &frames->frame[f];
        struct job job = {.transform = transform,
                          .n = frame->n,
                          .pos_w = frame->means,
                          .t = frame->t,
                          .x_u = x_u + 4 * frame->first};

        spin_pool_rows(spin_cpu_pool(d), frame->n, CHUNK, contract_task, &job);
    }
}

static void contract_back_task(void *context, size_t first, size_t end)
{
    const struct job *job = context;
    bool raw = job->transform->raw;

    for (size_t i = first; i < end; i++) {
        size_t row = job->rows[i] - job->first_row;
        const float *d_u = job->d_x_u + i * 4;
        float *d_p = job->d_pos_w + row * 3;
        spin_vec3 g = spin_v3(d_u[0], d_u[1], d_u[2]);

        if (!raw)
            g = spin_contract_adj(normalised(job->transform, job->pos_w + row * 3), g);

        d_p[0] += g.x * job->transform->inv_radius;
        d_p[1] += g.y * job->transform->inv_radius;
        d_p[2] += g.z * job->transform->inv_radius;
    }
}

void SPIN_CPU(contract_back)(struct spin_device *d, const struct spin_scene_transform *transform,
                             const struct spin_frame_batch *frames,
                             const struct spin_active *active, const float *d_x_u)
{
    SPIN_CPU_CLOCK(d, SPIN_OP_CONTRACT);

    for (int f = 0; f < frames->n_frames; f++) {
        const struct spin_frame_of_batch *frame = &frames->frame[f];
        size_t first, n = SPIN_CPU(active_of)(active, frame, &first);
        struct job job = {.transform = transform,
                          .n = n,
                          .first_row = frame->first,
                          .rows = active->row + first,
                          .pos_w = frame->means,
                          .d_x_u = d_x_u + 4 * first,
                          .d_pos_w = frame->d_means};

        spin_pool_rows(spin_cpu_pool(d), n, CHUNK, contract_back_task, &job);
    }
}
