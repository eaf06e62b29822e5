/* Explicit values of every splat to rows of raw attributes, and gradients back (the layout is in device.h). */
#include "device/cpu/cpu.h"

enum { CHUNK = 1024 };

struct job {
    size_t n, n_rows, width, sh_width; /* width of a row of attributes */
    const uint32_t *rows;              /* [n_rows], of the batch */
    size_t first_row;                  /* of the frame */
    const float *from, *sh;
    float *to, *d_sh;
};

/* A group is a matrix [n][width]; in a row of attributes it begins at this column. */
enum { N_GROUPS = 4 };
static const struct group {
    size_t width, column;
} groups[N_GROUPS] = {
    {3, SPIN_ATTR_SCALE}, {4, SPIN_ATTR_ROTATION}, {3, SPIN_ATTR_SH}, {1, SPIN_ATTR_OPACITY}};

/* The opacity stands last. */
static struct group group_of(const struct job *job, int k)
{
    return k < N_GROUPS - 1 ? groups[k] : (struct group){1, job->width - 1};
}

/* SH beyond the first coefficient: a group with a place of its own. */
static struct group group_of_sh(size_t width) { return (struct group){width, SPIN_ATTR_SH + 3}; }

static inline void group_to_rows(const struct job *job, size_t first, size_t end,
                                 struct group group, const float *from, bool add)
{
    for (size_t i = first; i < end; i++) {
        float *restrict to = job->to + i * job->width + group.column;
        const float *restrict own = from + i * group.width;

        for (size_t c = 0; c < group.width; c++)
            to[c] = add ? to[c] + own[c] : own[c];
    }
}

static inline void to_rows(const struct job *job, size_t first, size_t end, bool add)
{
    const float *from = job->from;

    for (int k = 0; k < N_GROUPS; from += groups[k++].width * job->n)
        group_to_rows(job, first, end, group_of(job, k), from, add);
    if (job->sh)
        group_to_rows(job, first, end, group_of_sh(job->sh_width), job->sh, add);
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

static void group_back(const struct job *job, size_t first, size_t end, struct group group,
                       float *to)
{
    for (size_t i = first; i < end; i++) {
        float *restrict own = to + (job->rows[i] - job->first_row) * group.width;
        const float *restrict from = job->from + i * job->width + group.column;

        for (size_t c = 0; c < group.width; c++)
            own[c] += from[c];
    }
}

static void back_rows(void *context, size_t first, size_t end)
{
    const struct job *job = context;
    float *to = job->to;

    for (int k = 0; k < N_GROUPS; to += groups[k++].width * job->n)
        group_back(job, first, end, group_of(job, k), to);
    if (job->d_sh)
        group_back(job, first, end, group_of_sh(job->sh_width), job->d_sh);
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
