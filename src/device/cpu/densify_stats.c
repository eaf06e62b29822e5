/* Updates the statistics for densification: for each splat, adds up the length of the gradient of
 * the loss with respect to the splat's screen position. Compiled with -ffp-contract=off, so that
 * every SIMD path gives the same bits. */
#include <math.h>

#include "device/cpu/cpu.h"

enum { CHUNK = 4096 };

struct job {
    size_t n;
    bool absolute;
    float half_width, half_height;
    const struct spin_splat2d *splat2d;
    const struct spin_splat2d_grad *d_splat2d;
    float *sum;
    uint32_t *seen;
};

/* Converts gradients from pixel coordinates u to normalised device coordinates x, where u = ((x +
 * 1) width - 1) / 2, and adds their lengths. */
static void stats_task(void *context, size_t first, size_t end)
{
    const struct job *job = context;

    for (size_t i = first; i < end; i++) {
        const struct spin_splat2d_grad *d = &job->d_splat2d[i];
        float x = job->half_width * (job->absolute ? d->absolute_u_px : d->u_px);
        float y = job->half_height * (job->absolute ? d->absolute_v_px : d->v_px);

        if (job->splat2d[i].radius_px <= 0)
            continue;
        job->sum[i] += sqrtf(x * x + y * y);
        job->seen[i]++;
    }
}

void SPIN_CPU(densify_stats)(struct spin_device *d, const struct spin_view_batch *views,
                             const struct spin_frame_batch *frames,
                             const struct spin_splat2d *splat2d,
                             const struct spin_splat2d_grad *d_splat2d)
{
    SPIN_CPU_CLOCK(d, SPIN_OP_PROJECT_BACK);

    for (int k = 0; k < views->n_views; k++) {
        const struct spin_view_of_batch *view = &views->view[k];
        const struct spin_frame_of_batch *frame = &frames->frame[view->frame];
        struct job job = {.n = view->n,
                          .absolute = views->absolute,
                          .half_width = 0.5f * (float)view->camera.width,
                          .half_height = 0.5f * (float)view->camera.height,
                          .splat2d = splat2d + view->first,
                          .d_splat2d = d_splat2d + view->first,
                          .sum = frame->gradient,
                          .seen = frame->seen};

        if (frame->gradient)
            spin_pool_rows(spin_cpu_pool(d), job.n, CHUNK, stats_task, &job);
    }
}
