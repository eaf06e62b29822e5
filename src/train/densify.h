/* Densification: clones, splits and prunes points during training (docs/method.md section 2), in
 * host memory. The rules are those of 3DGS (Kerbl et al. 2023). With the option long_axis, points
 * are instead split along their longest axis, which changes the image less (Deng et al. 2024,
 * "Efficient Density Control for 3D Gaussian Splatting"). */
#pragma once

#include "train/train_frame.h"
#include "train/step.h"

/* Points with a smaller opacity are pruned. */
extern const double spin_prune_opacity;

struct spin_densify_options {
    /* Extent of the training cameras in world units, see spin_views_extent(); no default. */
    double extent;
    /* A point is cloned or split if the mean gradient of its screen position, in normalised device
     * coordinates, is at least this value; default 2e-4. */
    double gradient_threshold;
    /* If true, each densified point is split into two halves along its longest axis, without random
     * numbers, and no point is cloned. */
    bool long_axis;
    /* A point whose gradient reaches gradient_threshold is split if its largest scale exceeds this
     * share of `extent`, otherwise it is cloned; default 0.01. Unused with long_axis. */
    double percent_dense;
    double prune_opacity; /* points with a smaller opacity are pruned; default spin_prune_opacity */
    size_t max_points;    /* limit for the number of points after densification; 0: no limit */
    uint64_t seed;
    int frame; /* number of the frame; selects the random numbers together with the seed */
    /* Sets out [n][3] to standard normal samples for splits: one sample for the first child of each
     * split point, then one for the second child of each split point. NULL: samples are generated
     * from the seed, the frame, the iteration and the index of the sample. */
    void (*normals)(void *context, int iteration, size_t n, float *out);
    void *context;
};
void spin_densify_defaults(struct spin_densify_options *o);

struct spin_densify_change {
    size_t clones; /* number of clones, which are added points */
    size_t splits; /* number of split points, each of which is replaced by two children */
    size_t pruned; /* number of removed points, excluding split points */
};

/* Clones and splits points according to their statistics (spin_refine_point), then prunes points
 * and clears all statistics. Order of the result: kept points, clones, first children, second
 * children. Within each of these groups, kept points are in their original order, and new points in
 * the original order of their parents. */
spin_status spin_densify(const struct spin_densify_options *o, int iteration,
                         struct spin_refine_cloud *cloud, struct spin_densify_change *change);

/* Removes points that have an opacity below prune_opacity or a value that is not finite. Returns
 * the number of removed points. */
size_t spin_refine_prune(struct spin_refine_cloud *cloud, double prune_opacity);

/* ---- Densification of tracks ----------------------------------------------------------------- */

/* Densifies a clip: clones, splits and prunes tracks, and splats without a track, according to the
 * statistics gathered since the previous densification. A new track has a splat in every frame in
 * which its parent has a splat. */

/* Densifies the clip and clears the statistics of all frames. permutation [frames][splats] is the
 * row of each splat in the output; the function replaces the array of each frame, which was
 * allocated by spin_pages_reserve_in(), and assigns the last rows to new splats. It may be NULL if
 * the caller does not need the rows. Sets counts [frames] to the new numbers of splats. iteration
 * and o->seed select the random numbers. o->max_points limits the number of splats of a frame; if
 * the limit is reached, tracks take precedence over splats without a track. */
spin_status spin_densify_tracks(struct spin_trainer *t, const struct spin_densify_options *o,
                                int iteration, uint32_t **permutation, size_t *counts,
                                struct spin_densify_change *change);
