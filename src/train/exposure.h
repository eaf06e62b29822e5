/* How each camera shows the scene (math/exposure.h): its gain and offset for each colour channel,
 * and the falloff of its lens, learned with the scene. */
#pragma once

#include "scene/lens.h"
#include "train/param.h"

struct spin_exposures {
    struct spin_param param; /* [n_cameras + n_lenses][SPIN_EXPOSURE]; n 0: cameras are all alike */
    size_t n_cameras;
    float SPIN_DEV *exposed; /* [pixels][3] */
    size_t pixels;
};

/* n_cameras 0: none are learned. pixels: of all pictures that are exposed together. first: the
 * values to begin with, in the layout of param. After a failure close as well. */
spin_status spin_exposures_open(struct spin_exposures *t, struct spin_device *d, int n_cameras,
                                int n_lenses, const float *first, size_t pixels);
void spin_exposures_close(struct spin_exposures *t, struct spin_device *d);

/* The falloff of the lenses as it is now. */
spin_status spin_exposures_read_lenses(const struct spin_exposures *t, struct spin_device *d,
                                       struct spin_lenses *lenses);

/* Gauge, after a step of Adam: the mean camera has gain 1 and offset 0, so held-out views are drawn
 * in its colours. The middle of a lens's picture has falloff 1 by its formula. */
void spin_exposures_centre(struct spin_exposures *t, struct spin_device *d);
