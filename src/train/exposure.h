/* Photometric model of the cameras, learned with the scene (math/exposure.h): gain and offset of
 * each camera for each colour channel, and falloff of each lens. */
#pragma once

#include "scene/lens.h"
#include "train/param.h"

struct spin_exposures {
    struct spin_param param; /* [n_cameras + n_lenses][SPIN_EXPOSURE]; n 0: none is learned */
    size_t n_cameras;
    float SPIN_DEV *exposed; /* [pixels][3] rendered images with exposure and falloff */
    size_t pixels;
};

/* n_cameras 0: none is learned. pixels: of all images that are exposed together. first: initial
 * values in the layout of param. Close it also after a failure. */
spin_status spin_exposures_open(struct spin_exposures *t, struct spin_device *d, int n_cameras,
                                int n_lenses, const float *first, size_t pixels);
void spin_exposures_close(struct spin_exposures *t, struct spin_device *d);

/* Downloads the current falloff of the lenses. */
spin_status spin_exposures_read_lenses(const struct spin_exposures *t, struct spin_device *d,
                                       struct spin_lenses *lenses);

/* Fixes the gauge after an Adam step: the mean camera has gain 1 and offset 0, so held-out views
 * are rendered in its colours. Falloff needs no gauge: its formula gives 1 at the image centre. */
void spin_exposures_centre(struct spin_exposures *t, struct spin_device *d);
