/* The network of 4DGaussians (hustvl/4DGaussians 843d5ac), which MoDec-GS also uses. It consists of
 * feature planes (HexPlane), one per scale and pair of the axes x, y, z, t; of a small MLP that
 * receives the features of all planes; and of heads. */
#pragma once

#include "importers/lib/model.h"

enum {
    HEX_MAX_SCALES = 16,
    HEX_MAX_CHANNELS = 256,
    HEX_MAX_SIZE = 1 << 15, /* largest number of samples along an axis */
    HEX_VOXELS = 64         /* number of voxels of empty_voxel along an axis */
};

struct hexplane {
    int n_scales, channels;
    int size[HEX_MAX_SCALES][4];     /* number of samples along x, y, z, t */
    float *plane[HEX_MAX_SCALES][6]; /* [rows][columns][channels] */
    /* [2][3] Two opposite corners of the bounding box: the first is mapped to -1, the second to 1.
     * The method stores the maximum of the box as the first. */
    float *corner;
    double grid_pe; /* factor on features before their sines and cosines are computed; 0: features
                       are not encoded */
    struct mlp_net feature; /* the network feature_out */
    int width;              /* number of outputs of `feature` and of inputs of each head */
    /* The source of the factors `mask` of spin_hex_hidden(): either the network static_mlp, which
     * is `still`, or the grid empty_voxel, which is `voxels` [x][y][z]. If the model has neither
     * network nor grid, still.n is 0, `voxels` is NULL and the factors are 1. */
    struct mlp_net still;
    float *voxels;
    float *voxel_min, *voxel_max; /* [3] bounding box of `voxels` */
};

/* Searches m->tensors for the network, and sets m->prefix to the prefix of the names of its
 * tensors, which depends on the program that wrote the file. Returns false if there is no network.
 */
bool spin_hex_find(struct spin_model *m);

/* Loads everything except the heads, which spin_model_head() loads. `grid_pe` is the setting of the
 * training, or 0 if it is unknown. */
spin_status spin_hex_load(struct spin_model *m, double grid_pe, struct hexplane *hex);

/* Returns the number of floats of scratch memory for one call of spin_hex_hidden(): two layers of a
 * block. */
size_t spin_hex_scratch(const struct hexplane *hex);

/* Computes the hidden layer [width][MLP_BLOCK] of n points xyz [n][3], including the ReLU that is
 * the first operation of every head. `scratch` has spin_hex_scratch() floats, enough for two
 * layers: the function returns the layer that contains the result and sets *spare to the other
 * layer. mask[p] is set to the factor by which the caller multiplies the canonical values of point
 * p; it is 1 in most models. */
float *spin_hex_hidden(const struct hexplane *hex, const float *xyz, int n, float time,
                       float *scratch, float **spare, float mask[MLP_BLOCK]);
