/* A camera's gain and offset over a picture, and back. Sums go chunk by chunk in double. */
#include <math.h>

#include "device/cpu/cpu.h"
#include "math/exposure.h"

enum { CHUNK = 4096, SUMS = 2 };

struct job {
    size_t n_pixels;
    size_t n_chunks; /* of one channel */
    const float *exposure, *image;
    float *out;   /* tinted, or d_image in place */
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

void SPIN_CPU(exposure)(struct spin_device *d, size_t n_pixels, const float *exposure,
                        const float *image, float *out)
{
    struct job j = {n_pixels, (n_pixels + CHUNK - 1) / CHUNK, exposure, image, out, NULL};

    spin_pool_run(spin_cpu_pool(d), (int)(3 * j.n_chunks), forward, &j);
}

void SPIN_CPU(exposure_back)(struct spin_device *d, size_t n_pixels, const float *exposure,
                             const float *image, float *d_image, float *d_exposure)
{
    struct job j = {n_pixels, (n_pixels + CHUNK - 1) / CHUNK, exposure, image, d_image, NULL};

    j.sums = spin_cpu_scratch_need(d, SPIN_SCRATCH_LOSS, 3 * j.n_chunks * SUMS * sizeof(double));
    if (!j.sums)
        return;
    spin_pool_run(spin_cpu_pool(d), (int)(3 * j.n_chunks), backward, &j);
    for (size_t channel = 0; channel < 3; channel++) {
        double sum[SUMS] = {0, 0};

        for (size_t k = 0; k < j.n_chunks; k++)
            for (size_t s = 0; s < SUMS; s++)
                sum[s] += j.sums[(channel * j.n_chunks + k) * SUMS + s];
        d_exposure[channel] += (float)sum[0];
        d_exposure[3 + channel] += (float)sum[1];
    }
}
