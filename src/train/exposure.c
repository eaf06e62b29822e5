/* Manages the device memory of the cameras' exposure and the lenses' falloff. */
#include "train/exposure.h"

#include <string.h>

spin_status spin_exposures_open(struct spin_exposures *t, struct spin_device *d, int n_cameras,
                                int n_lenses, const float *first, size_t pixels)
{
    size_t n = n_cameras == 0 ? 0 : SPIN_EXPOSURE * (size_t)(n_cameras + n_lenses);

    memset(t, 0, sizeof *t);
    SPIN_TRY(spin_param_open(&t->param, d, n, 0));
    if (n == 0)
        return SPIN_OK;
    d->op->upload(d, t->param.p, first, n * sizeof(float));
    t->n_cameras = (size_t)n_cameras;
    t->pixels = pixels;
    return d->op->reserve(d, 3 * pixels * sizeof(float), (void SPIN_DEV **)&t->exposed);
}

void spin_exposures_close(struct spin_exposures *t, struct spin_device *d)
{
    spin_param_close(&t->param, d);
    d->op->release(d, t->exposed);
    memset(t, 0, sizeof *t);
}

void spin_exposures_centre(struct spin_exposures *t, struct spin_device *d)
{
    if (t->param.n)
        d->op->exposure_centre(d, t->n_cameras, t->param.p);
}

spin_status spin_exposures_read_lenses(const struct spin_exposures *t, struct spin_device *d,
                                       struct spin_lenses *lenses)
{
    const float SPIN_DEV *row = t->param.p + SPIN_EXPOSURE * t->n_cameras;

    for (int i = 0; i < lenses->n && t->param.n; i++)
        SPIN_TRY(d->op->download(d, lenses->lens[i].falloff, row + SPIN_EXPOSURE * i,
                                 sizeof lenses->lens[i].falloff));
    return SPIN_OK;
}
