/* A camera's gain and offset over a picture, and back. Sums go chunk by chunk in double. */
#include <math.h>

#include "device/cpu/cpu.h"
#include "math/exposure.h"

enum { CHUNK = 4096, SUMS = 2 };

struct job {
    size_t n_pixels;
    size_t n_chunks; /* of one channel */
    const float *exposure, *image;
    float *out;   /* with the exposure, or d_image in place */
    double *sums; /* [3][n_chunks][SUMS] */
};

static void forward(void *context, int task, int worker)
{
    const struct job *j = context;
    size_t channel = (size_t)task / j->n_chunks, first = (size_t)task % j->n_chunks * CHUNK;
    size_t last = first + CHUNK < j->n_pixels ? first + CHUNK : j->n_pixels;
    const float *image = j->image + channel * j->n_pixels;
    float *out = j->out + channel * j->n_pixels;
    float gain = expf(j->exposure[channel]), offset = j->exposure[3 + channel];

    (void)worker;
    for (size_t i = first; i < last; i++)
        out[i] = spin_exposure(gain, offset, image[i]);
}

static void backward(void *context, int task, int worker)
{
    const struct job *j = context;
    size_t channel = (size_t)task / j->n_chunks, first = (size_t)task % j->n_chunks * CHUNK;
    size_t last = first + CHUNK < j->n_pixels ? first + CHUNK : j->n_pixels;
    const float *image = j->image + channel * j->n_pixels;
    float *d = j->out + channel * j->n_pixels;
    float gain = expf(j->exposure[channel]);
    double sum_m = 0, sum_c = 0;

    (void)worker;
    for (size_t i = first; i < last; i++) {
        float d_m, d_c;

        d[i] = spin_exposure_adj(gain, image[i], d[i], &d_m, &d_c);
        sum_m += (double)d_m;
        sum_c += (double)d_c;
    }
    j->sums[(size_t)task * SUMS] = sum_m;
    j->sums[(size_t)task * SUMS + 1] = sum_c;
}

static struct job job_of(const struct spin_view_batch *views, int k, const float *exposure,
                         const float *image, float *out)
{
    const struct spin_view_of_batch *view = &views->view[k];
    size_t n = (size_t)view->camera.width * (size_t)view->camera.height;
    size_t at = (size_t)k * 3 * views->max_pixels;

    return (struct job){.n_pixels = n,
                        .n_chunks = (n + CHUNK - 1) / CHUNK,
                        .exposure = exposure + (size_t)view->exposure * SPIN_EXPOSURE,
                        .image = image + at,
                        .out = out + at};
}

void SPIN_CPU(exposure)(struct spin_device *d, const struct spin_view_batch *views,
                        const float *exposure, const float *image, float *out)
{
    double start = spin_now_s();

    for (int k = 0; k < views->n_views; k++) {
        struct job j = job_of(views, k, exposure, image, out);

        spin_pool_run(spin_cpu_pool(d), (int)(3 * j.n_chunks), forward, &j);
    }
    spin_cpu_spent(d, SPIN_OP_LOSS, start);
}

/* The sums of the chunks, in order. */
static void add_sums(const struct job *j, float *d_exposure)
{
    for (size_t channel = 0; channel < 3; channel++) {
        double sum[SUMS] = {0, 0};

        for (size_t k = 0; k < j->n_chunks; k++)
            for (size_t s = 0; s < SUMS; s++)
                sum[s] += j->sums[(channel * j->n_chunks + k) * SUMS + s];
        d_exposure[channel] += (float)sum[0];
        d_exposure[3 + channel] += (float)sum[1];
    }
}

void SPIN_CPU(exposure_back)(struct spin_device *d, const struct spin_view_batch *views,
                             const float *exposure, const float *image, float *d_image,
                             float *d_exposure)
{
    double start = spin_now_s();

    for (int k = 0; k < views->n_views; k++) {
        struct job j = job_of(views, k, exposure, image, d_image);

        j.sums =
            spin_cpu_scratch_need(d, SPIN_SCRATCH_LOSS, 3 * j.n_chunks * SUMS * sizeof(double));
        if (!j.sums)
            return;
        spin_pool_run(spin_cpu_pool(d), (int)(3 * j.n_chunks), backward, &j);
        add_sums(&j, d_exposure + (size_t)views->view[k].exposure * SPIN_EXPOSURE);
    }
    spin_cpu_spent(d, SPIN_OP_LOSS, start);
}

void SPIN_CPU(exposure_centre)(struct spin_device *d, size_t n, float *exposure)
{
    double start = spin_now_s();

    for (size_t k = 0; k < SPIN_EXPOSURE; k++) {
        double mean = 0;

        for (size_t i = 0; i < n; i++)
            mean += (double)exposure[SPIN_EXPOSURE * i + k] / (double)n;
        for (size_t i = 0; i < n; i++)
            exposure[SPIN_EXPOSURE * i + k] -= (float)mean;
    }
    spin_cpu_spent(d, SPIN_OP_ADAM, start);
}
