/* Adds residual values to rows of raw attributes, and the values of tracks to those of splats, and
 * propagates gradients back. device.h describes the layouts. A track belongs to at most one splat
 * of a frame, so the splats of a frame are processed independently. Frames are processed one after
 * the other. */
#include "device/cuda/cuda.h"
#include "math/motion.h"
#include "math/quat.h"

/* A group of residual values is a matrix [n][width] that starts at `column` of a row of
 * attributes. */
struct group {
    size_t width, column;
};
static const int n_groups = 4;
static const struct group groups[n_groups] = {
    {3, SPIN_ATTR_SCALE}, {4, SPIN_ATTR_ROTATION}, {3, SPIN_ATTR_SH}, {1, SPIN_ATTR_OPACITY}};

/* Returns the group of the SH coefficients beyond the first, which are in a separate array. */
static struct group group_of_sh(size_t width) { return {width, SPIN_ATTR_SH + 3}; }

/* Adds the values of one group to rows of raw attributes, or copies them if `add` is false, with
 * one thread per value. */
static __global__ void to_rows_kernel(struct group group, size_t n, bool add, const float *from,
                                      float *raw)
{
    size_t i = GPU_INDEX();
    float *to = raw + i / group.width * SPIN_ATTR + group.column + i % group.width;

    if (i < n * group.width)
        *to = add ? *to + from[i] : from[i];
}

static void to_rows(struct spin_device *d, const struct spin_frame_batch *frames, bool add,
                    float *raw)
{
    cuda_clocked clocked(d, SPIN_OP_ACTIVATE);
    for (int f = 0; f < frames->n_frames; f++) {
        const auto *frame = &frames->frame[f];
        const float *from = frame->residual;

        for (int k = 0; from && k < n_groups; from += groups[k++].width * frame->n)
            GPU_EACH(gpu_of(d), groups[k].width * frame->n, to_rows_kernel, groups[k], frame->n,
                     add, from, raw + frame->first * SPIN_ATTR);
        if (frame->residual && frame->sh)
            GPU_EACH(gpu_of(d), frame->sh_width * frame->n, to_rows_kernel,
                     group_of_sh(frame->sh_width), frame->n, add, frame->sh,
                     raw + frame->first * SPIN_ATTR);
    }
}

void cuda_residual(struct spin_device *d, const struct spin_frame_batch *frames, float *raw)
{
    to_rows(d, frames, true, raw);
}

void cuda_residual_set(struct spin_device *d, const struct spin_frame_batch *frames, float *raw)
{
    to_rows(d, frames, false, raw);
}

static __global__ void from_rows_kernel(struct group group, struct cuda_rows rows,
                                        const float *d_raw, float *to)
{
    size_t i = GPU_INDEX(), row;

    if (!cuda_row(rows, i, &row))
        return;
    for (size_t c = 0; c < group.width; c++)
        to[row * group.width + c] += d_raw[i * SPIN_ATTR + group.column + c];
}

void cuda_residual_back(struct spin_device *d, const struct spin_frame_batch *frames,
                        const struct spin_active *active, const float *d_raw)
{
    cuda_clocked clocked(d, SPIN_OP_ACTIVATE_BACK);
    for (int f = 0; f < frames->n_frames; f++) {
        const auto *frame = &frames->frame[f];
        float *to = frame->d_residual;

        for (int k = 0; to && k < n_groups; to += groups[k++].width * frame->n)
            GPU_EACH(gpu_of(d), active->most, from_rows_kernel, groups[k],
                     cuda_rows_of(active, frame->first, frame->n), d_raw, to);
        if (frame->d_residual && frame->d_sh)
            GPU_EACH(gpu_of(d), active->most, from_rows_kernel, group_of_sh(frame->sh_width),
                     cuda_rows_of(active, frame->first, frame->n), d_raw, frame->d_sh);
    }
}

/* ---- Tracks ---------------------------------------------------------------------------------- */

/* The groups of a track: position, then the groups of residual values. */
static const int track_place = 0, track_rotation = 2, track_opacity = 4, n_track_groups = 5;
static const size_t track_width[n_track_groups] = {3, 3, 4, 3, 1};

struct track_job {
    size_t n, n_own, n_tracks, width;
    const uint32_t *track; /* [n] */
    const float *own;      /* [n_own][width] */
    const float *shared;   /* [n_tracks][width] */
    const float *motion;   /* motion of the tracks if it affects this group, else NULL */
    const float *turn;     /* [n_turns][4], used if rotations affect this group */
    size_t n_turns;
    float t;
};

/* Returns the logarithm of a track's Gaussian window at the frame's time. */
static __device__ float seen_of(const struct track_job *job, const float *motion)
{
    float x = (job->t - motion[3]) * motion[4];

    return -0.5f * x * x;
}

/* Returns turned[c]. Indexing the array by a variable would move it to local memory. */
static __device__ float pick(const float turned[4], size_t c)
{
    return c == 0 ? turned[0] : c == 1 ? turned[1] : c == 2 ? turned[2] : turned[3];
}

static __global__ void tracks_kernel(struct track_job job, float *to)
{
    size_t at = GPU_INDEX(), i = at / job.width, c = at % job.width, track;
    float value;

    if (i >= job.n)
        return;
    track = job.track[i];
    value = i < job.n_own ? job.own[at] : 0;
    if (track < job.n_tracks) {
        const float *m = job.motion ? job.motion + SPIN_MOTION * track : NULL;
        const float *shared = job.shared + job.width * track;
        float turned[4] = {0};

        if (i < job.n_turns) {
            spin_turn(job.turn + 4 * i, (int)job.width, shared, turned);
            value += pick(turned, c);
        } else {
            value += shared[c];
        }
        if (m)
            value = job.width == 1 ? spin_windowed_logit(value, seen_of(&job, m))
                                   : value + (job.t - m[3]) * m[c];
    }
    to[at] = value;
}

/* Returns the job for one group of values of a frame. The motion of tracks affects position and
 * opacity only; rotations by `turn` affect position and rotation only. */
static struct track_job job_of(const struct spin_frame_batch::spin_frame_of_batch *frame,
                               const struct spin_tracks_f32 *tracks, int k, const float *shared)
{
    struct track_job job = {frame->n,     0,    tracks->n, track_width[k],
                            frame->track, NULL, shared,    NULL,
                            frame->turn,  0,    0};

    if (k == track_place || k == track_opacity)
        job.motion = tracks->motion;
    if (frame->turn && (k == track_place || k == track_rotation))
        job.n_turns = frame->n_own_means;
    job.t = frame->t;
    return job;
}

void cuda_tracks(struct spin_device *d, const struct spin_frame_batch *frames,
                 const struct spin_tracks_f32 *tracks, float *means, float *residual)
{
    cuda_clocked clocked(d, SPIN_OP_ACTIVATE);
    for (int f = 0; f < frames->n_frames; f++) {
        const auto *frame = &frames->frame[f];
        const float *own = frame->own_residual, *shared = tracks->values;
        float *to = residual + SPIN_RESIDUAL * frame->first;

        for (int k = 0; k < n_track_groups; k++) {
            size_t width = track_width[k];
            struct track_job job = job_of(frame, tracks, k, shared);

            job.n_own = k == track_place ? frame->n_own_means : frame->n_own_residual;
            job.own = k == track_place ? frame->own_means : own;
            GPU_EACH(gpu_of(d), width * frame->n, tracks_kernel, job,
                     k == track_place ? means + 3 * frame->first : to);
            shared += width * tracks->n;
            if (k == track_place)
                continue;
            own += width * frame->n_own_residual;
            to += width * frame->n;
        }
    }
}

static __global__ void tracks_back_kernel(struct track_job job, const float *from, float *d_shared)
{
    size_t at = GPU_INDEX(), i = at / job.width, c = at % job.width, track;
    float slope = 1, turned[4] = {0}, g;

    if (i >= job.n || job.track[i] >= job.n_tracks)
        return;
    g = from[at];
    if (i < job.n_turns) {
        spin_turn_adj(job.turn + 4 * i, (int)job.width, from + job.width * i, turned);
        g = pick(turned, c);
    }
    track = job.track[i];
    if (job.motion && job.width == 1)
        slope = spin_windowed_logit_adj(job.shared[track],
                                        seen_of(&job, job.motion + SPIN_MOTION * track));
    d_shared[job.width * track + c] += slope * g;
}

void cuda_tracks_back(struct spin_device *d, const struct spin_frame_batch *frames,
                      const struct spin_tracks_f32 *tracks)
{
    cuda_clocked clocked(d, SPIN_OP_ACTIVATE_BACK);
    for (int f = 0; f < frames->n_frames; f++) {
        const auto *frame = &frames->frame[f];
        const float *from = frame->d_residual;
        float *to = tracks->d_values;

        for (int k = 0; k < (from ? n_track_groups : 1); k++) {
            size_t width = track_width[k];
            struct track_job job =
                job_of(frame, tracks, k, tracks->values + (to - tracks->d_values));

            GPU_EACH(gpu_of(d), width * frame->n, tracks_back_kernel, job,
                     k == track_place ? frame->d_means : from, to);
            to += width * tracks->n;
            from += k == track_place ? 0 : width * frame->n;
        }
    }
}

/* ---- Copying rows ---------------------------------------------------------------------------- */

static __global__ void copy_rows_kernel(size_t n, size_t width, const float *from,
                                        size_t from_stride, float *to, size_t to_stride)
{
    size_t at = GPU_INDEX(), i = at / width, c = at % width;

    if (i < n)
        to[i * to_stride + c] = from[i * from_stride + c];
}

void cuda_copy_rows(struct spin_device *d, size_t n, size_t width, const float *from,
                    size_t from_stride, float *to, size_t to_stride)
{
    cuda_clocked clocked(d, SPIN_OP_CLEAR);
    GPU_EACH(gpu_of(d), n * width, copy_rows_kernel, n, width, from, from_stride, to, to_stride);
}
