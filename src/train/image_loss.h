/* The loss of drawn pictures against the photographs, with the cameras' exposure between them. */
#ifndef SPIN_TRAIN_IMAGE_LOSS_H
#define SPIN_TRAIN_IMAGE_LOSS_H

#include "render/image_store.h"
#include "render/raster.h"
#include "train/exposure.h"

/* The losses of the pictures in the raster go to rows of `values` (as spin_device_ops.loss has them). Leaves
 * in the raster the gradient, times each view's weight, with respect to the picture before the exposure; the
 * exposure's own is gathered. */
void spin_image_loss(struct spin_exposures *t, struct spin_raster *raster,
                     const struct spin_view_batch *views, const struct spin_images *images,
                     float lambda_dssim, double SPIN_DEV *values);

#endif
