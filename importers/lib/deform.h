/* Clouds of canonical Gaussians that a network deforms: a frame, shapes whose residuals come after
 * the activation, and saves in two folders. */
#pragma once

#include "importers/lib/model.h"

#define DEFORM_MOVED ((unsigned)SPIN_COL_MEANS | SPIN_COL_QUATS | SPIN_COL_LOG_SCALES)

/* What a network gives of a frame: for mlp_block_fn. */
struct deform_job {
    const void *model;              /* of the importer */
    const struct spin_splats *from; /* the canonical cloud */
    struct spin_splats *out;
    unsigned columns;
    float time;
};

/* One frame: the columns in `moved` by `fn`, which gets a struct deform_job, the others as they are
 * in the canonical cloud, quaternions of unit length. */
spin_status spin_deform_frame(struct spin_model *m, double time, unsigned columns, unsigned moved,
                              mlp_block_fn fn, struct spin_splats *out);

/* Scales and quaternions of n rows with their residuals [3][MLP_BLOCK] and [4][MLP_BLOCK], which
 * are added after the activation, not normalised, as the ellipsoid that the methods' rasteriser
 * makes of them. NaN where there is none. */
void spin_deform_shape(const struct deform_job *job, size_t first, int n, const float *d_scale,
                       const float *d_quat);

/* Saves of Deformable 3D Gaussians and its descendants: point_cloud/iteration_<N>/point_cloud.ply
 * and deform/iteration_<N>/deform.pth of one model. */
struct deform_save {
    const char *model, *name;    /* the model's folder, iteration_<N> */
    const char *cloud, *network; /* the two files */
};

/* `path` is the model's folder, or MODEL/deform/iteration_<N>/deform.pth, which says the save.
 * Option `iteration`: N or "best"; without, the last of which both halves are there; together: the
 * last of either must be it. */
spin_status spin_deform_find(struct spin_model *m, const char *path, bool together,
                             struct deform_save *out);
