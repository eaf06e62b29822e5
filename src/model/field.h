/* The network: layout of the hash-grid table and of the four heads, and their initial values. It
 * maps (x, y, z, t) to scale, rotation, SH colour and opacity of a splat (docs/method.md section
 * 3). */
#pragma once

#include "device/device.h"
#include "io/json.h"

struct spin_field {
    struct spin_grid grid;
    struct spin_heads heads;
    struct spin_scene_transform transform;
    double time_first, time_last; /* first and last time of the clip, in the source's unit */
    int sh_degree;
    bool antialias;          /* splats are rendered with antialiasing */
    size_t n_table, n_heads; /* floats of the table and of the heads */
};

/* Derives the layout from the options. finest[3] must be resolved (not 0). SPIN_E_USAGE if an
 * option is out of range. */
spin_status spin_field_plan(struct spin_field *field, int levels, int features, int hash_log2,
                            int hidden, int sh_degree, const int base[4], const int finest[4]);

/* Initial values, which depend on the seed only: table uniform(-range, range), Linear layers
 * uniform(+-1/sqrt(fan_in)), last biases as in docs/method.md 3.4 with init_log_scale as the bias
 * of the scale. Host arrays. */
void spin_field_init(const struct spin_field *field, uint64_t seed, double range,
                     double init_log_scale, float *table, float *heads);

/* Clears the rows of the colour head for SH coefficients beyond the first, for trainings that add
 * SH degrees one by one, as 3DGS does. Without a gradient they stay 0 until their degree is
 * added. */
void spin_field_clear_sh(const struct spin_field *field, float *heads);
/* Clears the last layer of all heads: the network then adds nothing to the splats' own values. */
void spin_field_clear_heads(const struct spin_field *field, float *heads);

/* Maps a frame's time to t in 0..1 (docs/method.md 3.2). */
float spin_field_time(const struct spin_field *field, double time);

/* Writes and reads the first members of the "trained" object of meta.json; reading checks all
 * values. there: the training has a network; otherwise "field" is null and only sh_degree and
 * antialias are set. */
spin_json *spin_field_to_json(const struct spin_field *field, bool there);
spin_status spin_field_from_json(const spin_json *trained, struct spin_field *out, bool *there);
