/* Canonical Gaussians that a network deforms: frames, residuals of activated shapes, and saves that
 * are spread over two folders. */
#pragma once

#include "importers/lib/model.h"

#define DEFORM_MOVED ((unsigned)SPIN_COL_MEANS | SPIN_COL_QUATS | SPIN_COL_LOG_SCALES)

/* Context of the mlp_block_fn that evaluates a frame. */
struct deform_job {
    const void *model;              /* the importer's */
    const struct spin_splats *from; /* the canonical cloud */
    struct spin_splats *out;
    unsigned columns;
    float time;
};

/* Computes one frame: `fn`, which gets a struct deform_job, fills the columns in `moved`; the
 * others are copied from the canonical cloud, with quaternions normalised. */
spin_status spin_deform_frame(struct spin_model *m, double time, unsigned columns, unsigned moved,
                              mlp_block_fn fn, struct spin_splats *out);

/* Adds residuals, [3][MLP_BLOCK] and [4][MLP_BLOCK], to the activated scales and the quaternions of
 * n rows, without normalising, and stores the ellipsoid that the methods' rasteriser makes of them;
 * NaN where there is none. */
void spin_deform_shape(const struct deform_job *job, size_t first, int n, const float *d_scale,
                       const float *d_quat);

/* Saves of Deformable 3D Gaussians and its descendants: point_cloud/iteration_<N>/point_cloud.ply
 * and deform/iteration_<N>/deform.pth of one model. */
struct deform_save {
    const char *model, *name;    /* the model's folder, iteration_<N> */
    const char *cloud, *network; /* the two files */
};

/* Finds the save to read. `path` is the model's folder, or MODEL/deform/iteration_<N>/deform.pth,
 * which selects the save. Option `iteration`: N or "best"; by default the last with both files,
 * which with `together` must also be the last of each folder. */
spin_status spin_deform_find(struct spin_model *m, const char *path, bool together,
                             struct deform_save *out);
