/* How the training cameras show the same places: in different colours, and darker towards the corners. */
#pragma once

#include "train/photos.h"

/* How far a camera is from the others in a channel, at most, from 0 to 1: the median, over points of the source that
 * it shows, of the difference to the mean of the cameras that show the point. -1 where no frame has three training
 * views of the same points: there is nothing to compare.
 * The points that four training cameras and more show also tell each camera's gain and each lens's falloff, which go
 * into plan->exposure and plan->lenses; they stay 0 where there are too few points. */
spin_status spin_camera_colours(struct spin_plan *plan, struct spin_photos *photos, double *spread);
