/* Measures how the training cameras differ photometrically: in colour, and in falloff towards the
 * corners. */
#pragma once

#include "train/photometric_fit.h"
#include "train/photos.h"

/* Measures and sets two results. First, look->spread: the largest absolute deviation of any camera
 * in any colour channel, 0..1. The deviation of a camera is a median over the points of the source
 * that are visible to it: of the difference between the point's colour in this camera and its mean
 * colour over all cameras to which it is visible. look->spread is -1 if too few points are visible
 * to three training cameras in one frame. Second, each camera's gain and each lens's falloff,
 * fitted to the points that are visible to at least three training cameras, and stored in
 * plan->exposure and plan->lenses. Gains and falloffs that the fit does not determine, or that are
 * not credible (photometric_fit.h), are 0. */
spin_status spin_photometric_fit_cameras(struct spin_plan *plan, struct spin_photos *photos,
                                         struct spin_photometric_result *result);
