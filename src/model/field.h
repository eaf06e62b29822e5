/* The implicit network: hash-grid table and four heads, their first values, and decoding a frame.
 * (x, y, z, t) -> scale, rotation, SH colour, opacity of every splat (method.md section 3). */
#ifndef SPIN_MODEL_FIELD_H
#define SPIN_MODEL_FIELD_H

#include "device/device.h"
#include "io/json.h"
#include "io/npy.h"

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
 * uniform(+-1/sqrt(fan_in)), last biases as method.md 3.4 with this scale bias. Host arrays. */
void spin_field_init(const struct spin_field *field, uint64_t seed, double range,
                     double init_log_scale, float *table, float *heads);

/* First values of a run in which the degrees of SH join one after the other: the colour head says 0 for
 * every coefficient but the first, as 3DGS begins. They have no gradient, and stay, until they join. */
void spin_field_clear_sh(const struct spin_field *field, float *heads);
/* First values of a network that adds to what splats have of their own: nothing, at first. */
void spin_field_clear_heads(const struct spin_field *field, float *heads);

/* t of a frame in 0..1 (method.md 3.2). */
float spin_field_time(const struct spin_field *field, double time);

/* The "network" object of meta.json, and back; from a file everything is checked. */
spin_json *spin_field_to_json(const struct spin_field *field);
spin_status spin_field_from_json(const spin_json *json, struct spin_field *out);

/* Buffers for one frame on its way through the network, for up to `capacity` splats. */
struct spin_field_eval {
    struct spin_device *device;
    size_t capacity;
    bool training;
    float *x_u;     /* [n][4] */
    float *z;       /* [n][n_in] */
    float *raw;     /* [n][SPIN_ATTR] */
    float *attr;    /* [n][SPIN_ATTR] */
    float *d_attr;  /* [n][SPIN_ATTR]   (training) */
    float *d_raw;   /* [n_rows][SPIN_ATTR] */
    float *d_z;     /* [n_rows][n_in] */
    float *d_x_u;   /* [n_rows][4] */
    uint32_t *rows; /* [n_rows] */

    const struct spin_lazy_adam *lazy; /* NULL, or the table is lazy and these are its moments */
    float *m, *v;
    bool still;               /* positions are not trained: d_pos_w gets nothing from the encoder */
    float d_scale, d_opacity; /* of the loss by any scale and opacity of a splat that is seen */
};
size_t spin_field_eval_bytes(const struct spin_field *field, size_t capacity, bool training);
spin_status spin_field_eval_open(struct spin_field_eval *decode, struct spin_device *device,
                                 const struct spin_field *field, size_t capacity, bool training);
void spin_field_eval_close(struct spin_field_eval *decode, const struct spin_field *field);

/* attr = network(pos_w, t) + own; own [SPIN_RESIDUAL n] or NULL. Of a lazy table, the lines that are needed
 * are brought up to date. */
void spin_field_forward(struct spin_field_eval *decode, const struct spin_field *field,
                        float *table, const float *heads, size_t n, const float *pos_w, float t,
                        const float *residual);
/* From d_attr and the d_pos_w gathered so far: d_table +=, d_heads +=, d_pos_w +=, d_residual += (or NULL).
 * Splats without any gradient are skipped, which changes nothing: theirs is exactly zero. */
void spin_field_backward(struct spin_field_eval *decode, const struct spin_field *field,
                         const float *table, const float *heads, size_t n, const float *pos_w,
                         float *d_table, float *d_heads, float *d_pos_w, float *d_residual);

/* Rows of raw and finished attributes -> columns of a struct spin_splats, and columns -> finished rows
 * (host memory; n and sh_degree of the splats count). */
void spin_attr_to_splats(const float *raw, const float *attr, struct spin_splats *splats);
void spin_attr_from_splats(const struct spin_splats *splats, float *attr);

#endif
