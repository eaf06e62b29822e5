/* Finds the places of a scene whose appearance varies over time, because of moving shadows or
 * reflections. */
#pragma once

#include "train/photos.h"

/* Sets varies [n] to 1 for each point of place [n][3] (world units) whose brightness varies over
 * the clip, and to 0 for the others. The brightness varies if there is a frame in which at least
 * two training cameras, and more than half of those whose image contains the point, measure a
 * brightness that differs from the camera's own median over time. An object that passes in front of
 * a point does not count, since at any time it covers the point in the images of few cameras only.
 * At most 32 frames of the clip are examined. */
spin_status spin_appearance_varies(const struct spin_plan *plan, struct spin_photos *photos,
                                   size_t n, const float *place, uint8_t *varies);
