/* Clouds of canonical Gaussians that a network deforms: a frame, and shapes whose residuals come after the
 * activation. */
#ifndef SPIN_IMPORTERS_LIB_DEFORM_H
#define SPIN_IMPORTERS_LIB_DEFORM_H

#include "importers/lib/mlp_eval.h"

/* What a network gives of a frame: for mlp_block_fn. */
struct deform_job {
    const void *model; /* of the importer */
    struct spin_splats *out;
    unsigned columns;
    float time;
};

/* One frame: the columns in `moved` by `fn`, which gets a struct deform_job, the others as they are in the
 * canonical cloud, quaternions of unit length. `path` is for messages. */
spin_status spin_deform_frame(const char *path, const struct spin_splats *canonical, double time,
                              unsigned columns, unsigned moved, struct mlp_team *team,
                              mlp_block_fn fn, const void *model, struct spin_splats *out);

/* What most of these methods' sequences have in common: any time from 0 to 1. */
void spin_deform_describe(const struct spin_splats *canonical, unsigned moved,
                          struct spin_sequence_info *sequence);

/* Scale and quaternion with their residuals, which stand every MLP_BLOCK floats and are added after the
 * activation, not normalised, as the ellipsoid that the methods' rasteriser makes of them. NaN where there
 * is none. out_: or NULL. */
void spin_deform_shape(const float log_scale[3], const float quat[4], const float *d_scale,
                       const float *d_quat, float *out_log_scale, float *out_quat);

#endif
