/* The 4-D hash grid, forward and backward: a thread has one point in one level, and the blocks of a level follow
 * each other, so that the level stays in the cache. Compiled without contraction of products and sums, as on the
 * CPU. Rows of the table gather their gradients by atomic additions: equal to rounding from run to run. */
#include "device/cuda/cuda.h"
#include "math/grid.h"

enum { CORNERS = 16 };

/* Where a point is in a level: vertices of its cell (within what there is), weights of the upper ones. */
struct cell {
    uint32_t low[4], high[4]; /* their part of the row: times the stride or the prime */
    float w[4], slope[4];     /* d w / d x_u */
    size_t first_row;
    uint32_t n_rows;
    bool hashed;
};

/* False: the point is outside, or not a number. */
static __device__ bool cell_of(const struct spin_grid &grid, int level, const float *x,
                               struct cell *cell)
{
    const uint32_t primes[4] = {SPIN_GRID_PRIME_X, SPIN_GRID_PRIME_Y, SPIN_GRID_PRIME_Z,
                                SPIN_GRID_PRIME_T};
    uint32_t stride = 1;

    cell->hashed = grid.hashed[level];
    cell->first_row = grid.offset[level];
    cell->n_rows = grid.offset[level + 1] - grid.offset[level];
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

static __device__ size_t corner_row(const struct cell &cell, int k)
{
    uint32_t x = k & 1 ? cell.high[0] : cell.low[0], y = k & 2 ? cell.high[1] : cell.low[1];
    uint32_t z = k & 4 ? cell.high[2] : cell.low[2], t = k & 8 ? cell.high[3] : cell.low[3];

    return cell.first_row + (cell.hashed ? (x ^ y ^ z ^ t) % cell.n_rows : x + y + (z + t));
}

static __device__ float corner_weight(const struct cell &cell, int k)
{
    float w[4];

    for (int d = 0; d < 4; d++)
        w[d] = k >> d & 1 ? cell.w[d] : 1.0f - cell.w[d];
    return (w[0] * w[1]) * (w[2] * w[3]);
}

template <int WIDTH>
static __global__ void grid_kernel(struct spin_grid grid, const float *table, size_t n,
                                   const float *x_u, float *z)
{
    size_t i = GPU_INDEX();
    int level = (int)blockIdx.y;
    float sum[WIDTH] = {0};
    struct cell cell;

    if (i >= n)
        return;
    if (cell_of(grid, level, x_u + 4 * i, &cell))
        for (int k = 0; k < CORNERS; k++) {
            const float *row = table + corner_row(cell, k) * WIDTH;
            float weight = corner_weight(cell, k);

            for (int f = 0; f < WIDTH; f++)
                sum[f] += weight * row[f];
        }
    for (int f = 0; f < WIDTH; f++)
        z[(i * (size_t)grid.n_levels + (size_t)level) * WIDTH + (size_t)f] = sum[f];
}

void cuda_grid(struct spin_device *d, const struct spin_grid *grid, const float *table, size_t n,
               const float *x_u, float *z)
{
    dim3 blocks(gpu_blocks(n), (unsigned)grid->n_levels);
    struct spin_grid g = *grid;

    if (n == 0)
        return;
    cuda_begin(d, SPIN_OP_GRID);
    switch (grid->n_features) {
    case 1:
        GPU_LAUNCH(gpu_of(d), grid_kernel<1>, blocks, GPU_BLOCK, g, table, n, x_u, z);
        break;
    case 2:
        GPU_LAUNCH(gpu_of(d), grid_kernel<2>, blocks, GPU_BLOCK, g, table, n, x_u, z);
        break;
    case 4:
        GPU_LAUNCH(gpu_of(d), grid_kernel<4>, blocks, GPU_BLOCK, g, table, n, x_u, z);
        break;
    default:
        GPU_LAUNCH(gpu_of(d), grid_kernel<8>, blocks, GPU_BLOCK, g, table, n, x_u, z);
    }
    cuda_end(d, SPIN_OP_GRID);
}

/* ---- Backward -------------------------------------------------------------------------------- */

/* a + w (b - a), the sum of one axis. */
static __device__ float mix(float a, float b, float w) { return a + w * (b - a); }

/* d_x [3] += g times the sums over corners of upper minus lower, along x, y and z, of one feature. */
static __device__ void add_slopes(const struct cell &cell, const float v[CORNERS], float g,
                                  float d_x[3])
{
    float xyz[8], xy[4], dz[4], x[2], dy[2];

    for (int k = 0; k < 8; k++)
        xyz[k] = mix(v[k], v[k + 8], cell.w[3]);
    for (int k = 0; k < 4; k++) {
        dz[k] = xyz[k + 4] - xyz[k];
        xy[k] = xyz[k] + cell.w[2] * dz[k];
    }
    for (int k = 0; k < 2; k++) {
        dy[k] = xy[k + 2] - xy[k];
        x[k] = xy[k] + cell.w[1] * dy[k];
    }
    d_x[0] += (x[1] - x[0]) * g;
    d_x[1] += mix(dy[0], dy[1], cell.w[0]) * g;
    d_x[2] += mix(mix(dz[0], dz[1], cell.w[0]), mix(dz[2], dz[3], cell.w[0]), cell.w[1]) * g;
}

/* d_x [levels][most][3], or NULL. */
template <int WIDTH>
static __global__ void grid_back_kernel(struct spin_grid grid, const float *table,
                                        struct cuda_rows rows, size_t most, const float *x_u,
                                        const float *d_z, float *d_table, float *d_x)
{
    size_t i = GPU_INDEX(), row;
    int level = (int)blockIdx.y;
    float slope[3] = {0, 0, 0};
    struct cell cell;

    if (!cuda_row(rows, i, &row))
        return;
    if (cell_of(grid, level, x_u + 4 * row, &cell)) {
        const float *g = d_z + (i * (size_t)grid.n_levels + (size_t)level) * WIDTH;

        for (int k = 0; k < CORNERS; k++) {
            float *to = d_table + corner_row(cell, k) * WIDTH;
            float weight = corner_weight(cell, k);

            for (int f = 0; f < WIDTH; f++)
                atomicAdd(&to[f], weight * g[f]);
        }
        for (int f = 0; d_x && f < WIDTH; f++) {
            float v[CORNERS];

            for (int k = 0; k < CORNERS; k++)
                v[k] = table[corner_row(cell, k) * WIDTH + (size_t)f];
            add_slopes(cell, v, g[f], slope);
        }
        for (int a = 0; a < 3; a++)
            slope[a] *= cell.slope[a];
    }
    for (int a = 0; d_x && a < 3; a++)
        d_x[((size_t)level * most + i) * 3 + (size_t)a] = slope[a];
}

static __global__ void sum_levels_kernel(int n_levels, struct cuda_rows rows, size_t most,
                                         const float *d_x, float *d_x_u)
{
    size_t i = GPU_INDEX();

    if (i >= *rows.count)
        return;
    for (size_t a = 0; a < 3; a++) {
        float sum = 0;

        for (int level = 0; level < n_levels; level++)
            sum += d_x[((size_t)level * most + i) * 3 + a];
        d_x_u[4 * i + a] = sum;
    }
    d_x_u[4 * i + 3] = 0; /* time is not trained */
}

void cuda_grid_back(struct spin_device *d, const struct spin_grid *grid, const float *table,
                    const struct spin_active *active, const float *x_u, const float *d_z,
                    float *d_table, float *d_x_u)
{
    size_t most = active->most;
    dim3 blocks(gpu_blocks(most), (unsigned)grid->n_levels);
    struct cuda_rows rows = cuda_rows_of(active, 0, SIZE_MAX);
    struct spin_grid g = *grid;
    float *d_x = NULL;

    if (d_x_u) {
        d_x = (float *)cuda_scratch(d, CUDA_SCRATCH_GRID,
                                    (size_t)grid->n_levels * most * 3 * sizeof *d_x);
        if (!d_x)
            return;
    }
    if (most == 0)
        return;
    cuda_begin(d, SPIN_OP_GRID_BACK);
    switch (grid->n_features) {
    case 1:
        GPU_LAUNCH(gpu_of(d), grid_back_kernel<1>, blocks, GPU_BLOCK, g, table, rows, most, x_u,
                   d_z, d_table, d_x);
        break;
    case 2:
        GPU_LAUNCH(gpu_of(d), grid_back_kernel<2>, blocks, GPU_BLOCK, g, table, rows, most, x_u,
                   d_z, d_table, d_x);
        break;
    case 4:
        GPU_LAUNCH(gpu_of(d), grid_back_kernel<4>, blocks, GPU_BLOCK, g, table, rows, most, x_u,
                   d_z, d_table, d_x);
        break;
    default:
        GPU_LAUNCH(gpu_of(d), grid_back_kernel<8>, blocks, GPU_BLOCK, g, table, rows, most, x_u,
                   d_z, d_table, d_x);
    }
    if (d_x)
        GPU_EACH(gpu_of(d), most, sum_levels_kernel, grid->n_levels, rows, most, d_x, d_x_u);
    cuda_end(d, SPIN_OP_GRID_BACK);
}
