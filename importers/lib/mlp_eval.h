/* Small networks of other methods, evaluated for blocks of points.
 *
 * The activations of a block are stored by channel, [channel][MLP_BLOCK]: inner loops run over
 * points, so a layer of any width consists of broadcasts of weights and multiply-adds. */
#pragma once

#include "spin.h"

enum {
    MLP_BLOCK = 32, /* points in a block */
    MLP_MAX_WIDTH = 8192,
    MLP_MAX_LAYERS = 34
};

#define MLP_INLINE static inline __attribute__((always_inline, unused))

/* Activation after a layer: none, ReLU, or leaky ReLU of slope 0.01. */
enum mlp_ending { MLP_PLAIN, MLP_RELU, MLP_LEAKY };

/* A layer y = W x + b, followed by the activation `ending`. */
struct mlp_layer {
    int n_in, n_out;
    enum mlp_ending ending;
    const float *weight; /* [n_out][n_in] */
    const float *bias;   /* [n_out]; NULL: none */
};

/* A network of n layers; n is 0 if there is no network. */
struct mlp_net {
    int n;
    int again; /* index of a layer with a skip connection, whose input is the network's input
                  followed by the previous layer's output; 0: there is no such layer */
    bool half; /* if true, the output of each layer is rounded to half precision */
    struct mlp_layer layer[MLP_MAX_LAYERS];
};

/* spin_mlp_n_out() returns the number of outputs of the last layer. spin_mlp_widest() returns the
 * number of floats that a block of points needs in the widest layer, inputs included. */
int spin_mlp_n_out(const struct mlp_net *net);
size_t spin_mlp_widest(const struct mlp_net *net);

/* Runs all layers over a block, writing results to a and b in turn, and returns a or b, whichever
 * contains the last result. The first result is written to a or, if `in` is a, to b. `in` may be a
 * or b; otherwise `in` is not changed. b may be NULL for a single layer if `in` is not a. For a
 * network with a skip connection (`again`), `in` must be neither a nor b, and must have space for
 * one layer's output behind the input. */
float *spin_mlp_run(const struct mlp_net *net, float *in, float *a, float *b);

/* A function that evaluates the points `first` to `first` + n - 1, where n is at most MLP_BLOCK.
 * `scratch` is memory that no other thread uses. */
typedef void (*mlp_block_fn)(void *context, size_t first, int n, float *scratch);

/* Threads that evaluate blocks of points. */
struct mlp_team {
    struct spin_pool *pool;
    float *scratch; /* [threads][each] */
    size_t each;    /* number of floats of scratch memory of each thread */
    /* The arguments of the current call of spin_mlp_team_run(). */
    mlp_block_fn fn;
    void *context;
    size_t n_points;
};

void spin_mlp_team_free(struct mlp_team *team);

/* Starts the threads, each with n_scratch floats of scratch memory. */
spin_status spin_mlp_team_create(size_t n_scratch, struct mlp_team *team);

/* Splits n_points points, at most 2^31, into blocks, and calls fn once for each block, on all
 * threads. */
void spin_mlp_team_run(struct mlp_team *team, size_t n_points, mlp_block_fn fn, void *context);
