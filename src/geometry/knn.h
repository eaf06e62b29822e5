/* Distances from points to their nearest neighbours, from which 3DGS derives the initial scales of
 * splats (docs/method.md section 2). */
#pragma once

#include "base/pool.h"
#include "spin.h"

/* mean_dist2[i] = mean of the squared distances from point i of points [n][3] to its 3 nearest
 * other points. With fewer than 3 other points it is the mean over these, and 0 if n is 1. All
 * points must be finite. The result does not depend on the number of threads. */
spin_status spin_knn_mean_dist2(struct spin_pool *pool, size_t n, const float *points,
                                float *mean_dist2);
/* Sets *median to the median of the values that spin_knn_mean_dist2() gives for all points. n must
 * be at least 1. */
spin_status spin_knn_median_dist2(struct spin_pool *pool, size_t n, const float *points,
                                  float *median);
