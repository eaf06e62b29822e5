/* Heads that a single kernel computes, for mlp.cu: those whose encoding and hidden layers are at
 * most CUDA_HEADS_WIDE wide. */
#pragma once

#include "device/cuda/cuda.h"

enum { CUDA_HEADS_WIDE = 64 };
void cuda_heads(struct spin_device *d, const struct spin_heads *heads, const float *param, size_t n,
                const float *z, float *raw);
void cuda_heads_back(struct spin_device *d, const struct spin_heads *heads, const float *param,
                     const struct spin_active *active, const float *z, const float *d_raw,
                     float *d_param, float *d_z);

/* heads_tensor.cu: the same on tensor cores. The backward pass stores partial sums of the
 * parameters' gradients for each of `blocks` blocks. The partial sums of a head, [blocks][size of
 * the head], start at `blocks` times the offset of the head. */
bool cuda_heads_fit_tensor(struct spin_device *d);
unsigned cuda_heads_tensor_blocks(struct spin_device *d, size_t n_splats);
void cuda_heads_tensor(struct spin_device *d, const struct spin_heads *heads, const float *param,
                       size_t n, const float *z, float *raw);
void cuda_heads_back_tensor(struct spin_device *d, const struct spin_heads *heads,
                            const float *param, const struct cuda_rows &rows, unsigned blocks,
                            const float *z, const float *d_raw, float *d_z, float *partial);

/* First column of a head's outputs in a splat's raw attributes. */
static inline __device__ int cuda_heads_column(int head)
{
    const int first[SPIN_HEADS] = {SPIN_ATTR_SCALE, SPIN_ATTR_ROTATION, SPIN_ATTR_SH,
                                   SPIN_ATTR_OPACITY};

    return first[head];
}
