/* Definitions that compile as C and as CUDA. Headers in this folder include only each other and
 * headers of the C library. */
#pragma once

#include <math.h>
#include <stdint.h>

#if defined(__CUDACC__)
#define SPIN_FN static __host__ __device__ __forceinline__
#define SPIN_RESTRICT __restrict__
#else
#define SPIN_FN static inline __attribute__((always_inline, unused))
#define SPIN_RESTRICT __restrict__
#endif

typedef struct spin_vec3 {
    float x, y, z;
} spin_vec3;

SPIN_FN spin_vec3 spin_v3(float x, float y, float z)
{
    spin_vec3 v;
    v.x = x;
    v.y = y;
    v.z = z;
    return v;
}

SPIN_FN float spin_dot3(spin_vec3 a, spin_vec3 b) { return a.x * b.x + a.y * b.y + a.z * b.z; }

SPIN_FN float spin_minf(float a, float b) { return a < b ? a : b; }
SPIN_FN float spin_maxf(float a, float b) { return a > b ? a : b; }
