/* Densification: clone, split and prune points during training (docs/method.md section 2). The
 * rules are those of 3DGS (Kerbl et al. 2023) or, with long_axis, a split that changes the image
 * less (Deng et al. 2024, "Efficient Density Control for 3D Gaussian Splatting"). Works in host
 * memory. */
#pragma once

#include "train/cloud.h"

/* Points with a smaller opacity are pruned. */
extern const double spin_prune_opacity;

struct spin_densify_options {
    double extent;             /* extent of the cameras, spin_views_extent(); no default */
    double gradient_threshold; /* least mean gradient that densifies a point; default 2e-4 */
    /* Split into two halves along the longest axis; no clones, no random numbers. */
    bool long_axis;
    double percent_dense; /* larger points are split, not cloned: share of extent, default 0.01 */
    double prune_opacity; /* default spin_prune_opacity */
    size_t max_points;    /* 0: no limit */
    uint64_t seed;
    int frame; /* selects the random numbers, with the seed */
    /* Standard normal samples for splits: out [n][3], all first children, then all second ones.
     * NULL: generated from (seed, frame, iteration, row). */
    void (*normals)(void *context, int iteration, size_t n, float *out);
    void *context;
};
void spin_densify_defaults(struct spin_densify_options *o);

struct spin_densify_change {
    size_t clones; /* points added */
    size_t splits; /* parents, each replaced by two children */
    size_t pruned; /* points removed, not counting split parents */
};

/* Clones and splits by the statistics, then prunes and clears all statistics. Order of the result:
 * kept points, clones, first children, second children, each in the order of their parents. */
spin_status spin_densify(const struct spin_densify_options *o, int iteration,
                         struct spin_refine_cloud *cloud, struct spin_densify_change *change);

/* Drops points with an opacity below prune_opacity or a value that is not finite. Returns their
 * number. */
size_t spin_refine_prune(struct spin_refine_cloud *cloud, double prune_opacity);
