/* Convolutions of pictures through oneDNN, behind a C face. Only LPIPS needs them; the shim is a shared
 * object of its own that is loaded on first use, and a build without oneDNN does all else. */
#ifndef SPIN_IO_CONV_H
#define SPIN_IO_CONV_H

#include "io/conv_shim.h"
#include "spin.h"

struct spin_conv {
    struct spin_conv_shape shape;
    int out_height, out_width;
    void *plan;
};

/* Load the shim now. Errors say what to install. */
spin_status spin_conv_start(void);

/* A convolution followed by ReLU; weights and bias are copied. */
spin_status spin_conv_open(const struct spin_conv_shape *shape, const float *weights,
                           const float *bias, int n_threads, struct spin_conv *out);
spin_status spin_conv_run(const struct spin_conv *conv, const float *in, float *out);
void spin_conv_close(struct spin_conv *conv);

#endif
