/* Distances to the nearest neighbours: the start scale of 3DGS (docs/method.md section 2). */
#pragma once

#include "base/pool.h"
#include "spin.h"

/* mean_dist2[i] = mean of the squared distances from points[i] to its 3 nearest other points (fewer
 * when there are fewer; 0 when there is none). points [n][3], finite. The same for any number of
 * threads. */
spin_status spin_knn_mean_dist2(struct spin_pool *pool, size_t n, const float *points,
                                float *mean_dist2);
/* The median of these over all points, of which there is at least one. */
spin_status spin_knn_median_dist2(struct spin_pool *pool, size_t n, const float *points,
                                  float *median);
