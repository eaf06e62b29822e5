/* Methods with canonical Gaussians that a network deforms: computes frames, adds residuals to
 * activated shapes, and finds checkpoints whose files are in two folders. */
#pragma once

#include "importers/lib/model.h"

#define DEFORM_MOVED ((unsigned)SPIN_COL_MEANS | SPIN_COL_QUATS | SPIN_COL_LOG_SCALES)

/* Context of the mlp_block_fn that evaluates a frame. */
struct deform_job {
    const void *model;              /* the model of the importer */
    const struct spin_splats *from; /* the canonical cloud */
    struct spin_splats *out;
    unsigned columns;
    float time;
};

/* Computes one frame: `fn`, whose context is a struct deform_job, fills the columns in `moved`; the
 * other columns are copied from the canonical cloud, with quaternions normalised. */
spin_status spin_deform_frame(struct spin_model *m, double time, unsigned columns, unsigned moved,
                              mlp_block_fn fn, struct spin_splats *out);

/* Adds the residuals d_scale [3][MLP_BLOCK] to the activated scales and d_quat [4][MLP_BLOCK] to
 * the unit quaternions of n rows. The methods' rasteriser does not normalise the resulting
 * quaternions; stores the scales and rotations of the ellipsoids that it draws, NaN where there is
 * no ellipsoid. */
void spin_deform_shape(const struct deform_job *job, size_t first, int n, const float *d_scale,
                       const float *d_quat);

/* A checkpoint of Deformable 3D Gaussians and its descendants, which consists of
 * point_cloud/iteration_<N>/point_cloud.ply and deform/iteration_<N>/deform.pth in the model's
 * folder. */
struct deform_save {
    const char *model, *name;    /* the model's folder; iteration_<N> */
    const char *cloud, *network; /* paths of the two files */
};

/* Finds the checkpoint to read. `path` is the model's folder, or
 * MODEL/deform/iteration_<N>/deform.pth, which selects a checkpoint. In the model's folder option
 * `iteration` selects one, by N or "best". The default is the last checkpoint with both files; if
 * `together`, this must be the last of each of the two folders. */
spin_status spin_deform_find(struct spin_model *m, const char *path, bool together,
                             struct deform_save *out);
