/* Functions for mlp.cu that compute all layers of a head in a single kernel. They require that the
 * encoding and the hidden layers are at most CUDA_HEADS_WIDE wide. */
#pragma once

#include "device/cuda/cuda.h"

enum { CUDA_HEADS_WIDE = 64 };
void cuda_heads(struct spin_device *d, const struct spin_heads *heads, const float *param, size_t n,
                const float *z, float *raw);
void cuda_heads_back(struct spin_device *d, const struct spin_heads *heads, const float *param,
                     const struct spin_active *active, const float *z, const float *d_raw,
                     float *d_param, float *d_z);

/* The same functions on tensor cores (heads_tensor.cu). The backward pass stores partial sums of
 * the gradients of the parameters, one for each of `blocks` blocks. The partial sums of a head,
 * [blocks][number of parameters of the head], start at `blocks` times the offset of the head. */
bool cuda_heads_fit_tensor(struct spin_device *d);
unsigned cuda_heads_tensor_blocks(struct spin_device *d, size_t n_splats);
void cuda_heads_tensor(struct spin_device *d, const struct spin_heads *heads, const float *param,
                       size_t n, const float *z, float *raw);
void cuda_heads_back_tensor(struct spin_device *d, const struct spin_heads *heads,
                            const float *param, const struct cuda_rows &rows, unsigned blocks,
                            const float *z, const float *d_raw, float *d_z, float *partial);

/* Returns the first column of a head's outputs in the raw attributes of a splat. */
static inline __device__ int cuda_heads_column(int head)
{
    const int first[SPIN_HEADS] = {SPIN_ATTR_SCALE, SPIN_ATTR_ROTATION, SPIN_ATTR_SH,
                                   SPIN_ATTR_OPACITY};

    return first[head];
}
