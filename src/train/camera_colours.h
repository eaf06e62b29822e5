/* Measures photometric differences between the training cameras: in colour, and in the falloff of
 * brightness towards the corners. */
#pragma once

#include "train/photometric_fit.h"
#include "train/photos.h"

/* Compares the colours of the source's points in the images of those training cameras in which the
 * points are visible. Sets result->spread to the largest absolute deviation of any camera in any
 * colour channel, 0..1. The deviation of a camera is the median, over its visible points, of the
 * difference between the point's colour in this camera and the point's mean colour in all cameras.
 * result->spread is -1 if too few points are visible in at least three cameras. Also fits a gain
 * for each camera and a falloff for each lens, stores them in plan->exposure and plan->lenses, and
 * sets result->gains and result->falloff. Gains and falloffs that are rejected (photometric_fit.h)
 * are 0. */
spin_status spin_photometric_fit_cameras(struct spin_plan *plan, struct spin_photos *photos,
                                         struct spin_photometric_result *result);
