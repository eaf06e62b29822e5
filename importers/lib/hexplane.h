/* The network of 4DGaussians, which MoDec-GS has too: six feature planes per scale over pairs of
 * x, y, z, t (HexPlane), a small MLP behind them, and heads (hustvl/4DGaussians 843d5ac). */
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
    float *corner;  /* [2][3] at -1 and at 1: the method stores the largest first */
    double grid_pe; /* 0: the features go in as they are */
    struct mlp_net feature;
    int width;
    struct mlp_net still;         /* static_mlp, or none */
    float *voxels;                /* empty_voxel [x][y][z], or NULL */
    float *voxel_min, *voxel_max; /* [3] */
};

/* Finds the network in the tensors: derived tools put a word in front of every key. False when this
 * is no such network. */
bool spin_hex_find(struct spin_model *m);

/* Everything but the heads, which are spin_model_head(). grid_pe is 0 where it is not known. */
spin_status spin_hex_load(struct spin_model *m, double grid_pe, struct hexplane *hex);

/* Floats of scratch for a block: two layers of it. */
size_t spin_hex_scratch(const struct hexplane *hex);

/* hidden [width][MLP_BLOCK] of n points at xyz [n][3], after the ReLU that every head begins with,
 * in scratch of spin_hex_scratch() floats; *spare is the layer of it that is free. mask: what a
 * point keeps of its canonical values, 1 in most models. */
float *spin_hex_hidden(const struct hexplane *hex, const float *xyz, int n, float time,
                       float *scratch, float **spare, float mask[MLP_BLOCK]);
