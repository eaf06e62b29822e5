/* The network of 4DGaussians, which MoDec-GS shares: six feature planes per scale over pairs of x,
 * y, z, t (HexPlane), a small MLP behind them, and heads (hustvl/4DGaussians 843d5ac). */
#pragma once

#include "importers/lib/model.h"

enum {
    HEX_MAX_SCALES = 16,
    HEX_MAX_CHANNELS = 256,
    HEX_MAX_SIZE = 1 << 15, /* samples along an axis */
    HEX_VOXELS = 64
};

struct hexplane {
    int n_scales, channels;
    int size[HEX_MAX_SCALES][4];     /* samples along x, y, z, t */
    float *plane[HEX_MAX_SCALES][6]; /* [rows][columns][channels] */
    float *corner;  /* [2][3] points mapped to -1 and to 1; the method stores the maximum first */
    double grid_pe; /* 0: features are not encoded */
    struct mlp_net feature;
    int width;
    struct mlp_net still;         /* static_mlp; n is 0 without one */
    float *voxels;                /* empty_voxel [x][y][z], or NULL */
    float *voxel_min, *voxel_max; /* [3] */
};

/* Finds the network among the tensors and sets m->prefix, which differs between derived tools.
 * Returns false if there is none. */
bool spin_hex_find(struct spin_model *m);

/* Loads everything except the heads, which spin_model_head() loads. grid_pe is 0 if unknown. */
spin_status spin_hex_load(struct spin_model *m, double grid_pe, struct hexplane *hex);

/* Number of floats of scratch memory for a block: two layers. */
size_t spin_hex_scratch(const struct hexplane *hex);

/* Computes the hidden layer [width][MLP_BLOCK] of n points xyz [n][3], including the ReLU that is
 * the first operation of every head. scratch has spin_hex_scratch() floats: the result is one of
 * its two layers, *spare the other. mask is set to the factor on each point's canonical values, 1
 * in most models. */
float *spin_hex_hidden(const struct hexplane *hex, const float *xyz, int n, float time,
                       float *scratch, float **spare, float mask[MLP_BLOCK]);
