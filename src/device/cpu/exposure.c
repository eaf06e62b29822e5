/* Applies the gain and offset of a camera and the falloff of its lens to an image, and propagates
 * gradients back. The gradients of the parameters are sums over the pixels, which are added in
 * double, first within each chunk and then over the chunks in order. */
#include <math.h>

#include "device/cpu/cpu.h"
#include "math/exposure.h"

/* ROWS: number of rows in a chunk, which belongs to one channel; SUMS: number of sums per chunk */
enum { ROWS = 8, SUMS = 4 };

struct job {
    int width, height, n_chunks; /* `n_chunks`: number of chunks per channel */
    float cx, cy;
    const float *exposure, *lens, *image;
    /* forward: the image with exposure applied; backward: d_image, which is updated in place */
    float *out;
    double *sums; /* [3][n_chunks][SUMS] */
};

/* One chunk: a channel and a range of rows. */
struct part {
    int channel, first, last;
    size_t at; /* offset of the channel in the image */
    float gain, offset, c1, c2;
};

static struct part part_of(const struct job *j, int task)
{
    int channel = task / j->n_chunks, first = task % j->n_chunks * ROWS;

    return (struct part){.channel = channel,
                         .first = first,
                         .last = first + ROWS < j->height ? first + ROWS : j->height,
                         .at = (size_t)channel * (size_t)j->width * (size_t)j->height,
                         .gain = expf(j->exposure[channel]),
                         .offset = j->exposure[3 + channel],
                         .c1 = j->lens[channel],
                         .c2 = j->lens[3 + channel]};
}

static void forward_task(void *context, int task)
{
    const struct job *j = context;
    struct part p = part_of(j, task);
    float half = 0.5f * (float)j->width;

    for (int y = p.first; y < p.last; y++) {
        const float *image = j->image + p.at + (size_t)y * (size_t)j->width;
        float *out = j->out + p.at + (size_t)y * (size_t)j->width;

        for (int x = 0; x < j->width; x++) {
            float r2 = spin_lens_r2(x, y, j->cx, j->cy, half);

            out[x] = spin_exposure(p.gain * spin_falloff(p.c1, p.c2, r2), p.offset, image[x]);
        }
    }
}

static void backward_task(void *context, int task)
{
    const struct job *j = context;
    struct part p = part_of(j, task);
    float half = 0.5f * (float)j->width;
    double sum[SUMS] = {0};

    for (int y = p.first; y < p.last; y++) {
        const float *image = j->image + p.at + (size_t)y * (size_t)j->width;
        float *d = j->out + p.at + (size_t)y * (size_t)j->width;

        for (int x = 0; x < j->width; x++) {
            float r2 = spin_lens_r2(x, y, j->cx, j->cy, half);
            struct spin_exposure_slopes s;

            d[x] = spin_exposure_adj(p.gain, spin_falloff(p.c1, p.c2, r2), p.offset, r2, image[x],
                                     d[x], &s);
            sum[0] += (double)s.m;
            sum[1] += (double)s.offset;
            sum[2] += (double)s.c1;
            sum[3] += (double)s.c2;
        }
    }
    for (int k = 0; k < SUMS; k++)
        j->sums[task * SUMS + k] = sum[k];
}

static struct job job_of(const struct spin_view_batch *views, int k, const float *exposure,
                         const float *image, float *out)
{
    const struct spin_view_of_batch *view = &views->view[k];
    size_t at = (size_t)k * 3 * views->max_pixels;

    return (struct job){.width = view->camera.width,
                        .height = view->camera.height,
                        .n_chunks = (view->camera.height + ROWS - 1) / ROWS,
                        .cx = view->camera.cx,
                        .cy = view->camera.cy,
                        .exposure = exposure + (size_t)view->exposure * SPIN_EXPOSURE,
                        .lens = exposure + (size_t)view->lens * SPIN_EXPOSURE,
                        .image = image + at,
                        .out = out + at};
}

void SPIN_CPU(exposure)(struct spin_device *d, const struct spin_view_batch *views,
                        const float *exposure, const float *image, float *out)
{
    SPIN_CPU_CLOCK(d, SPIN_OP_LOSS);

    for (int k = 0; k < views->n_views; k++) {
        struct job j = job_of(views, k, exposure, image, out);

        spin_pool_run(spin_cpu_pool(d), 3 * j.n_chunks, forward_task, &j);
    }
}

/* Adds the sums of all chunks, in order, to the gradients of camera and lens. */
static void add_sums(const struct job *j, float *d_exposure, float *d_lens)
{
    float *const to[SUMS] = {d_exposure, d_exposure + 3, d_lens, d_lens + 3};

    for (int channel = 0; channel < 3; channel++)
        for (int s = 0; s < SUMS; s++) {
            double sum = 0;

            for (int k = 0; k < j->n_chunks; k++)
                sum += j->sums[(channel * j->n_chunks + k) * SUMS + s];
            to[s][channel] += (float)sum;
        }
}

void SPIN_CPU(exposure_back)(struct spin_device *d, const struct spin_view_batch *views,
                             const float *exposure, const float *image, float *d_image,
                             float *d_exposure)
{
    SPIN_CPU_CLOCK(d, SPIN_OP_LOSS);

    for (int k = 0; k < views->n_views; k++) {
        const struct spin_view_of_batch *view = &views->view[k];
        struct job j = job_of(views, k, exposure, image, d_image);

        j.sums = spin_cpu_scratch_need(d, SPIN_SCRATCH_LOSS,
                                       3 * (size_t)j.n_chunks * SUMS * sizeof(double));
        if (!j.sums)
            return;
        spin_pool_run(spin_cpu_pool(d), 3 * j.n_chunks, backward_task, &j);
        add_sums(&j, d_exposure + (size_t)view->exposure * SPIN_EXPOSURE,
                 d_exposure + (size_t)view->lens * SPIN_EXPOSURE);
    }
}

void SPIN_CPU(exposure_centre)(struct spin_device *d, size_t n, float *exposure)
{
    SPIN_CPU_CLOCK(d, SPIN_OP_ADAM);

    for (size_t k = 0; k < SPIN_EXPOSURE; k++) {
        double mean = 0;

        for (size_t i = 0; i < n; i++)
            mean += (double)exposure[SPIN_EXPOSURE * i + k] / (double)n;
        for (size_t i = 0; i < n; i++)
            exposure[SPIN_EXPOSURE * i + k] -= (float)mean;
    }
}
