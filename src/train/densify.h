/* How the number of points changes while they are trained: clone, split, prune (docs/method.md
 * section 2). The rules are those of 3DGS, Kerbl et al. 2023, or with long_axis a split that
 * changes the picture less, Deng et al. 2024, "Efficient Density Control for 3D Gaussian
 * Splatting". Host memory only. */
#pragma once

#include "train/cloud.h"

/* Opacity below which points are dropped. */
extern const double spin_prune_opacity;

struct spin_densify_options {
    double extent;             /* of the scene: spin_views_extent(); no default */
    double gradient_threshold; /* of the mean gradient; 2e-4 */
    bool long_axis; /* no clones and no random numbers: two halves, one behind the other along the
                       longest axis */
    double percent_dense; /* of the extent: largest scale that is cloned, not split; 0.01 */
    double prune_opacity; /* spin_prune_opacity */
    size_t max_points;    /* 0: no limit */
    uint64_t seed;
    int frame; /* with the seed: names the random numbers */
    /* Standard normal samples of the split: out [n][3], all first children, then all second.
     * NULL: drawn from (seed, frame, iteration, row). */
    void (*normals)(void *context, int iteration, size_t n, float *out);
    void *context;
};
void spin_densify_defaults(struct spin_densify_options *o);

struct spin_densify_change {
    size_t clones; /* made */
    size_t splits; /* parents split; each leaves two children */
    size_t pruned; /* not counting those parents */
};

/* Clone and split by the statistics, then prune; afterwards all statistics are zero. Order of
 * the result: kept points, clones, first children, second children, each in the order of their
 * parents. */
spin_status spin_densify(const struct spin_densify_options *o, int iteration,
                         struct spin_refine_cloud *cloud, struct spin_densify_change *change);

/* Drop points of opacity below prune_opacity, and those with a value that is not finite; returns
 * how many. */
size_t spin_refine_prune(struct spin_refine_cloud *cloud, double prune_opacity);
