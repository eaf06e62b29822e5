/* Adds the residual values of splats to rows of raw attributes, and propagates gradients back.
 * device.h describes the layout of residual values. */
#include "device/cpu/cpu.h"

enum { CHUNK = 1024 };

struct job {
    size_t n, n_rows, width, sh_width; /* `width`: number of floats in a row of attributes */
    const uint32_t *rows;              /* [n_rows] indices of rows in the batch */
    size_t first_row;                  /* index of the frame's first row in the batch */
    const float *from, *sh;
    float *to, *d_sh;
};

static inline void copy_values(float *to, const float *from, size_t n, bool add)
{
    for (size_t c = 0; c < n; c++)
        to[c] = add ? to[c] + from[c] : from[c];
}

/* Adds the residual values of each splat to its row of attributes, or copies them if `add` is
 * false. The values are stored in groups [n][3], [n][4], [n][3] and [n][1]; SH coefficients beyond
 * the first are in a separate array. The opacity is the last column of a row. */
static inline void to_rows(const struct job *job, size_t first, size_t end, bool add)
{
    for (size_t i = first; i < end; i++) {
        float *to = job->to + i * job->width;

        copy_values(to + SPIN_ATTR_SCALE, job->from + 3 * i, 3, add);
        copy_values(to + SPIN_ATTR_ROTATION, job->from + 3 * job->n + 4 * i, 4, add);
        copy_values(to + SPIN_ATTR_SH, job->from + 7 * job->n + 3 * i, 3, add);
        copy_values(to + job->width - 1, job->from + 10 * job->n + i, 1, add);
        if (job->sh)
            copy_values(to + SPIN_ATTR_SH + 3, job->sh + i * job->sh_width, job->sh_width, add);
    }
}

static void add_rows(void *context, size_t first, size_t end)
{
    to_rows(context, first, end, true);
}

static void set_rows(void *context, size_t first, size_t end)
{
    to_rows(context, first, end, false);
}

static void all_to_rows(struct spin_device *d, const struct spin_frame_batch *frames, float *raw,
                        spin_rows_fn fn)
{
    SPIN_CPU_CLOCK(d, SPIN_OP_ACTIVATE);

    for (int f = 0; f < frames->n_frames; f++) {
        const struct spin_frame_of_batch *frame = &frames->frame[f];
        struct job job = {.n = frame->n,
                          .width = spin_attr_width(frames),
                          .sh_width = frame->sh_width,
                          .from = frame->residual,
                          .sh = frame->sh,
                          .to = raw + frame->first * spin_attr_width(frames)};

        if (frame->residual)
            spin_pool_rows(spin_cpu_pool(d), job.n, CHUNK, fn, &job);
    }
}

void SPIN_CPU(residual)(struct spin_device *d, const struct spin_frame_batch *frames, float *raw)
{
    all_to_rows(d, frames, raw, add_rows);
}

void SPIN_CPU(residual_set)(struct spin_device *d, const struct spin_frame_batch *frames,
                            float *raw)
{
    all_to_rows(d, frames, raw, set_rows);
}

static void back_rows(void *context, size_t first, size_t end)
{
    const struct job *job = context;

    for (size_t i = first; i < end; i++) {
        const float *from = job->from + i * job->width;
        size_t row = job->rows[i] - job->first_row;

        copy_values(job->to + 3 * row, from + SPIN_ATTR_SCALE, 3, true);
        copy_values(job->to + 3 * job->n + 4 * row, from + SPIN_ATTR_ROTATION, 4, true);
        copy_values(job->to + 7 * job->n + 3 * row, from + SPIN_ATTR_SH, 3, true);
        copy_values(job->to + 10 * job->n + row, from + job->width - 1, 1, true);
        if (job->d_sh)
            copy_values(job->d_sh + row * job->sh_width, from + SPIN_ATTR_SH + 3, job->sh_width,
                        true);
    }
}

void SPIN_CPU(residual_back)(struct spin_device *d, const struct spin_frame_batch *frames,
                             const struct spin_active *active, const float *d_raw)
{
    SPIN_CPU_CLOCK(d, SPIN_OP_ACTIVATE_BACK);

    for (int f = 0; f < frames->n_frames; f++) {
        const struct spin_frame_of_batch *frame = &frames->frame[f];
        size_t first, n_rows = SPIN_CPU(active_of)(active, frame, &first);
        struct job job = {.n = frame->n,
                          .n_rows = n_rows,
                          .width = spin_attr_width(frames),
                          .sh_width = frame->sh_width,
                          .rows = active->row + first,
                          .first_row = frame->first,
                          .from = d_raw + first * spin_attr_width(frames),
                          .to = frame->d_residual,
                          .d_sh = frame->d_sh};

        if (frame->d_residual)
            spin_pool_rows(spin_cpu_pool(d), n_rows, CHUNK, back_rows, &job);
    }
}
