/* The network of 4DGaussians, which MoDec-GS has too: six feature planes per scale over pairs of
 * x, y, z, t (HexPlane), a small MLP behind them, and heads (hustvl/4DGaussians 843d5ac). */
#ifndef SPIN_IMPORTERS_LIB_HEXPLANE_H
#define SPIN_IMPORTERS_LIB_HEXPLANE_H

#include "importers/lib/mlp_eval.h"

enum {
    HEX_MAX_SCALES = 16,
    HEX_MAX_DEPTH = 16,
    HEX_MAX_CHANNELS = 256,
    HEX_MAX_SIZE = 1 << 15, /* samples along an axis */
    HEX_VOXELS = 64
};

struct hexplane {
    int n_scales, channels;
    int size[HEX_MAX_SCALES][4];     /* samples along x, y, z, t */
    float *plane[HEX_MAX_SCALES][6]; /* [rows][columns][channels] */
    float corner[2][3];              /* at -1 and at 1: the method stores the largest first */
    double grid_pe;                  /* 0: the features go in as they are */
    struct mlp_linear feature[HEX_MAX_DEPTH];
    int depth, width;
    struct mlp_linear still[2]; /* static_mlp; n_in == 0: none */
    float *voxels;              /* empty_voxel [x][y][z], or NULL */
    float voxel_min[3], voxel_max[3];
};

struct hex_head {
    struct mlp_linear first, last; /* n_in == 0: there is none */
};

void spin_hex_head_free(struct hex_head *head);

void spin_hex_free(struct hexplane *hex);

/* Derived tools put a word in front of every key. NULL when this is no such network. */
const char *spin_hex_prefix(const struct spin_value *dict);

bool spin_hex_has_head(const struct spin_value *dict, const char *prefix, const char *name);

spin_status spin_hex_load_head(struct spin_torch *torch, const struct spin_value *dict,
                               const char *prefix, const char *name, int width, int n_out,
                               struct hex_head *out);

/* Everything but the heads. grid_pe is 0 where it is not known. */
spin_status spin_hex_load(struct spin_torch *torch, const struct spin_value *dict,
                          const char *prefix, double grid_pe, struct hexplane *hex);

/* Floats of scratch for a block: two layers of it. */
size_t spin_hex_scratch(const struct hexplane *hex);

/* hidden [width][MLP_BLOCK] of n points at xyz [n][3], after the ReLU that every head begins with.
 * scratch: spin_hex_scratch() floats, of which hidden may be the first. */
const float *spin_hex_hidden(const struct hexplane *hex, const float *xyz, int n, float time,
                             float *scratch);

/* The buffer of scratch that does not hold `hidden`. */
float *spin_hex_spare(const struct hexplane *hex, const float *hidden, float *scratch);

/* out [n_out][MLP_BLOCK]. */
void spin_hex_head(const struct hex_head *head, const float *hidden, float *spare, float *out);

/* What a point keeps of its canonical values: 1 in most models. */
void spin_hex_mask(const struct hexplane *hex, const float *xyz, int n, const float *hidden,
                   float *spare, float mask[MLP_BLOCK]);

#endif
