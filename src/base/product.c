/* Matrix multiplication in tiles of 1 to 8 rows and 16 columns, whose sums stay in registers. The
 * code is compiled for three instruction sets: SSE, AVX2 and AVX-512. The Makefile disables FMA, so
 * that all of them give the same bits. */
#include "base/product.h"

#include <stdint.h>

typedef void tile_fn(int columns, int n, const float *left, size_t apart, const float *right,
                     const float *start, bool relu, float *sums);

#define TILE(name, rows, lanes, target)                                                            \
    target static void name(int columns, int n, const float *left, size_t apart,                   \
                            const float *right, const float *start, bool relu, float *sums)        \
    {                                                                                              \
        typedef float vec __attribute__((vector_size(4 * lanes), aligned(4), may_alias));          \
        typedef int32_t bits __attribute__((vector_size(4 * lanes)));                              \
        vec sum[rows][16 / lanes];                                                                 \
                                                                                                   \
        for (int r = 0; r < rows; r++)                                                             \
            for (int v = 0; v < 16 / lanes; v++)                                                   \
                if (start)                                                                         \
                    sum[r][v] = (vec){0} + start[r];                                               \
                else                                                                               \
                    sum[r][v] = *(vec *)(sums + r * columns + v * lanes);                          \
        for (int k = 0; k < n; k++)                                                                \
            for (int r = 0; r < rows; r++)                                                         \
                for (int v = 0; v < 16 / lanes; v++)                                               \
                    sum[r][v] += left[(size_t)r * apart + (size_t)k] *                             \
                                 *(const vec *)(right + (size_t)k * (size_t)columns + v * lanes);  \
        for (int r = 0; r < rows; r++)                                                             \
            for (int v = 0; v < 16 / lanes; v++) {                                                 \
                if (relu)                                                                          \
                    sum[r][v] = (vec)((bits)sum[r][v] & ~(bits)(sum[r][v] < 0));                   \
                *(vec *)(sums + r * columns + v * lanes) = sum[r][v];                              \
            }                                                                                      \
    }

TILE(base_many, 2, 4, )
TILE(base_one, 1, 4, )
#ifdef __x86_64__
#define V3 __attribute__((target("avx2,fma")))
#define V4 __attribute__((target("avx512f")))
TILE(v3_many, 4, 8, V3)
TILE(v3_one, 1, 8, V3)
TILE(v4_many, 8, 16, V4)
TILE(v4_one, 1, 16, V4)
#endif

void spin_multiply_add(int rows, int columns, int n, const float *left, size_t apart,
                       const float *right, const float *start, bool relu, float *sums)
{
    tile_fn *many = base_many, *one = base_one;
    int n_many = 2;

#ifdef __x86_64__
    if (__builtin_cpu_supports("avx512f")) {
        many = v4_many, one = v4_one;
        n_many = 8;
    } else if (__builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma")) {
        many = v3_many, one = v3_one;
        n_many = 4;
    }
#endif
    for (int column = 0; column < columns; column += 16)
        for (int row = 0, taken; row < rows; row += taken) {
            taken = rows - row >= n_many ? n_many : 1;
            (taken > 1 ? many : one)(columns, n, left + (size_t)row * apart, apart, right + column,
                                     start ? start + row : NULL, relu,
                                     sums + row * columns + column);
        }
}
