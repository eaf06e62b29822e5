/* The loss of drawn pictures, and its gradient. */
#include "train/image_loss.h"

void spin_image_loss(struct spin_exposures *t, struct spin_raster *raster,
                     const struct spin_view_batch *views, const struct spin_images *images,
                     float lambda_dssim, double SPIN_DEV *values)
{
    struct spin_device *d = raster->device;
    const float SPIN_DEV *image = raster->image;

    if (t->param.n) {
        d->op->exposure(d, views, t->param.p, raster->image, t->exposed);
        image = t->exposed;
    }
    d->op->loss(d, views, images, lambda_dssim, image, values, raster->d_image);
    if (t->param.n)
        d->op->exposure_back(d, views, t->param.p, raster->image, raster->d_image, t->param.g);
}
