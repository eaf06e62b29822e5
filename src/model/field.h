/* The implicit network: layout of the hash-grid table and the four heads, their initial values.
 * (x, y, z, t) -> scale, rotation, SH colour, opacity of every splat (docs/method.md section 3). */
#pragma once

#include "device/device.h"
#include "io/json.h"

struct spin_field {
    struct spin_grid grid;
    struct spin_heads heads;
    struct spin_scene_transform transform;
    double time_first, time_last; /* of the clip, in the source's unit */
    int sh_degree;
    bool antialias;          /* its splats are meant to be drawn antialiased */
    size_t n_table, n_heads; /* floats */
};

/* Geometry from the options. finest[3] must be resolved (not 0). SPIN_E_USAGE when impossible. */
spin_status spin_field_plan(struct spin_field *field, int levels, int features, int hash_log2,
                            int hidden, int sh_degree, const int base[4], const int finest[4]);

/* First values, a function of the seed alone: table uniform(-range, range), Linear layers
 * uniform(+-1/sqrt(fan_in)), last biases as docs/method.md 3.4 with this scale bias. Host arrays.
 */
void spin_field_init(const struct spin_field *field, uint64_t seed, double range,
                     double init_log_scale, float *table, float *heads);

/* First values of a run in which the degrees of SH join one after the other: the colour head says 0
 * for every coefficient but the first, as 3DGS begins. They have no gradient, and stay, until they
 * join. */
void spin_field_clear_sh(const struct spin_field *field, float *heads);
/* First values of a network that adds to what splats have of their own: nothing, at first. */
void spin_field_clear_heads(const struct spin_field *field, float *heads);

/* t of a frame in 0..1 (docs/method.md 3.2). */
float spin_field_time(const struct spin_field *field, double time);

/* The begin of the "trained" object of meta.json, and back; from a file everything is checked.
 * there: there is a network, else "field" is null and sh_degree and antialias are all that is set.
 */
spin_json *spin_field_to_json(const struct spin_field *field, bool there);
spin_status spin_field_from_json(const spin_json *trained, struct spin_field *out, bool *there);
