/* Forward and backward pass of the network over the splats of one or more frames, and the buffers
 * of both passes. The network maps (x, y, z, t) of a splat to scale, rotation, SH colour and
 * opacity (docs/method.md section 3). */
#pragma once

#include "model/field.h"

/* Buffers for frame batches of up to `capacity` splats. Shapes: n is the number of splats of the
 * batch, n_in the number of inputs of the heads, row the width of an attribute row, and active the
 * number of active splats. In all functions below, field NULL means that there is no network:
 * attributes are then computed from the residuals of the splats alone. */
struct spin_field_eval {
    struct spin_device *device;
    size_t capacity;     /* largest number of splats in a batch */
    bool training;       /* true if there are buffers for the backward pass */
    float SPIN_DEV *x_u; /* [n][4] input of the encoder: contracted position, and time */
    float SPIN_DEV *z;   /* [n][n_in] output of the encoder, which is the input of the heads */
    /* True if attribute rows have SPIN_ATTR_NARROW floats, false if they have SPIN_ATTR floats.
     * Must equal `narrow` of the frame batches. */
    bool narrow;
    float SPIN_DEV *raw;  /* [n][row] attributes before activation functions */
    float SPIN_DEV *attr; /* [n][row] activated attributes */
    /* Gradients with respect to attr, raw, z and x_u, for training only. Arrays [active] contain
     * rows of the active splats only. */
    float SPIN_DEV *d_attr;    /* [n][row] */
    float SPIN_DEV *d_raw;     /* [active][row] */
    float SPIN_DEV *d_z;       /* [active][n_in] */
    float SPIN_DEV *d_x_u;     /* [active][4] */
    struct spin_active active; /* splats whose gradient was not zero in the last backward pass */

    struct spin_lazy_adam *lazy; /* lazy Adam of the table; NULL: the whole table is updated */
    /* True if positions are not trained: the encoder then adds nothing to d_means. */
    bool still;
};
/* Allocates the buffers for batches of up to `capacity` splats, and with `training` also those for
 * the backward pass. sh: true if frames may have SH coefficients beyond the first; ignored if there
 * is a network. */
spin_status spin_field_eval_open(struct spin_field_eval *eval, struct spin_device *device,
                                 const struct spin_field *field, bool sh, size_t capacity,
                                 bool training);
void spin_field_eval_close(struct spin_field_eval *eval, const struct spin_field *field);

/* Computes eval->attr for all splats of the batch: attr = activate(network(means, t) + residual).
 * Without a network, attr = activate(residual). With lazy Adam, it first makes the postponed Adam
 * steps of the lines of the table that it reads. */
void spin_field_forward(struct spin_field_eval *eval, const struct spin_field *field,
                        const float SPIN_DEV *table, const float SPIN_DEV *heads,
                        const struct spin_frame_batch *frames);
/* The two halves of spin_field_forward(): spin_field_encode() computes eval->z from means and t,
 * and spin_field_decode() computes eval->attr from eval->z. */
void spin_field_encode(struct spin_field_eval *eval, const struct spin_field *field,
                       const float SPIN_DEV *table, const struct spin_frame_batch *frames);
void spin_field_decode(struct spin_field_eval *eval, const struct spin_field *field,
                       const float SPIN_DEV *heads, const struct spin_frame_batch *frames);
/* Propagates eval->d_attr, the gradient with respect to the attributes, back: adds to d_table and
 * d_heads and, in each frame of the batch, to d_residual, d_sh and d_means. Without a network it
 * adds to d_residual and d_sh only. It skips splats for which both d_attr and d_means are exactly
 * zero, which does not change the result. */
void spin_field_backward(struct spin_field_eval *eval, const struct spin_field *field,
                         const float SPIN_DEV *table, const float SPIN_DEV *heads,
                         const struct spin_frame_batch *frames, float SPIN_DEV *d_table,
                         float SPIN_DEV *d_heads);

/* The two halves of spin_field_backward(): spin_field_decode_back() adds to d_heads, d_residual and
 * d_sh, and computes eval->d_z of the active rows; spin_field_encode_back() then adds to d_table
 * and d_means. */
void spin_field_decode_back(struct spin_field_eval *eval, const struct spin_field *field,
                            const float SPIN_DEV *heads, const struct spin_frame_batch *frames,
                            float SPIN_DEV *d_heads);
void spin_field_encode_back(struct spin_field_eval *eval, const struct spin_field *field,
                            const float SPIN_DEV *table, const struct spin_frame_batch *frames,
                            float SPIN_DEV *d_table);

/* Returns a batch of one frame, with n splats and time t, that has no memory for gradients. */
struct spin_frame_batch spin_one_frame(size_t n, const float SPIN_DEV *means, float t,
                                       const float SPIN_DEV *residual);

/* Both functions work in host memory. spin_attr_to_splats() converts raw and activated attributes
 * [n][width] to the columns of *splats that are not NULL; n and sh_degree of *splats must be set.
 * spin_attr_from_splats() converts all columns of *splats but the means to activated attributes
 * [n][SPIN_ATTR]. */
void spin_attr_to_splats(const float *raw, const float *attr, size_t width,
                         struct spin_splats *splats);
void spin_attr_from_splats(const struct spin_splats *splats, float *attr);
