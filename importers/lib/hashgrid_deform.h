/* What Grid4D and DASH share: hash grids with their tables, the pair of dicts they are saved in,
 * the two folders of a model, and the numbers that only cfg_args has. */
#ifndef SPIN_IMPORTERS_LIB_HASHGRID_DEFORM_H
#define SPIN_IMPORTERS_LIB_HASHGRID_DEFORM_H

#include "importers/lib/deform.h"
#include "importers/lib/model_folder.h"

enum { HASH_MAX_LEVELS = 64, HASH_MAX_DEPTH = 16 };

struct hash_level {
    float scale[4];
    uint32_t res[4], rows;
    int hashed;
    const float *table; /* [rows][n_features] */
};

struct hash_grid {
    int n_dims, n_levels, n_features; /* per level */
    struct hash_level level[HASH_MAX_LEVELS];
    float *table;
};

/* What both methods have of a model. */
struct hash_model {
    char *path; /* of deform.pth */
    char *save; /* iteration_<N> */
    struct spin_splats canonical;
    float *extra; /* [n] one more property of the cloud, or NULL */
    double bound, scale_xyz[3];
    struct mlp_linear grid_mlp[HASH_MAX_DEPTH];
    int depth, width;
    struct mlp_linear warp, rotation, scaling;
    size_t layer;     /* floats of the widest layer of a block */
    size_t n_scratch; /* floats that a block needs */
    struct mlp_team team;
};

void spin_hash_grid_free(struct hash_grid *grid);

void spin_hash_model_free(struct hash_model *m);

/* `key` is a tensor's name, found in the first bytes of a checkpoint of this method only; `option`
 * is how the options of its grid begin, in cfg_args. The folders of a model are the same for all
 * descendants of Deformable-3D-Gaussians. */
int spin_hash_probe(const struct spin_peek *peek, const char *key, const char *option);

/* What is each method's own. */
struct hash_method {
    const char *name;  /* "Grid4D" */
    const char *extra; /* a property of the cloud besides, or NULL */
    /* The networks, also layer and n_scratch; the struct hash_model begins the importer's. */
    spin_status (*load)(struct spin_torch *torch, struct hash_model *m);
    /* Settings besides bound and scale_xyz, or NULL. */
    spin_status (*settle)(const struct cfg_args *cfg, const struct spin_plugin_values *values,
                          struct hash_model *m, struct spin_sequence_info *sequence);
};

/* Opens the model's folder, or one of its deform.pth; *m is zero before and is to be freed, also after a
 * failure. bound and scale_xyz, of which the tensors say nothing, come from options or cfg_args. */
spin_status spin_hash_open(const char *path, const struct spin_plugin_values *values,
                           const struct hash_method *method, struct hash_model *m,
                           struct spin_sequence_info *sequence);

/* As an importer's frame(). */
spin_status spin_hash_frame(struct hash_model *m, double time, unsigned columns, mlp_block_fn fn,
                            struct spin_splats *out);

/* The encoder `name`, of n_dims inputs. */
spin_status spin_hash_load_grid(struct spin_torch *torch, const struct spin_value *dict,
                                const char *name, int n_dims, struct hash_grid *grid);

/* The layers behind the encoder: grid_mlp.0, .2, ... and the heads; `width` is what goes in. */
spin_status spin_hash_load_heads(struct spin_torch *torch, const struct spin_value *dict, int width,
                                 int n_warp, struct hash_model *m);

/* The pair (grid, network) that was saved; `key` is in the grid of this method only, `other_key`
 * in that of the `other`. */
struct hash_pair {
    const struct spin_value *grid, *network;
};

spin_status spin_hash_split(const struct spin_value *root, const char *key, const char *other_key,
                            const char *other, struct hash_pair *out);

/* All levels at x, into one column of a block [levels x features][MLP_BLOCK]. A point with any
 * coordinate outside [0, 1] has no features. */
void spin_hash_sample(const struct hash_grid *grid, const float *x, float *out);

/* Space and time as the encoders take them: [-bound, bound] to [0, 1], time to 0.05 .. 0.95. In
 * floats and in this order, as the method. */
void spin_hash_coordinates(const struct hash_model *m, const float p[3], float time, float out[4]);

/* grid_mlp over a block in `a`; `b` is as large. Returns which of both the result is in. */
const float *spin_hash_layers(const struct hash_model *m, float *a, float *b);

#endif
