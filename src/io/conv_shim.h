/* What conv.c and the shared object behind it agree on. Plain C types only; nothing thrown on the far
 * side crosses over. */
#ifndef SPIN_IO_CONV_SHIM_H
#define SPIN_IO_CONV_SHIM_H

#include <stddef.h>

#ifdef __cplusplus
extern "C" {
#endif

#define SPIN_CONV_SHIM_ABI 1
#define SPIN_CONV_SHIM_SYMBOL "spin_conv_shim_table"

/* A two-dimensional convolution with a square kernel, zeros around the picture, and ReLU after it. */
struct spin_conv_shape {
    int n_in, height, width;   /* of what goes in */
    int n_out, kernel, stride; /* */
    int pad;                   /* pixels of zeros on every side */
};

struct spin_conv_shim {
    int abi;
    const char *version; /* of oneDNN */
    /* weights [n_out][n_in][kernel][kernel], bias [n_out]; copied. NULL with why. */
    void *(*plan)(const struct spin_conv_shape *shape, const float *weights, const float *bias,
                  int n_threads, char *why, size_t n_why);
    /* out [n_out][h'][w'] = max(0, conv(in [n_in][h][w]) + bias). 0 with why when it fails. */
    int (*run)(void *plan, const float *in, float *out, char *why, size_t n_why);
    void (*drop)(void *plan);
};

extern const struct spin_conv_shim spin_conv_shim_table;

#ifdef __cplusplus
}
#endif
#endif
