/* The network, which maps the position and time (x, y, z, t) of a splat to its scale, rotation, SH
 * colour and opacity (docs/method.md section 3). This file declares the layout and the initial
 * values of its parameters: the table of the hash grid, and the weights and biases of the four
 * heads. */
#pragma once

#include "device/device.h"
#include "io/json.h"

struct spin_field {
    struct spin_grid grid;
    struct spin_heads heads;
    struct spin_scene_transform transform;
    /* Times of the first and the last frame of the clip, in the unit of time of the source. */
    double time_first, time_last;
    int sh_degree;
    bool antialias; /* true if splats are rendered with antialiasing */
    /* Number of parameters of the hash table, and of all heads together. */
    size_t n_table, n_heads;
};

/* Computes the layout from the options of the same names in spin_train.h. base and finest are the
 * resolutions of the first and the last level of the hash grid along x, y, z and t. finest[3] must
 * not be 0: the caller replaces 0 by the number of frames. The scene transform gets centre 0 and
 * radius 1. SPIN_E_USAGE if an option is out of range. */
spin_status spin_field_plan(struct spin_field *field, int levels, int features, int hash_log2,
                            int hidden, int sh_degree, const int base[4], const int finest[4]);

/* Sets table [n_table] and heads [n_heads], in host memory, to initial values. The table is
 * uniformly random in -range to range. Weights and biases of a linear layer with n inputs are
 * uniformly random in -1/sqrt(n) to 1/sqrt(n), except the biases of the last layer of three heads,
 * which are constants: init_log_scale for scale, the identity for rotation, and the logit of 0.1
 * for opacity. The random numbers depend only on the seed. */
void spin_field_init(const struct spin_field *field, uint64_t seed, double range,
                     double init_log_scale, float *table, float *heads);

/* Zeroes the weights and biases of the colour head that compute SH coefficients beyond the first,
 * for trainings that start with SH degree 0 and raise it step by step, as 3DGS does. Since
 * coefficients above the current degree have no gradient, they stay 0 until the training reaches
 * their degree. */
void spin_field_clear_sh(const struct spin_field *field, float *heads);
/* Zeroes the last layer of all heads. The output of the network, which is added to the residuals of
 * the splats, is then 0 at the start of the training. */
void spin_field_clear_heads(const struct spin_field *field, float *heads);

/* Maps the time of a frame, in the unit of the source, to the network's t in 0..1
 * (docs/method.md 3.2). */
float spin_field_time(const struct spin_field *field, double time);

/* spin_field_to_json() returns a new object "trained" for meta.json, with the members "field",
 * "sh_degree" and "antialias"; "field" is null if `there` is false, that is, without a network.
 * spin_field_from_json() reads and checks this object. It sets *there to whether a network exists;
 * if none does, it sets only sh_degree and antialias of *out, and zeroes all other members. */
spin_json *spin_field_to_json(const struct spin_field *field, bool there);
spin_status spin_field_from_json(const spin_json *trained, struct spin_field *out, bool *there);

/* ---- Residuals ------------------------------------------------------------------------------- */

/* Residual values of splats in host memory have two layouts. In rows, each splat has SPIN_RESIDUAL
 * consecutive floats: 3 of log scale, 4 of rotation, 3 of colour, 1 of logit opacity. The device
 * stores four consecutive groups instead, one for each attribute, [n][3] [n][4] [n][3] [n], because
 * each attribute has its own learning rate. */

/* Number of floats per splat in each group: 3, 4, 3 and 1, in the order of the heads of the
 * network. */
extern const size_t spin_residual_width[SPIN_HEADS];

/* Copies the values of n splats from rows to groups, or from groups to rows. Consecutive rows begin
 * `stride` floats apart. Splat i of the groups corresponds to row row_of[i] or, if row_of is NULL,
 * to row i. */
void spin_residual_from_rows(size_t n, const float *rows, size_t stride, const uint32_t *row_of,
                             float *groups);
void spin_residual_to_rows(size_t n, const float *groups, const uint32_t *row_of, float *rows,
                           size_t stride);
