/* Forward and backward pass of the network over the splats of frames, and their buffers. It maps
 * (x, y, z, t) to scale, rotation, SH colour and opacity (docs/method.md section 3). */
#pragma once

#include "model/field.h"

/* Buffers for up to `capacity` splats. In all calls, field NULL means that the attributes are
 * stored values and there is no network. */
struct spin_field_eval {
    struct spin_device *device;
    size_t capacity;
    bool training;
    float SPIN_DEV *x_u;       /* [n][4] */
    float SPIN_DEV *z;         /* [n][n_in] */
    bool narrow;               /* rows are narrow; must equal `narrow` of the frames */
    float SPIN_DEV *raw;       /* [n][SPIN_ATTR, or narrow] */
    float SPIN_DEV *attr;      /* same shape as raw */
    float SPIN_DEV *d_attr;    /* same shape as raw; d_attr to active: in training only */
    float SPIN_DEV *d_raw;     /* [active][SPIN_ATTR, or narrow] */
    float SPIN_DEV *d_z;       /* [active][n_in] */
    float SPIN_DEV *d_x_u;     /* [active][4] */
    struct spin_active active; /* rows with a gradient in the last backward pass */

    struct spin_lazy_adam *lazy; /* lazy Adam of the table, or NULL */
    bool still; /* positions are not trained: the encoder adds nothing to d_means */
};
/* sh: without a network, frames may have SH coefficients beyond the first. */
spin_status spin_field_eval_open(struct spin_field_eval *eval, struct spin_device *device,
                                 const struct spin_field *field, bool sh, size_t capacity,
                                 bool training);
void spin_field_eval_close(struct spin_field_eval *eval, const struct spin_field *field);

/* attr = network(means, t) + residual, for all frames. Without a network attr is the residual
 * alone, at SH degree 0. Lazy Adam updates the lines of the table that are read. */
void spin_field_forward(struct spin_field_eval *eval, const struct spin_field *field,
                        const float SPIN_DEV *table, const float SPIN_DEV *heads,
                        const struct spin_frame_batch *frames);
/* The same in two halves: z = encode(means, t); then attr from z. */
void spin_field_encode(struct spin_field_eval *eval, const struct spin_field *field,
                       const float SPIN_DEV *table, const struct spin_frame_batch *frames);
void spin_field_decode(struct spin_field_eval *eval, const struct spin_field *field,
                       const float SPIN_DEV *heads, const struct spin_frame_batch *frames);
/* From d_attr and the d_means accumulated so far: d_table +=, d_heads +=, d_means +=, d_residual
 * +=. Without a network only d_residual is set. Splats whose gradient is exactly zero are skipped,
 * which does not change the result. */
void spin_field_backward(struct spin_field_eval *eval, const struct spin_field *field,
                         const float SPIN_DEV *table, const float SPIN_DEV *heads,
                         const struct spin_frame_batch *frames, float SPIN_DEV *d_table,
                         float SPIN_DEV *d_heads);

/* The same in two halves: first d_heads, d_residual and, for the active rows, d_z; then d_table and
 * d_means. */
void spin_field_decode_back(struct spin_field_eval *eval, const struct spin_field *field,
                            const float SPIN_DEV *heads, const struct spin_frame_batch *frames,
                            float SPIN_DEV *d_heads);
void spin_field_encode_back(struct spin_field_eval *eval, const struct spin_field *field,
                            const float SPIN_DEV *table, const struct spin_frame_batch *frames,
                            float SPIN_DEV *d_table);

/* A batch of one frame, without gradients. */
struct spin_frame_batch spin_one_frame(size_t n, const float SPIN_DEV *means, float t,
                                       const float SPIN_DEV *residual);

/* Converts rows of raw and activated attributes to columns, and columns to activated rows; in host
 * memory. n and sh_degree of the splats must be set. */
void spin_attr_to_splats(const float *raw, const float *attr, size_t width,
                         struct spin_splats *splats);
void spin_attr_from_splats(const struct spin_splats *splats, float *attr);
