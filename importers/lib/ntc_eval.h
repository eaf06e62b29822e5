/* The network of one frame of 3DGStream, the file NTC.pth: functions that read the file and
 * evaluate the network at points.
 *
 * Parameters, features and activations are rounded to half precision as in tiny-cuda-nn
 * (NVlabs/tiny-cuda-nn 6ee3546); sums are computed in float. Results differ from those of a GPU by
 * no more than the results of two GPUs differ from each other. */
#pragma once

#include "importers/lib/mlp_eval.h"
#include "math/ntc.h"

enum { NTC_MAX_LEVELS = 32, NTC_MAX_WIDTH = 256, NTC_MAX_LAYERS = 16, NTC_IN = 3, NTC_OUT = 8 };

/* Shape of the network, from its configuration: `base` is the resolution of level 0 of the hash
 * grid, `growth` the factor between levels, and `width` the number of neurons of each of the
 * n_hidden layers. If n_levels is 0, there is no hash grid: the inputs of the network are then the
 * three coordinates. */
struct ntc_shape {
    int n_levels, n_features, log2_entries, base;
    float growth;
    int width, n_hidden;
    struct spin_ntc_level level[NTC_MAX_LEVELS];
    size_t level_at[NTC_MAX_LEVELS]; /* index of the first parameter of each level */
    int n_in; /* number of inputs of the first matrix, padded to a multiple of 16 */
    size_t n_parameters;
};

/* The network of one frame. */
struct ntc {
    const struct ntc_shape *shape;
    float low[3], high[3]; /* bounding box in which the network is defined */
    float *parameters;     /* in the order of the file, rounded to half precision */
    struct mlp_net net;    /* its layers point into `parameters` */
};

/* Sets *s to the configuration that 3DGStream ships: 16 levels of 4 features and at most 2^15
 * entries. */
void spin_ntc_default_shape(struct ntc_shape *s);

/* Computes the levels, the offsets of their parameters, n_in and n_parameters from the other
 * members of *s. */
spin_status spin_ntc_layout(struct ntc_shape *s);

spin_status spin_ntc_open_config(const char *path, struct ntc_shape *s);

void spin_ntc_free(struct ntc *n);

/* Reads NTC.pth. On failure, there is nothing to free. */
spin_status spin_ntc_open(const char *path, const struct ntc_shape *shape, struct ntc *n);

/* Encodes a point of the unit cube into a column of a block [n_in][MLP_BLOCK], the input of the
 * network. As in tiny-cuda-nn, unused channels at the end are 0 if there is a hash grid,
 * otherwise 1. */
void spin_ntc_encode(const struct ntc *n, const float x[3], float *out);

/* Moves `count` Gaussians, at most MLP_BLOCK, from the previous frame to this one. For a Gaussian
 * with mean mu and quaternion q, the network yields an offset d and a quaternion r: the new mean is
 * mu + d, the new rotation unit(q) * unit(r). A Gaussian outside the bounding box keeps its mean,
 * and its quaternion is only normalised. SH are not rotated: upstream computes rotated SH but
 * discards them. `scratch` has three times spin_mlp_widest() floats. */
void spin_ntc_apply(const struct ntc *n, int count, float *means, float *quats, float *scratch);
