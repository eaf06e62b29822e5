/* Per-camera exposure: a gain and an offset for each colour channel (math/exposure.h), learned with the
 * scene. */
#ifndef SPIN_TRAIN_EXPOSURE_H
#define SPIN_TRAIN_EXPOSURE_H

#include "train/param.h"

struct spin_exposures {
    struct spin_param param; /* [cameras][SPIN_EXPOSURE]; n 0: cameras are all alike */
    float SPIN_DEV *exposed; /* [pixels][3] */
    size_t pixels;
};

/* n_cameras 0: none are learned. pixels: of all pictures that are exposed together. After a failure close
 * as well. */
spin_status spin_exposures_open(struct spin_exposures *t, struct spin_device *d, int n_cameras,
                                size_t pixels);
void spin_exposures_close(struct spin_exposures *t, struct spin_device *d);

/* Gauge, after a step of Adam: the mean camera has gain 1 and offset 0, so held-out views are drawn in its
 * colours. */
void spin_exposures_centre(struct spin_exposures *t, struct spin_device *d);

#endif
