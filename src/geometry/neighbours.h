/* Finds points that are near each other: a k-d tree, distances to nearest neighbours, and the order
 * along a Morton curve. */
#pragma once

#include "spin.h"
#include "base/pool.h"

/* ---- A k-d tree ------------------------------------------------------------------------------ */

/* Each node splits its points at the median of the axis along which they extend farthest; leaves
 * have at most eight points. The median of a node is in the middle of the node's range in `order`,
 * so the tree needs no pointers. */

enum { SPIN_KD_LEAF = 8 };

struct spin_kd_tree {
    const float *points; /* [n][3] points of the caller, which must outlive the tree */
    uint32_t *order;     /* [n] indices of the points; every node has a contiguous range */
    /* [n] axis of the split whose median is at this position of `order`; unused in leaves. */
    uint8_t *axis;
    size_t n;
};

/* Builds a tree of n finite points. The caller zeroes the tree first, and closes it also after a
 * failure. */
spin_status spin_kd_tree_open(struct spin_kd_tree *tree, size_t n, const float *points);
void spin_kd_tree_close(struct spin_kd_tree *tree);

/* Calls visit for every point within the distance `reach` of `at` [3], and also for some points
 * that are farther away, which the caller must exclude if necessary. */
typedef void (*spin_kd_visit)(void *context, uint32_t point);
void spin_kd_tree_within(const struct spin_kd_tree *tree, const float at[3], float reach,
                         spin_kd_visit visit, void *context);

/* Returns the signed distance of the point `at` from the splitting plane of the node whose median
 * is order[place]. It is positive on the side of larger coordinates. */
static inline float spin_kd_gap(const struct spin_kd_tree *t, size_t place, const float at[3])
{
    return at[t->axis[place]] - t->points[(size_t)t->order[place] * 3 + t->axis[place]];
}

/* ---- Distances to nearest neighbours --------------------------------------------------------- */

/* From these, 3DGS derives the initial scales of splats (docs/method.md section 2). */

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

/* ---- Order along a Morton curve -------------------------------------------------------------- */

/* The Morton curve fills space; points that are near along it are near in space. */

/* Sets order [n] to the indices of the points, sorted by Morton code. The code interleaves the bits
 * of a point's coordinates, each quantised to 21 bits over the bounding box of all points. Points
 * with equal codes are sorted by index. points [n][3] must be finite. */
spin_status spin_morton_order(size_t n, const float *points, uint32_t *order);
