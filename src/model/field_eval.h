/* Forward and backward pass of the network over the splats of frames, and the buffers that they
 * need: (x, y, z, t) -> scale, rotation, SH colour, opacity (docs/method.md section 3). */
#pragma once

#include "model/field.h"

/* Buffers for up to `capacity` splats on their way through the network. field NULL below: for
 * explicit values without a network. */
struct spin_field_eval {
    struct spin_device *device;
    size_t capacity;
    bool training;
    float SPIN_DEV *x_u;       /* [n][4] */
    float SPIN_DEV *z;         /* [n][n_in] */
    bool narrow;               /* as the frames must be */
    float SPIN_DEV *raw;       /* [n][SPIN_ATTR, or narrow] */
    float SPIN_DEV *attr;      /* as raw */
    float SPIN_DEV *d_attr;    /* as raw   (training) */
    float SPIN_DEV *d_raw;     /* [active], as raw */
    float SPIN_DEV *d_z;       /* [active][n_in] */
    float SPIN_DEV *d_x_u;     /* [active][4] */
    struct spin_active active; /* rows that have a gradient, of the last backward pass */

    struct spin_lazy_adam *lazy; /* of the table, or NULL */
    bool still; /* positions are not trained: d_means gets nothing from the encoder */
};
/* sh: frames may have SH beyond the first coefficient, without a network. */
spin_status spin_field_eval_open(struct spin_field_eval *eval, struct spin_device *device,
                                 const struct spin_field *field, bool sh, size_t capacity,
                                 bool training);
void spin_field_eval_close(struct spin_field_eval *eval, const struct spin_field *field);

/* attr = network(means, t) + residual, of all frames. field NULL: there is no network and attr is
 * the residual values alone, at SH degree 0. Of a table with lazy Adam, the lines that are needed
 * are brought up to date. */
void spin_field_forward(struct spin_field_eval *eval, const struct spin_field *field,
                        const float SPIN_DEV *table, const float SPIN_DEV *heads,
                        const struct spin_frame_batch *frames);
/* The same in two halves: z = encode(means, t) of this field's levels; then from z what is left. */
void spin_field_encode(struct spin_field_eval *eval, const struct spin_field *field,
                       const float SPIN_DEV *table, const struct spin_frame_batch *frames);
void spin_field_decode(struct spin_field_eval *eval, const struct spin_field *field,
                       const float SPIN_DEV *heads, const struct spin_frame_batch *frames);
/* From d_attr and the d_means gathered so far: d_table +=, d_heads +=, d_means +=, d_residual +=.
 * Without a network only d_residual.
 * Splats without any gradient are skipped, which changes nothing: theirs is exactly zero. */
void spin_field_backward(struct spin_field_eval *eval, const struct spin_field *field,
                         const float SPIN_DEV *table, const float SPIN_DEV *heads,
                         const struct spin_frame_batch *frames, float SPIN_DEV *d_table,
                         float SPIN_DEV *d_heads);

/* The same in two halves: to d_z of the active rows; then from there to the table and the
 * positions. */
void spin_field_decode_back(struct spin_field_eval *eval, const struct spin_field *field,
                            const float SPIN_DEV *heads, const struct spin_frame_batch *frames,
                            float SPIN_DEV *d_heads);
void spin_field_encode_back(struct spin_field_eval *eval, const struct spin_field *field,
                            const float SPIN_DEV *table, const struct spin_frame_batch *frames,
                            float SPIN_DEV *d_table);

/* A batch of one frame. Nothing in it has a gradient. */
struct spin_frame_batch spin_one_frame(size_t n, const float SPIN_DEV *means, float t,
                                       const float SPIN_DEV *residual);

/* Rows of raw and finished attributes -> columns of a struct spin_splats, and columns -> finished
 * rows (host memory; n and sh_degree of the splats count). */
void spin_attr_to_splats(const float *raw, const float *attr, size_t width,
                         struct spin_splats *splats);
void spin_attr_from_splats(const struct spin_splats *splats, float *attr);
