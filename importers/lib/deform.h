/* Functions for methods with canonical Gaussians that a network deforms. They compute frames, add
 * residuals to activated shapes, and find checkpoints whose files are in two folders. */
#pragma once

#include "importers/lib/model.h"

#define DEFORM_MOVED ((unsigned)SPIN_COL_MEANS | SPIN_COL_QUATS | SPIN_COL_LOG_SCALES)

/* Context of the mlp_block_fn that evaluates a frame. */
struct deform_job {
    const void *model;              /* the importer's own struct */
    const struct spin_splats *from; /* the canonical cloud */
    struct spin_splats *out;
    unsigned columns;
    float time;
};

/* Computes `columns` of one frame. `fn`, whose context is a struct deform_job, fills the columns in
 * `moved`. All other columns are copied from the canonical cloud, and copied quaternions are
 * normalised. */
spin_status spin_deform_frame(struct spin_model *m, double time, unsigned columns, unsigned moved,
                              mlp_block_fn fn, struct spin_splats *out);

/* Adds residuals to the shapes of the rows `first` to `first` + n - 1: d_scale [3][MLP_BLOCK] to
 * the activated scales, d_quat [4][MLP_BLOCK] to the unit quaternions. The rasteriser of these
 * methods does not normalise the sums of quaternions, so the norms of these sums change the shapes
 * that it draws. This function stores the scales and rotations of the ellipsoids as they are drawn,
 * or NaN if a drawn shape is not an ellipsoid. */
void spin_deform_shape(const struct deform_job *job, size_t first, int n, const float *d_scale,
                       const float *d_quat);

/* A checkpoint of Deformable 3D Gaussians and its descendants, which consists of
 * point_cloud/iteration_<N>/point_cloud.ply and deform/iteration_<N>/deform.pth in the model's
 * folder. */
struct deform_save {
    /* Path of the model's folder; name iteration_<N> of the checkpoint's two folders. */
    const char *model, *name;
    const char *cloud, *network; /* paths of point_cloud.ply and of deform.pth */
};

/* Finds the checkpoint to read. `path` is the file deform/iteration_<N>/deform.pth of a checkpoint,
 * or the model's folder. In the folder, option `iteration`, a number N or "best", selects the
 * checkpoint. Without the option, the last checkpoint with both files is used; if `together` is
 * true, it is then an error if the last cloud and the last network belong to different checkpoints.
 */
spin_status spin_deform_find(struct spin_model *m, const char *path, bool together,
                             struct deform_save *out);

/* ---- The network ----------------------------------------------------------------------------- */

/* The network of Deformable 3D Gaussians, which methods derived from it also use. It consists of
 * layers linear.* with one skip connection; its input is the encoding of a position followed by the
 * encoding of a time. */

struct deform_net {
    struct mlp_net linear; /* one layer has a skip connection from the input */
    int n_in, width;
    struct mlp_net time; /* the time network; time.n is 0 if there is none */
    int n_position;      /* number of inputs of `linear` that encode the position */
    int n_time;          /* number of further inputs of `linear`, which depend on time */
    float *inputs;   /* [n_time] the inputs that depend on time, for the current frame; followed by
                        scratch memory */
    int frequencies; /* number of frequencies in the encoding of time */
};

/* Loads the tensors of m->tensors whose names are m->prefix followed by linear.* or timenet.*. */
spin_status spin_deform_net_load(struct spin_model *m, struct deform_net *net);
/* Computes the inputs that depend on time, for all following blocks. */
void spin_deform_net_time(struct deform_net *net, float time);
/* Writes the inputs of the network for a block of points at the positions `at` to `in`, which has
 * space for the output of one layer after the inputs. */
void spin_deform_net_encode(const struct deform_net *net, const float *const at[MLP_BLOCK],
                            float *in);
