/* Functions for kernels that find the cell of the hash grid that contains a point. Files that
 * include this header are compiled without fused multiply-add. */
#pragma once

#include "device/cuda/cuda.h"
#include "math/grid.h"

enum { CUDA_CORNERS = 16 };

/* The cell of a level that contains a point: its vertices, clamped to the level, and the weights of
 * its upper vertices. */
struct cuda_cell {
    /* lower and upper vertex on each axis, times the stride or prime: terms of a corner's row */
    uint32_t low[4], high[4];
    float w[4], slope[4]; /* d w / d x_u */
    size_t first_row;
    uint32_t n_rows, mask; /* `mask`: n_rows - 1 if n_rows is a power of two, else 0 */
    bool hashed;
};

/* Computes the cell that contains point x. Returns false if the point is outside the unit cube or
 * NaN. */
static inline __device__ bool cuda_cell_of(const struct spin_grid &grid, int level, const float *x,
                                           struct cuda_cell *cell)
{
    const uint32_t primes[4] = {SPIN_GRID_PRIME_X, SPIN_GRID_PRIME_Y, SPIN_GRID_PRIME_Z,
                                SPIN_GRID_PRIME_T};
    uint32_t stride = 1;

    cell->hashed = grid.hashed[level];
    cell->first_row = grid.offset[level];
    cell->n_rows = grid.offset[level + 1] - grid.offset[level];
    cell->mask = cell->n_rows & (cell->n_rows - 1) ? 0 : cell->n_rows - 1;
    for (int d = 0; d < 4; d++) {
        float scale = grid.scale[level][d], pos = x[d] * scale, r;
        int32_t top = cell->hashed ? 0x7fffffff : (int32_t)grid.res[level][d] - 1, corner;
        uint32_t step = cell->hashed ? primes[d] : stride;

        if (!(x[d] >= 0.0f && x[d] <= 1.0f))
            return false;
        corner = (int32_t)pos;
        r = pos - (float)corner;
        cell->w[d] = spin_smoothstep(r);
        cell->slope[d] = spin_smoothstep_slope(r) * scale;
        cell->low[d] = (uint32_t)(corner < top ? corner : top) * step;
        cell->high[d] = (uint32_t)(corner + 1 < top ? corner + 1 : top) * step;
        stride *= grid.res[level][d];
    }
    return true;
}

static inline __device__ size_t cuda_corner_row(const struct cuda_cell &cell, int k)
{
    uint32_t x = k & 1 ? cell.high[0] : cell.low[0], y = k & 2 ? cell.high[1] : cell.low[1];
    uint32_t z = k & 4 ? cell.high[2] : cell.low[2], t = k & 8 ? cell.high[3] : cell.low[3];

    if (!cell.hashed)
        return cell.first_row + (x + y + (z + t));
    x ^= y ^ z ^ t;
    return cell.first_row + (cell.mask ? x & cell.mask : x % cell.n_rows);
}
