/* Finds the places of a scene whose appearance varies over time, because of moving shadows or
 * reflections. */
#pragma once

#include "train/photos.h"

/* varies [n]: whether the brightness at place [n][3] (world units) varies over the clip. It does
 * if, in some frame, more than half and at least two of the training cameras that see the place
 * deviate from their own median over time. An object that only passes in front of the place does
 * not count, since few cameras see it there. At most 32 frames of the clip are examined. */
spin_status spin_appearance_varies(const struct spin_plan *plan, struct spin_photos *photos,
                                   size_t n, const float *place, uint8_t *varies);
