/* What a camera makes of a picture - a gain and an offset a channel, math/exposure.h, learned with the
 * scene - and the picture's loss against what that camera saw. */
#ifndef SPIN_TRAIN_EXPOSURE_H
#define SPIN_TRAIN_EXPOSURE_H

#include "train/param.h"
#include "render/raster.h"

struct spin_exposures {
    struct spin_param param; /* [cameras][6]; n 0: cameras are all alike */
    float *exposed;          /* device [3][max_pixels] */
    float *host;             /* [cameras][6] */
    size_t max_pixels;
};

/* One picture as it was taken (host memory). */
struct spin_target {
    const struct spin_camera *camera;
    int exposure;        /* the camera's place in the tints */
    const float *truth;  /* [3][h][w] */
    const float *weight; /* [h][w] how often a pixel counts, at least 0; or NULL: once */
};

/* n_cameras 0: none are learned. After a failure close as well. */
spin_status spin_exposures_open(struct spin_exposures *t, struct spin_device *d, int n_cameras,
                                size_t max_pixels);
void spin_exposures_close(struct spin_exposures *t, struct spin_device *d);

/* The loss of the picture in the raster (values as spin_device_ops.loss has them). Leaves in it the
 * gradient, times weight, with respect to the picture before the tint; the tint's own is gathered. */
void spin_image_loss(struct spin_exposures *t, struct spin_raster *raster,
                     const struct spin_target *taken, float lambda_dssim, float weight,
                     double values[3]);

/* One step of Adam. Gauge: the mean camera has gain 1 and offset 0, so held-out views are drawn in its
 * colours. */
void spin_exposures_step(struct spin_exposures *t, struct spin_device *d, double lr, int64_t step);

#endif
