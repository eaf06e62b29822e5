/* Whether the training cameras show the same places in different colours. */
#ifndef SPIN_TRAIN_CAMERA_COLOURS_H
#define SPIN_TRAIN_CAMERA_COLOURS_H

#include "train/truth.h"

/* How far a camera is from the others in a channel, at most, from 0 to 1: the median, over points of the source that
 * it shows, of the difference to the mean of the cameras that show the point. -1 where no frame has three training
 * views of the same points: there is nothing to compare. */
spin_status spin_camera_colours(struct spin_plan *plan, struct spin_truth *truth, double *spread);

#endif
