/* Sets the initial values of splats that are not visible to any training camera. */
#pragma once

#include "train/train_frame.h"
#include "train/plan.h"

/* Changes the points of `cloud`, which are the initial values of frame f, made from the splats s as
 * faint points, since training makes them opaque. Training never changes splats that are not
 * visible to any training camera: they would stay faint and leave holes in other views. Such splats
 * get the attributes of the source or, if the source consists of points, a high opacity. All other
 * points of the cloud are marked as seen. */
spin_status spin_show_unseen(const struct spin_plan *plan, const struct spin_splats *s, int f,
                             struct spin_refine_cloud *cloud);
