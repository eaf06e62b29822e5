/* The points of one frame in host memory, where densification changes their number, and their
 * initial values. */
#pragma once

#include "base/pool.h"
#include "train/train_frame.h"

/* Parameters of one Gaussian before activation functions, as the optimiser sees them. */
struct spin_refine_row {
    float pos_w[3];
    float log_scale[3]; /* first member of a row of residual values (model/residual.h) */
    float rotation[4];  /* w, x, y, z, any length */
    float dc[3];        /* first SH coefficient of r, g, b */
    float logit_opacity;
};
enum { SPIN_REFINE_WIDTH = 3 + SPIN_RESIDUAL }; /* floats of a row */

struct spin_refine_point {
    struct spin_refine_row p, m, v; /* parameters and Adam's moments */
    /* Since the last densification: the sum of |dL/d(ndc xy)| over the views in which the point was
     * visible, and the number of these views. */
    float gradient;
    uint32_t seen;
    uint32_t origin; /* index of the point, or of its parent, before the last densification */
    bool is_new;     /* created by the last densification */
};

enum { SPIN_REFINE_SH = 45 }; /* SH coefficients beyond the first, [15][3] */

/* Zero it first; free it once. */
struct spin_refine_cloud {
    struct spin_refine_point *point; /* [n] */
    /* [n][3][SPIN_REFINE_SH]: SH values beyond the first coefficient and Adam's moments; NULL at
     * sh_degree 0. */
    float *sh;
    int sh_degree;
    size_t n, capacity;
};

/* Grows the capacity to n points; contents are kept. */
spin_status spin_refine_cloud_reserve(struct spin_refine_cloud *cloud, size_t n);
void spin_refine_cloud_free(struct spin_refine_cloud *cloud);
/* Uploads values and moments to the leading splats of a frame, or downloads them from there. Values
 * that a splat of the frame does not own are skipped. */
spin_status spin_refine_cloud_send(const struct spin_refine_cloud *cloud, struct spin_device *d,
                                   struct spin_train_frame *frame);
spin_status spin_refine_cloud_fetch(struct spin_refine_cloud *cloud, struct spin_device *d,
                                    const struct spin_train_frame *frame);

/* Initialises from coloured points as 3DGS does: isotropic scale from the 3 nearest neighbours, no
 * rotation, opacity 0.1. pos_w [n][3] must be finite; rgb [n][3] is 0..1, or NULL for mid grey. */
spin_status spin_refine_init_from_points(struct spin_pool *pool, size_t n, const float *pos_w,
                                         const float *rgb, struct spin_refine_cloud *out);
/* As spin_refine_init_from_points(), with the means of splats and their rgb, else the colour of
 * their first SH coefficient, else mid grey. */
spin_status spin_refine_init_from_colours(const struct spin_splats *splats,
                                          struct spin_refine_cloud *out);
/* Initialises from splats with all attribute columns, without SH beyond the first coefficient. */
spin_status spin_refine_init_from_splats(const struct spin_splats *splats,
                                         struct spin_refine_cloud *out);
/* Adds SH of a degree above 0 to a cloud that one of the functions above has initialised.
 * Coefficients beyond the first are copied from `splats`, one per point; those that `splats` lacks
 * are zero, or all if it is NULL. */
spin_status spin_refine_add_sh(int sh_degree, const struct spin_splats *splats,
                               struct spin_refine_cloud *cloud);

/* Converts the cloud to splats with all attribute columns and the cloud's SH degree. */
spin_status spin_refine_to_splats(const struct spin_refine_cloud *cloud, struct spin_splats *out);
