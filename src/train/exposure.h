/* Photometric model of the cameras, learned with the scene (math/exposure.h): gain and offset of
 * each camera for each colour channel, and falloff of each lens. */
#pragma once

#include "scene/lens.h"
#include "train/param.h"

struct spin_exposures {
    /* [n_cameras + n_lenses][SPIN_EXPOSURE]: first the cameras, then the lenses. Empty (n is 0) if
     * no exposure is learned. */
    struct spin_param param;
    size_t n_cameras;
    /* [pixels][3] rendered images after exposure and falloff were applied. */
    float SPIN_DEV *exposed;
    size_t pixels;
};

/* Allocates the parameters and copies their initial values from `first`, which has the layout of
 * `param`. `pixels` is the total number of pixels of the images that the device processes together.
 * With n_cameras 0 no exposure is learned and nothing is allocated. Close it also after a failure.
 */
spin_status spin_exposures_open(struct spin_exposures *t, struct spin_device *d, int n_cameras,
                                int n_lenses, const float *first, size_t pixels);
void spin_exposures_close(struct spin_exposures *t, struct spin_device *d);

/* Downloads the current falloff of the lenses. */
spin_status spin_exposures_read_lenses(const struct spin_exposures *t, struct spin_device *d,
                                       struct spin_lenses *lenses);

/* Fixes the gauge after an Adam step: shifts the gains and offsets of all cameras so that the mean
 * of the log gains and the mean of the offsets are 0. A held-out view, which has no exposure of its
 * own, is thus rendered in the colours of this mean camera. Falloff needs no gauge, since its
 * formula gives 1 at the image centre. */
void spin_exposures_centre(struct spin_exposures *t, struct spin_device *d);
