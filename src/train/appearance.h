/* Finds the places of a scene whose appearance varies over time, because of moving shadows or
 * reflections. */
#pragma once

#include "train/photos.h"

/* varies [n]: whether the brightness at place [n][3] (world units) changes over the clip: in some
 * frame it differs from the camera's own median over time in more than half of the training cameras
 * that see the place, and in at least two. Requiring several cameras excludes objects that only
 * pass in front of the place, as only some cameras see those. At most 32 frames of the clip are
 * examined; a frame in which fewer than two cameras see the place does not count. */
spin_status spin_appearance_varies(const struct spin_plan *plan, struct spin_photos *photos,
                                   size_t n, const float *place, uint8_t *varies);
