/* Measures how the training cameras differ photometrically: in colour, and in falloff towards the
 * corners. */
#pragma once

#include "train/look_fit.h"
#include "train/photos.h"

/* look->spread: the largest deviation of a camera from the others in a channel, 0..1. A camera's
 * deviation is the median, over the source's points that it sees, of the difference between its
 * colour and the mean colour of all cameras that see the point. -1 if too few points are visible to
 * three training cameras in one frame. Points that at least three training cameras see also
 * determine each camera's gain and each lens's falloff, as far as the fit is credible (look_fit.h).
 * Gains and falloffs are stored in plan->exposure and plan->lenses; undetermined ones are 0. */
spin_status spin_camera_colours(struct spin_plan *plan, struct spin_photos *photos,
                                struct spin_look *look);
