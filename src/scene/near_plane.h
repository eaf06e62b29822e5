/* The near plane of the cameras of a data set. */
#pragma once

#include "spin.h"

/* Sets the near plane of all views from the n points [n][3] of one frame. Its distance is
 * SPIN_NEAR, or a quarter of the depth of the foreground in the median view if that is less, as in
 * scenes whose coordinates are small numbers. If `warns` is true, a warning is printed if the near
 * plane of a view still cuts off more than 1 % of the points inside its image. */
spin_status spin_views_set_near(struct spin_views *views, const float *points, size_t n,
                                bool warns);
