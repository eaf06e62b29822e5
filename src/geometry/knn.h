/* Distances from points to their nearest neighbours, from which 3DGS derives the initial scales of
 * splats (docs/method.md section 2). */
#pragma once

#include "base/pool.h"
#include "spin.h"

/* Sets mean_dist2[i] to the mean of the squared distances from point i of points [n][3] to its 3
 * nearest other points. If there are fewer than 3 other points, the mean is over all of these; if
 * there are none, it is 0. All points must be finite. The result does not depend on the number of
 * threads. */
spin_status spin_knn_mean_dist2(struct spin_pool *pool, size_t n, const float *points,
                                float *mean_dist2);
/* Sets *median to the median over all points of the values of spin_knn_mean_dist2(). n must be at
 * least 1. */
spin_status spin_knn_median_dist2(struct spin_pool *pool, size_t n, const float *points,
                                  float *median);
