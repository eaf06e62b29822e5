/* Images as planar floats of the size that is wanted; spin_image_load() and _save() of spin.h too. */
#ifndef SPIN_SCENE_IMAGE_FIT_H
#define SPIN_SCENE_IMAGE_FIT_H

#include "spin.h"

/* Interleaved 8-bit RGB, box-filtered where the sizes differ, to planar [3][height][width] 0..1. */
spin_status spin_image_fit(const uint8_t *rgb, int from_width, int from_height, int width,
                           int height, float *out);
/* The same where they do not. */
void spin_image_floats(const uint8_t *rgb, size_t n_pixels, float *out);

#endif
