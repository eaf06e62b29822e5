/* Camera colours in training. */
#include "train/exposure.h"

#include <stdlib.h>
#include <string.h>

#include "base/err.h"
#include "base/mem.h"
#include "device/clock.h"

enum { WIDTH = 6 }; /* of a camera's row: log gain r g b, offset r g b */

spin_status spin_exposures_open(struct spin_exposures *t, struct spin_device *d, int n_cameras,
                                size_t max_pixels)
{
    void *block = NULL;

    memset(t, 0, sizeof *t);
    SPIN_TRY(spin_param_open(&t->param, d, WIDTH * (size_t)n_cameras, 0));
    if (n_cameras == 0)
        return SPIN_OK;
    t->max_pixels = max_pixels;
    SPIN_TRY(d->op->reserve(d, 3 * max_pixels * sizeof(float), (void **)&t->exposed));
    SPIN_TRY(spin_alloc(t->param.n, sizeof(float), &block));
    t->host = block;
    return SPIN_OK;
}

void spin_exposures_close(struct spin_exposures *t, struct spin_device *d)
{
    spin_param_close(&t->param, d);
    d->op->release(d, t->exposed, 3 * t->max_pixels * sizeof(float));
    free(t->host);
    memset(t, 0, sizeof *t);
}

static void compare(struct spin_exposures *t, struct spin_raster *raster,
                    const struct spin_target *taken, float lambda_dssim, float weight,
                    double values[3])
{
    struct spin_device *d = raster->device;
    int width = taken->camera->width, height = taken->camera->height;
    size_t n_pixels = (size_t)width * (size_t)height, at = WIDTH * (size_t)taken->exposure;
    const float *image = raster->image, *pixel_weight = NULL;

    d->op->upload(d, raster->truth, taken->truth, 3 * n_pixels * sizeof(float));
    if (taken->weight) {
        d->op->upload(d, raster->weight, taken->weight, n_pixels * sizeof(float));
        pixel_weight = raster->weight;
    }
    if (t->param.n) {
        d->op->exposure(d, n_pixels, t->param.p + at, raster->image, t->exposed);
        image = t->exposed;
    }
    d->op->loss(d, width, height, image, raster->truth, pixel_weight, lambda_dssim, weight, values,
                raster->d_image);
    if (t->param.n)
        d->op->exposure_back(d, n_pixels, t->param.p + at, raster->image, raster->d_image,
                             t->param.g + at);
}

void spin_image_loss(struct spin_exposures *t, struct spin_raster *raster,
                     const struct spin_target *taken, float lambda_dssim, float weight,
                     double values[3])
{
    SPIN_TIMED(raster->device, SPIN_OP_LOSS,
               compare(t, raster, taken, lambda_dssim, weight, values));
}

static void centre(struct spin_exposures *t, struct spin_device *d)
{
    size_t n = t->param.n / WIDTH;
    float *exposure = t->host;

    d->op->download(d, exposure, t->param.p, t->param.n * sizeof(float));
    for (size_t k = 0; k < WIDTH; k++) {
        double mean = 0;

        for (size_t i = 0; i < n; i++)
            mean += (double)exposure[WIDTH * i + k] / (double)n;
        for (size_t i = 0; i < n; i++)
            exposure[WIDTH * i + k] -= (float)mean;
    }
    d->op->upload(d, t->param.p, exposure, t->param.n * sizeof(float));
}

void spin_exposures_step(struct spin_exposures *t, struct spin_device *d, double lr, int64_t step)
{
    struct spin_param *p = &t->param;

    if (p->n == 0)
        return;
    SPIN_TIMED(d, SPIN_OP_ADAM, d->op->adam(d, p->n, p->p, p->g, p->m, p->v, lr, step));
    centre(t, d);
}
