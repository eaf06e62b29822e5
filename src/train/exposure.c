/* Per-camera exposure in training. */
#include "train/exposure.h"

#include <string.h>

#include "base/err.h"

spin_status spin_exposures_open(struct spin_exposures *t, struct spin_device *d, int n_cameras,
                                size_t pixels)
{
    memset(t, 0, sizeof *t);
    SPIN_TRY(spin_param_open(&t->param, d, SPIN_EXPOSURE * (size_t)n_cameras, 0));
    if (n_cameras == 0)
        return SPIN_OK;
    t->pixels = pixels;
    return d->op->reserve(d, 3 * pixels * sizeof(float), (void SPIN_DEV **)&t->exposed);
}

void spin_exposures_close(struct spin_exposures *t, struct spin_device *d)
{
    spin_param_close(&t->param, d);
    d->op->release(d, t->exposed, 3 * t->pixels * sizeof(float));
    memset(t, 0, sizeof *t);
}

void spin_exposures_centre(struct spin_exposures *t, struct spin_device *d)
{
    if (t->param.n)
        d->op->exposure_centre(d, t->param.n / SPIN_EXPOSURE, t->param.p);
}
