/* Multiplies small matrices on the tensor cores of a warp, from sm_80 on, with tf32 factors and
 * fp32 sums. Each float is split into two tf32 numbers; the sum of three products of these has
 * about the accuracy of fp32.
 *
 * All 32 lanes of a warp take part. With g = lane / 4 and t = lane % 4 a lane holds
 *     a[0..3] = A(g, t), A(g + 8, t), A(g, t + 4), A(g + 8, t + 4)         of A [16][8]
 *     b[0..1] = B(t, g), B(t + 4, g)                                       of B [8][8]
 *     c[0..3] = C(g, 2 t), C(g, 2 t + 1), C(g + 8, 2 t), C(g + 8, 2 t + 1) of C [16][8] */
#pragma once

#include <stdint.h>

#include "math/approx.h"

#ifdef SPIN_EMU
#define CUDA_UNROLL
#define CUDA_UNROLL_TWICE
#else
#define CUDA_UNROLL _Pragma("unroll")
#define CUDA_UNROLL_TWICE _Pragma("unroll 2")
#endif

#if defined(SPIN_EMU) || (defined(__CUDA_ARCH__) && __CUDA_ARCH__ >= 800)
#define CUDA_HAS_MMA 1

/* Returns the tf32 number that is nearest to v. Returns NaN if |v| is above 4e34, where the product
 * below overflows. The instruction cvt.rna.tf32.f32 is not used, since it becomes twice as many
 * instructions on sm_90. */
static inline __device__ float cuda_tf32(float v)
{
#ifdef SPIN_EMU
    return spin_float_of_bits(emu_tf32(v));
#else
    /* This is Veltkamp splitting, which keeps the upper 11 bits of the mantissa of v. */
    return fmaf(v, -8192.0f, __fmul_rn(v, 8193.0f));
#endif
}

/* N floats, each split into a high and a low part, whose sum has a relative error of 2^-21. */
template <int N> struct cuda_split {
    uint32_t high[N], low[N];

    __device__ void set(int i, float v)
    {
        float nearest = cuda_tf32(v);

        high[i] = spin_bits_of_float(nearest);
        low[i] = spin_bits_of_float(v - nearest) & ~0x1fffu;
    }
};

#ifndef SPIN_EMU
struct cuda_mma_queue {
    /* Computes C += A B at once, without queueing the product. */
    __device__ void add(float *c, const uint32_t *a, const uint32_t *b)
    {
        asm("mma.sync.aligned.m16n8k8.row.col.f32.tf32.tf32.f32 "
            "{%0, %1, %2, %3}, {%4, %5, %6, %7}, {%8, %9}, {%0, %1, %2, %3};"
            : "+f"(c[0]), "+f"(c[1]), "+f"(c[2]), "+f"(c[3])
            : "r"(a[0]), "r"(a[1]), "r"(a[2]), "r"(a[3]), "r"(b[0]), "r"(b[1]));
    }
    __device__ void run() {}
};
#else
/* computes all queued products in run(), in the order of the queue */
typedef struct emu_mma_queue cuda_mma_queue;
#endif

/* Computes C [16][8 N] += A [16][8] B [8][8 N] as N products side by side, whose registers are
 * consecutive. */
template <int N>
static inline __device__ void cuda_mma(float *c, const cuda_split<4> &a, const cuda_split<2 * N> &b)
{
    cuda_mma_queue queue;

    /* Consecutive products add to different parts of C, since a product that adds to the same part
     * would wait for the previous one. */
    CUDA_UNROLL
    for (int v = 0; v < N; v++)
        queue.add(c + 4 * v, a.low, b.high + 2 * v);
    CUDA_UNROLL
    for (int v = 0; v < N; v++)
        queue.add(c + 4 * v, a.high, b.low + 2 * v);
    CUDA_UNROLL
    for (int v = 0; v < N; v++)
        queue.add(c + 4 * v, a.high, b.high + 2 * v);
    queue.run();
}
#else
#define CUDA_HAS_MMA 0
#endif
