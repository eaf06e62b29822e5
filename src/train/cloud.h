/* The points of one frame in host memory, where densification changes their number, and their
 * initial values. */
#pragma once

#include "base/pool.h"
#include "train/train_frame.h"

/* Parameters of one Gaussian before activation functions, as the optimiser sees them. */
struct spin_refine_row {
    float pos_w[3];
    /* The members from here on form a row of residual values (model/residual.h). */
    float log_scale[3];
    float rotation[4]; /* quaternion w, x, y, z of any length */
    float dc[3];       /* first SH coefficient of each channel: r, g, b */
    float logit_opacity;
};
enum { SPIN_REFINE_WIDTH = 3 + SPIN_RESIDUAL }; /* floats of a row */

struct spin_refine_point {
    struct spin_refine_row p, m, v; /* parameters, and Adam's first and second moments of them */
    /* Since the last densification: the sum of |dL/d(ndc xy)| over the views in which the point was
     * visible, and the number of these views. */
    float gradient;
    uint32_t seen;
    uint32_t origin; /* index before the last densification: of this point or, if it is new, of its
                        parent */
    bool is_new;     /* true if the last densification created the point */
};

enum { SPIN_REFINE_SH = 45 }; /* SH coefficients beyond the first, [15][3] */

/* The points of a frame. Zero it before its first use; free it also after a failure. */
struct spin_refine_cloud {
    struct spin_refine_point *point; /* [n] */
    /* [n][3][SPIN_REFINE_SH]: for each point its SH coefficients beyond the first, Adam's first
     * moments of these and the second moments. NULL if sh_degree is 0. */
    float *sh;
    int sh_degree;
    size_t n, capacity;
};

/* Grows the capacity to at least n points; keeps the contents. */
spin_status spin_refine_cloud_reserve(struct spin_refine_cloud *cloud, size_t n);
void spin_refine_cloud_free(struct spin_refine_cloud *cloud);
/* Uploads the values and moments of the cloud's points to the first cloud->n splats of a frame
 * (send), or downloads them from there (fetch). Skips values that a splat of the frame does not
 * own. */
spin_status spin_refine_cloud_send(const struct spin_refine_cloud *cloud, struct spin_device *d,
                                   struct spin_train_frame *frame);
spin_status spin_refine_cloud_fetch(struct spin_refine_cloud *cloud, struct spin_device *d,
                                    const struct spin_train_frame *frame);

/* Initialises a cloud from coloured points as 3DGS does: isotropic scale from the distance to the 3
 * nearest neighbours, no rotation, opacity 0.1. pos_w [n][3] must be finite; rgb [n][3] has values
 * 0..1, or is NULL: all points are mid grey. */
spin_status spin_refine_init_from_points(struct spin_pool *pool, size_t n, const float *pos_w,
                                         const float *rgb, struct spin_refine_cloud *out);
/* Calls spin_refine_init_from_points() with the means of the splats as points. The colour is the
 * first of these that the splats have: rgb, the colour of the first SH coefficient, mid grey. */
spin_status spin_refine_init_from_colours(const struct spin_splats *splats,
                                          struct spin_refine_cloud *out);
/* Initialises a cloud from all attributes of splats, which must have all attribute columns, except
 * SH coefficients beyond the first. */
spin_status spin_refine_init_from_splats(const struct spin_splats *splats,
                                         struct spin_refine_cloud *out);
/* Adds SH of a degree above 0 to a cloud that one of the functions above has initialised.
 * `splats` has one splat for each point. Copies its coefficients beyond the first; those of a
 * degree that `splats` lacks are zero. With `splats` NULL all are zero. */
spin_status spin_refine_add_sh(int sh_degree, const struct spin_splats *splats,
                               struct spin_refine_cloud *cloud);

/* Converts the cloud to splats with all attribute columns and the cloud's SH degree. */
spin_status spin_refine_to_splats(const struct spin_refine_cloud *cloud, struct spin_splats *out);
