/* What Grid4D and DASH share: hash grids with their tables, the pair of dicts they are saved in,
 * the two folders of a model, and the numbers that only cfg_args has. */
#ifndef SPIN_IMPORTERS_LIB_HASHGRID_DEFORM_H
#define SPIN_IMPORTERS_LIB_HASHGRID_DEFORM_H

#include "importers/lib/deform.h"

enum { HASH_MAX_LEVELS = 64 };

struct hash_level {
    float scale[4];
    uint32_t res[4], rows;
    int hashed;
    const float *table; /* [rows][n_features] */
};

struct hash_grid {
    int n_dims, n_levels, n_features; /* per level */
    struct hash_level level[HASH_MAX_LEVELS];
};

/* What both methods have of a model. */
struct hash_model {
    struct spin_model base;
    const struct hash_method *method;
    const char *save; /* iteration_<N> */
    float *extra;     /* [n] one more property of the cloud, or NULL */
    double bound, scale_xyz[3];
    const struct spin_value *grid, *network; /* the pair that was saved, while it is read */
    struct mlp_net trunk;                    /* a layer of the method's before it, or none */
    int width;
    struct mlp_net warp, rotation, scaling;
    size_t layer;     /* floats of the widest layer of a block */
    size_t n_scratch; /* floats that a block needs */
};

/* `key` is a tensor's name, found in the first bytes of a checkpoint of this method only; `option`
 * is how the options of its grid begin, in cfg_args. The folders of a model are the same for all
 * descendants of Deformable-3D-Gaussians. */
int spin_hash_probe(const struct spin_peek *peek, const char *key, const char *option);

/* What is each method's own. */
struct hash_method {
    const char *name;              /* "Grid4D" */
    const char *extra;             /* a property of the cloud besides, or NULL */
    const char *key;               /* a tensor of the grid of this method only, */
    const char *other_key, *other; /* and one of another method, with what to do then */
    /* The networks, also layer and n_scratch; m is the importer's struct hash_model. */
    spin_status (*load)(struct hash_model *m);
    /* Settings besides bound and scale_xyz, or NULL. */
    spin_status (*settle)(struct hash_model *m);
};

/* Opens the model's folder, or one of its deform.pth. bound and scale_xyz, of which the tensors say nothing, come
 * from options or cfg_args. */
spin_status spin_hash_open(struct hash_model *m, const char *path,
                           const struct hash_method *method);

/* The encoder `name`, of n_dims inputs. */
spin_status spin_hash_load_grid(struct hash_model *m, const char *name, int n_dims,
                                struct hash_grid *grid);

/* The layers behind the encoder, grid_mlp.0, .2, ... of `width` and the heads; later tensors are those of the
 * network. */
spin_status spin_hash_load_heads(struct hash_model *m, int width, int n_warp);

/* All levels at x, into one column of a block [levels x features][MLP_BLOCK]. A point with any
 * coordinate outside [0, 1] has no features. */
void spin_hash_sample(const struct hash_grid *grid, const float *x, float *out);

/* Space and time as the encoders take them: [-bound, bound] to [0, 1], time to 0.05 .. 0.95. In
 * floats and in this order, as the method. */
void spin_hash_coordinates(const struct hash_model *m, const float p[3], float time, float out[4]);

#endif
