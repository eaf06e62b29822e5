/* The points of one frame while it is refined, and how their number changes: clone, split, prune
 * (method.md section 2; the rules are those of 3DGS, Kerbl et al. 2023). Host memory only. */
#ifndef SPIN_TRAIN_DENSIFY_H
#define SPIN_TRAIN_DENSIFY_H

#include "base/pool.h"
#include "spin.h"

/* The parameters of one Gaussian, raw: what the optimiser sees. */
struct spin_refine_row {
    float pos_w[3];
    float dc[3]; /* first SH coefficient of r, g, b */
    float logit_opacity;
    float log_scale[3];
    float rotation[4]; /* w, x, y, z, any length */
};
enum { SPIN_REFINE_WIDTH = 14 }; /* floats of a row */

struct spin_refine_point {
    struct spin_refine_row p, m, v; /* parameters and Adam's moments */
    float gradient;                 /* sum of |dL/d(ndc xy)| over the views that saw it ... */
    uint32_t seen;                  /* ... and how many those were, since the last densification */
};

/* Zero it to begin, free it once. */
struct spin_refine_cloud {
    struct spin_refine_point *point; /* [n] */
    size_t n, capacity;
};

/* Room for n points; contents are kept. */
spin_status spin_refine_cloud_reserve(struct spin_refine_cloud *cloud, size_t n);
void spin_refine_cloud_free(struct spin_refine_cloud *cloud);

/* The start of 3DGS from coloured points: isotropic scale from the 3 nearest neighbours, no
 * rotation, opacity 0.1. pos_w [n][3] must be finite; rgb [n][3] is 0..1, or NULL for mid grey. */
spin_status spin_refine_init_from_points(struct spin_pool *pool, size_t n, const float *pos_w,
                                         const float *rgb, struct spin_refine_cloud *out);
/* The same from splats with rgb, with SH of which the first coefficient is a colour, or with neither. */
spin_status spin_refine_init_from_colours(const struct spin_splats *splats,
                                          struct spin_refine_cloud *out);
/* The start from finished splats with all attribute columns; SH beyond the first is left behind. */
spin_status spin_refine_init_from_splats(const struct spin_splats *splats,
                                         struct spin_refine_cloud *out);

/* All attribute columns of the cloud, SH degree 0. */
spin_status spin_refine_to_splats(const struct spin_refine_cloud *cloud, struct spin_splats *out);

struct spin_densify_options {
    double extent;             /* of the scene: spin_views_extent(); no default */
    double gradient_threshold; /* of the mean gradient; 2e-4 */
    double percent_dense;      /* of the extent: largest scale that is cloned, not split; 0.01 */
    double prune_opacity;      /* 0.005 */
    size_t max_points;         /* 0: no limit */
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

#endif
