/* Small networks of foreign methods, evaluated for blocks of points.
 *
 * The activations of a block are stored by channel, [channel][MLP_BLOCK]: the loops below go over
 * points, so a layer is a broadcast and a multiply-add whatever its width. */
#pragma once

#include "spin.h"

enum {
    MLP_BLOCK = 32, /* points */
    MLP_MAX_WIDTH = 8192,
    MLP_MAX_LAYERS = 34
};

#define MLP_INLINE static inline __attribute__((always_inline, unused))

/* Activation after a layer: none, ReLU, or leaky ReLU of slope 0.01. */
enum mlp_ending { MLP_PLAIN, MLP_RELU, MLP_LEAKY };

/* y = W x + b */
struct mlp_layer {
    int n_in, n_out;
    enum mlp_ending ending;
    const float *weight; /* [n_out][n_in] */
    const float *bias;   /* [n_out]; NULL: none */
};

/* A network; n is 0 if there is none. */
struct mlp_net {
    int n;
    int again; /* this layer takes the network's input, then the last output; 0: none */
    bool half; /* the output of each layer is rounded to half precision */
    struct mlp_layer layer[MLP_MAX_LAYERS];
};

/* Outputs of the last layer; floats of a block of the widest layer or input. */
int spin_mlp_n_out(const struct mlp_net *net);
size_t spin_mlp_widest(const struct mlp_net *net);

/* Runs all layers over a block, alternating between a and b, and returns the one with the last
 * result. `in` may be a or b, else it is not changed; the first result goes to a unless `in` is a.
 * b may be NULL for a single layer with `in` != a. With `again`, `in` is neither and has space for
 * one layer's output behind it. */
float *spin_mlp_run(const struct mlp_net *net, float *in, float *a, float *b);

/* Evaluates points first .. first + n - 1, n at most MLP_BLOCK; `scratch` is not shared with other
 * threads. */
typedef void (*mlp_block_fn)(void *context, size_t first, int n, float *scratch);

struct mlp_team {
    struct spin_pool *pool;
    float *scratch; /* [threads][each] */
    size_t each;
    mlp_block_fn fn; /* of the running call */
    void *context;
    size_t n_points;
};

void spin_mlp_team_free(struct mlp_team *team);

spin_status spin_mlp_team_create(size_t n_scratch, struct mlp_team *team);

/* Calls fn for all points, at most 2^31 of them, on all threads. */
void spin_mlp_team_run(struct mlp_team *team, size_t n_points, mlp_block_fn fn, void *context);
