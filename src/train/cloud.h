/* The points of one frame in host memory, where densification changes their number, and their first
 * values. */
#pragma once

#include "base/pool.h"
#include "train/train_frame.h"

/* The parameters of one Gaussian, raw: what the optimiser sees. */
struct spin_refine_row {
    float pos_w[3];
    float log_scale[3]; /* from here on a row of residual values, model/residual.h */
    float rotation[4];  /* w, x, y, z, any length */
    float dc[3];        /* first SH coefficient of r, g, b */
    float logit_opacity;
};
enum { SPIN_REFINE_WIDTH = 3 + SPIN_RESIDUAL }; /* floats of a row */

struct spin_refine_point {
    struct spin_refine_row p, m, v; /* parameters and Adam's moments */
    float gradient;                 /* sum of |dL/d(ndc xy)| over the views that saw it ... */
    uint32_t seen;                  /* ... and how many those were, since the last densification */
    uint32_t origin; /* place before the last densification, its own or its parent's */
    bool is_new;     /* made by it */
};

enum { SPIN_REFINE_SH = 45 }; /* SH coefficients beyond the first, [15][3] */

/* Zero it to begin, free it once. */
struct spin_refine_cloud {
    struct spin_refine_point *point; /* [n] */
    float *sh; /* [n][3][SPIN_REFINE_SH]: values of SH beyond the first, and Adam's moments; NULL at
                  sh_degree 0 */
    int sh_degree;
    size_t n, capacity;
};

/* Room for n points; contents are kept. */
spin_status spin_refine_cloud_reserve(struct spin_refine_cloud *cloud, size_t n);
void spin_refine_cloud_free(struct spin_refine_cloud *cloud);
/* Its points and their moments to a frame of as many splats, and back; what a splat has not of its
 * own stays as it is. */
spin_status spin_refine_cloud_send(const struct spin_refine_cloud *cloud, struct spin_device *d,
                                   struct spin_train_frame *frame);
spin_status spin_refine_cloud_fetch(struct spin_refine_cloud *cloud, struct spin_device *d,
                                    const struct spin_train_frame *frame);

/* The start of 3DGS from coloured points: isotropic scale from the 3 nearest neighbours, no
 * rotation, opacity 0.1. pos_w [n][3] must be finite; rgb [n][3] is 0..1, or NULL for mid grey. */
spin_status spin_refine_init_from_points(struct spin_pool *pool, size_t n, const float *pos_w,
                                         const float *rgb, struct spin_refine_cloud *out);
/* The same from splats with rgb, with SH of which the first coefficient is a colour, or with
 * neither. */
spin_status spin_refine_init_from_colours(const struct spin_splats *splats,
                                          struct spin_refine_cloud *out);
/* The start from finished splats with all attribute columns; SH beyond the first is left behind. */
spin_status spin_refine_init_from_splats(const struct spin_splats *splats,
                                         struct spin_refine_cloud *out);
/* After one of these: the cloud gets an SH degree above 0. What `splats`, as many, have beyond the
 * first coefficient is taken over as far as the degree goes; the rest is zero. splats may be NULL.
 */
spin_status spin_refine_add_sh(int sh_degree, const struct spin_splats *splats,
                               struct spin_refine_cloud *cloud);

/* All attribute columns of the cloud, with its SH degree. */
spin_status spin_refine_to_splats(const struct spin_refine_cloud *cloud, struct spin_splats *out);
