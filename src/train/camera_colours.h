/* How the training cameras show the same places: in different colours, and darker towards the
 * corners. */
#pragma once

#include "train/look_fit.h"
#include "train/photos.h"

/* look->spread: how far a camera is from the others in a channel, at most, from 0 to 1: the median,
 * over points of the source that it shows, of the difference to the mean of the cameras that show
 * the point. -1 where no frame has three training views of the same points: there is nothing to
 * compare. The points that three training cameras and more show also tell each camera's gain and
 * each lens's falloff, as far as they are to be believed (look_fit.h); they go into plan->exposure
 * and plan->lenses, which are 0 otherwise. */
spin_status spin_camera_colours(struct spin_plan *plan, struct spin_photos *photos,
                                struct spin_look *look);
