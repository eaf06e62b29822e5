/* Distances to the nearest neighbours, from which 3DGS derives initial scales (docs/method.md
 * section 2). */
#pragma once

#include "base/pool.h"
#include "spin.h"

/* mean_dist2[i] = mean of the squared distances from points[i] to its 3 nearest other points (fewer
 * if there are fewer; 0 if there is none). points [n][3], finite. The result does not depend on the
 * number of threads. */
spin_status spin_knn_mean_dist2(struct spin_pool *pool, size_t n, const float *points,
                                float *mean_dist2);
/* Median of these means over all points. n must be at least 1. */
spin_status spin_knn_median_dist2(struct spin_pool *pool, size_t n, const float *points,
                                  float *median);
