/* Adds the values of tracks to the splats of a frame, and propagates gradients back. device.h
 * describes the layout of these values. A track belongs to at most one splat of a frame, so the
 * splats of a frame are processed independently. Frames are processed one after the other. */
#include "device/cpu/cpu.h"
#include "math/motion.h"
#include "math/quat.h"

enum { CHUNK = 1024 };

/* Values are stored in groups, each a matrix [n][width]: position, log scale, rotation, colour,
 * opacity. */
enum { PLACE, ROTATION = 2, OPACITY = 4, N_GROUPS };
static const size_t group_width[N_GROUPS] = {3, 3, 4, 3, 1};

struct job {
    size_t n, n_own, n_tracks, width;
    const uint32_t *track; /* [n] */
    const float *own;      /* [n_own][width] */
    const float *shared;   /* [n_tracks][width] */
    /* forward: values of the splats [n][width]; backward: gradient of the tracks */
    float *to;
    const float *from; /* backward: gradient of the splats [n][width] */
    /* [n_tracks][SPIN_MOTION] motion of the tracks; NULL if it does not affect this group */
    const float *motion;
    const float *turn; /* [n_turns][4], used if rotations affect this group */
    size_t n_turns;
    float t;
    int group;
};

/* Returns the job for one group of values of a frame. The motion of tracks affects position and
 * opacity only; rotations by `turn` affect position and rotation only. */
static struct job job_of(const struct spin_frame_of_batch *frame,
                         const struct spin_tracks_f32 *tracks, int group, const float *shared)
{
    bool turned = frame->turn && (group == PLACE || group == ROTATION);

    return (struct job){.n = frame->n,
                        .n_tracks = tracks->n,
                        .width = group_width[group],
                        .track = frame->track,
                        .shared = shared,
                        .motion = group == PLACE || group == OPACITY ? tracks->motion : NULL,
                        .turn = frame->turn,
                        .n_turns = turned ? frame->n_own_means : 0,
                        .t = frame->t,
                        .group = group};
}

/* Applies the motion of a splat's track to a value of the splat: moves the position by the
 * displacement at the frame's time, or reduces the opacity by the Gaussian window. */
static void apply_motion(const struct job *job, const float *motion, float *value)
{
    float d = job->t - motion[3], x = d * motion[4];

    if (job->group == OPACITY)
        *value = spin_windowed_logit(*value, -0.5f * x * x);
    else
        for (int c = 0; c < 3; c++)
            value[c] += d * motion[c];
}

static inline void sum_rows(const struct job *job, size_t w, size_t first, size_t end)
{
    for (size_t i = first; i < end; i++) {
        const float *shared =
            job->track[i] < job->n_tracks ? job->shared + w * job->track[i] : NULL;
        const float *own = i < job->n_own ? job->own + w * i : NULL;
        float turned[4];

        if (shared && i < job->n_turns) {
            spin_turn(job->turn + 4 * i, (int)w, shared, turned);
            shared = turned;
        }
        for (size_t c = 0; c < w; c++)
            job->to[w * i + c] = (own ? own[c] : 0) + (shared ? shared[c] : 0);
        if (job->motion && shared)
            apply_motion(job, job->motion + SPIN_MOTION * (size_t)job->track[i], job->to + w * i);
    }
}

/* Calls `rows` with a constant width, so that the compiler unrolls the loops. With rotations, the
 * sums of unrolled loops would be rounded differently from the published results, so a frame with
 * rotations uses the function `rows`_any, whose loops are not unrolled. */
#define OF_WIDTH(rows, job, first, end)                                                            \
    ((job)->n_turns > 0  ? rows##_any(job, first, end)                                             \
     : (job)->width == 3 ? rows(job, 3, first, end)                                                \
     : (job)->width == 4 ? rows(job, 4, first, end)                                                \
                         : rows(job, 1, first, end))

static __attribute__((noinline)) void sum_rows_any(const struct job *job, size_t first, size_t end)
{
    sum_rows(job, job->width, first, end);
}

static void sum_task(void *context, size_t first, size_t end)
{
    const struct job *job = context;

    OF_WIDTH(sum_rows, job, first, end);
}

static inline void back_rows(const struct job *job, size_t w, size_t first, size_t end)
{
    for (size_t i = first; i < end; i++) {
        const float *m = job->motion ? job->motion + SPIN_MOTION * (size_t)job->track[i] : NULL;
        const float *from = job->from + w * i;
        float slope = 1, turned[4];

        if (job->track[i] >= job->n_tracks)
            continue;
        if (m && job->group == OPACITY)
            slope = spin_windowed_logit_adj(job->shared[job->track[i]],
                                            -0.5f * powf((job->t - m[3]) * m[4], 2));
        if (i < job->n_turns) {
            spin_turn_adj(job->turn + 4 * i, (int)w, from, turned);
            from = turned;
        }
        for (size_t c = 0; c < w; c++)
            job->to[w * job->track[i] + c] += slope * from[c];
    }
}

static __attribute__((noinline)) void back_rows_any(const struct job *job, size_t first, size_t end)
{
    back_rows(job, job->width, first, end);
}

static void back_task(void *context, size_t first, size_t end)
{
    const struct job *job = context;

    OF_WIDTH(back_rows, job, first, end);
}

void SPIN_CPU(tracks)(struct spin_device *d, const struct spin_frame_batch *frames,
                      const struct spin_tracks_f32 *tracks, float *means, float *residual)
{
    SPIN_CPU_CLOCK(d, SPIN_OP_ACTIVATE);

    for (int f = 0; f < frames->n_frames; f++) {
        const struct spin_frame_of_batch *frame = &frames->frame[f];
        const float *own = frame->own_residual, *shared = tracks->values;
        float *to = residual + SPIN_RESIDUAL * frame->first;

        for (int k = 0; k < N_GROUPS; k++) {
            struct job job = job_of(frame, tracks, k, shared);

            job.n_own = k == PLACE ? frame->n_own_means : frame->n_own_residual;
            job.own = k == PLACE ? frame->own_means : own;
            job.to = k == PLACE ? means + 3 * frame->first : to;
            spin_pool_rows(spin_cpu_pool(d), job.n, CHUNK, sum_task, &job);
            shared += group_width[k] * tracks->n;
            if (k == PLACE)
                continue;
            own += group_width[k] * frame->n_own_residual;
            to += group_width[k] * frame->n;
        }
    }
}

void SPIN_CPU(tracks_back)(struct spin_device *d, const struct spin_frame_batch *frames,
                           const struct spin_tracks_f32 *tracks)
{
    SPIN_CPU_CLOCK(d, SPIN_OP_ACTIVATE_BACK);

    for (int f = 0; f < frames->n_frames; f++) {
        const struct spin_frame_of_batch *frame = &frames->frame[f];
        const float *from = frame->d_residual;
        float *to = tracks->d_values;

        for (int k = 0; k < (from ? N_GROUPS : 1); k++) {
            struct job job = job_of(frame, tracks, k, tracks->values + (to - tracks->d_values));

            job.from = k == PLACE ? frame->d_means : from;
            job.to = to;
            spin_pool_rows(spin_cpu_pool(d), job.n, CHUNK, back_task, &job);
            to += group_width[k] * tracks->n;
            from += k == PLACE ? 0 : group_width[k] * frame->n;
        }
    }
}
