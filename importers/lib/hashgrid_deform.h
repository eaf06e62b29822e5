/* What Grid4D and DASH share: hash grids with their tables, the pair of dicts they are saved in,
 * the two folders of a model, and the numbers that only cfg_args has. */
#ifndef SPIN_IMPORTERS_LIB_HASHGRID_DEFORM_H
#define SPIN_IMPORTERS_LIB_HASHGRID_DEFORM_H

#include "importers/lib/mlp_eval.h"
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
    size_t n;
    struct spin_splats canonical;
    float *extra; /* [n] one more property of the cloud, or NULL */
    double bound, scale_xyz[3];
    struct mlp_linear grid_mlp[HASH_MAX_DEPTH];
    int depth, width;
    struct mlp_linear warp, rotation, scaling;
    struct mlp_team team;
};

void spin_hash_grid_free(struct hash_grid *grid);

void spin_hash_model_free(struct hash_model *m);

/* `key` is a tensor's name, found in the first bytes of a checkpoint of this method only; `option`
 * is how the options of its grid begin, in cfg_args. The folders of a model are the same for all
 * descendants of Deformable-3D-Gaussians. */
int spin_hash_probe(const struct spin_peek *peek, const char *key, const char *option);

struct hash_files {
    char *model, *name;   /* folder, iteration_<N> */
    char *cloud, *deform; /* files */
};

void spin_hash_files_free(struct hash_files *f);

spin_status spin_hash_find(const char *path, const char *wanted, struct hash_files *f);

/* bound and scale_xyz, of which the tensors say nothing; options win over cfg_args. */
spin_status spin_hash_settings(const struct cfg_args *cfg, const struct spin_plugin_values *values,
                               struct hash_model *m, struct spin_sequence_info *sequence);

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

/* Scale and quaternion with their residuals, added after the activation and not normalised, as the
 * ellipsoid that the method's rasteriser makes of them. */
void spin_hash_finish(const float log_scale[3], const float quat[4], const float *d_scale,
                      const float *d_quat, float *out_log_scale, float *out_quat);

/* What never moves: opacities and colours. */
void spin_hash_copy_still(const struct hash_model *m, unsigned columns, struct spin_splats *out);

void spin_hash_describe(struct hash_model *m, const char *method,
                        struct spin_sequence_info *sequence);

#endif
