/* What the splats of a frame have from their tracks, and gradients back (the layout is in device.h). A track
 * belongs to at most one splat of a frame, so the rows of a frame are independent of each other; frames go one
 * after the other. */
#include "device/cpu/cpu.h"

enum { CHUNK = 1024 };

/* A group is a matrix [n][width]. The first is the place, the others are residual values. */
enum { N_GROUPS = 5 };
static const size_t group_width[N_GROUPS] = {3, 3, 4, 3, 1};

struct job {
    size_t n, n_own, n_tracks, width;
    const uint32_t *track; /* [n] */
    const float *own;      /* [n_own][width] */
    const float *shared;   /* [n_tracks][width] */
    float *to;             /* [n][width], or the tracks' gradient */
    const float *from;     /* [n][width] */
};

static void sum_task(void *context, int task, int worker)
{
    const struct job *job = context;
    size_t w = job->width, first = (size_t)task * CHUNK;
    size_t end = first + CHUNK < job->n ? first + CHUNK : job->n;

    (void)worker;
    for (size_t i = first; i < end; i++) {
        const float *shared =
            job->track[i] < job->n_tracks ? job->shared + w * job->track[i] : NULL;
        const float *own = i < job->n_own ? job->own + w * i : NULL;

        for (size_t c = 0; c < w; c++)
            job->to[w * i + c] = (own ? own[c] : 0) + (shared ? shared[c] : 0);
    }
}

static void back_task(void *context, int task, int worker)
{
    const struct job *job = context;
    size_t w = job->width, first = (size_t)task * CHUNK;
    size_t end = first + CHUNK < job->n ? first + CHUNK : job->n;

    (void)worker;
    for (size_t i = first; i < end; i++)
        if (job->track[i] < job->n_tracks)
            for (size_t c = 0; c < w; c++)
                job->to[w * job->track[i] + c] += job->from[w * i + c];
}

static int n_chunks(size_t n) { return (int)((n + CHUNK - 1) / CHUNK); }

void SPIN_CPU(tracks)(struct spin_device *d, const struct spin_frame_batch *frames,
                      const struct spin_tracks_f32 *tracks, float *means, float *residual)
{
    double start = spin_now_s();

    for (int f = 0; f < frames->n_frames; f++) {
        const struct spin_frame_of_batch *frame = &frames->frame[f];
        struct job job = {.n = frame->n, .n_tracks = tracks->n, .track = frame->track};
        const float *own = frame->own_residual, *shared = tracks->values;
        float *to = residual + SPIN_RESIDUAL * frame->first;

        for (int k = 0; k < N_GROUPS; k++) {
            job.width = group_width[k];
            job.shared = shared;
            job.n_own = k == 0 ? frame->n_own_means : frame->n_own_residual;
            job.own = k == 0 ? frame->own_means : own;
            job.to = k == 0 ? means + 3 * frame->first : to;
            spin_pool_run(spin_cpu_pool(d), n_chunks(job.n), sum_task, &job);
            shared += group_width[k] * tracks->n;
            if (k == 0)
                continue;
            own += group_width[k] * frame->n_own_residual;
            to += group_width[k] * frame->n;
        }
    }
    spin_cpu_spent(d, SPIN_OP_ACTIVATE, start);
}

void SPIN_CPU(tracks_back)(struct spin_device *d, const struct spin_frame_batch *frames,
                           const struct spin_tracks_f32 *tracks)
{
    double start = spin_now_s();

    for (int f = 0; f < frames->n_frames; f++) {
        const struct spin_frame_of_batch *frame = &frames->frame[f];
        struct job job = {.n = frame->n, .n_tracks = tracks->n, .track = frame->track};
        const float *from = frame->d_residual;
        float *to = tracks->d_values;

        for (int k = 0; k < (from ? N_GROUPS : 1); k++) {
            job.width = group_width[k];
            job.from = k == 0 ? frame->d_means : from;
            job.to = to;
            spin_pool_run(spin_cpu_pool(d), n_chunks(job.n), back_task, &job);
            to += group_width[k] * tracks->n;
            from += k == 0 ? 0 : group_width[k] * frame->n;
        }
    }
    spin_cpu_spent(d, SPIN_OP_ACTIVATE_BACK, start);
}
