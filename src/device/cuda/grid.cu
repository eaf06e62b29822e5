/* The 4-D hash grid, forward and backward, with one thread per point and level. The blocks of a
 * level are consecutive, so that the level stays in cache. Compiled without fused multiply-add, as
 * for the CPU.
 *
 * The gradients are added to the rows of the table with atomics. Normally these add floats, so that
 * the results of two runs differ by rounding. On a deterministic device they add integers, whose
 * sum does not depend on the order. */
#include "device/cuda/cell.h"
#include "device/cuda/cuda.h"

static __device__ float corner_weight(const struct cuda_cell &cell, int k)
{
    float w[4];

    for (int d = 0; d < 4; d++)
        w[d] = k >> d & 1 ? cell.w[d] : 1.0f - cell.w[d];
    return (w[0] * w[1]) * (w[2] * w[3]);
}

/* load_row() and store_row() copy WIDTH consecutive values, up to 16 bytes at a time. Rows are
 * aligned to their size. */
template <int WIDTH> static __device__ void load_row(const float *from, float *to)
{
    if (WIDTH % 4 == 0) {
        for (int f = 0; f < WIDTH; f += 4) {
            float4 v = *(const float4 *)(from + f);

            to[f] = v.x, to[f + 1] = v.y, to[f + 2] = v.z, to[f + 3] = v.w;
        }
    } else if (WIDTH == 2) {
        float2 v = *(const float2 *)from;

        to[0] = v.x, to[1] = v.y;
    } else {
        to[0] = from[0];
    }
}

template <int WIDTH> static __device__ void store_row(const float *from, float *to)
{
    if (WIDTH % 4 == 0) {
        for (int f = 0; f < WIDTH; f += 4)
            *(float4 *)(to + f) = make_float4(from[f], from[f + 1], from[f + 2], from[f + 3]);
    } else {
        for (int f = 0; f < WIDTH; f++)
            to[f] = from[f];
    }
}

template <int WIDTH>
static __global__ void grid_kernel(struct spin_grid grid, const float *table, size_t n,
                                   const float *x_u, float *z)
{
    size_t i = GPU_INDEX();
    int level = (int)blockIdx.y;
    float sum[WIDTH] = {0};
    struct cuda_cell cell;

    if (i >= n)
        return;
    if (cuda_cell_of(grid, level, x_u + 4 * i, &cell))
        for (int k = 0; k < CUDA_CORNERS; k++) {
            float row[WIDTH], weight = corner_weight(cell, k);

            load_row<WIDTH>(table + cuda_corner_row(cell, k) * WIDTH, row);
            for (int f = 0; f < WIDTH; f++)
                sum[f] += weight * row[f];
        }
    store_row<WIDTH>(sum, z + (i * (size_t)grid.n_levels + (size_t)level) * WIDTH);
}

void cuda_grid(struct spin_device *d, const struct spin_grid *grid, const float *table, size_t n,
               const float *x_u, float *z)
{
    dim3 blocks(gpu_blocks(n), (unsigned)grid->n_levels);
    struct spin_grid g = *grid;

    if (n == 0)
        return;
    cuda_clocked clocked(d, SPIN_OP_GRID);
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
}

/* ---- Backward -------------------------------------------------------------------------------- */

/* Interpolates from a to b along one axis, with weight w: a + w (b - a). */
static __device__ float mix(float a, float b, float w) { return a + w * (b - a); }

/* Sets d_x [3] to the derivatives along x, y and z: the values at the upper corners minus those at
 * the lower corners, interpolated along the other axes. */
static __device__ void slopes_of(const struct cuda_cell &cell, const float v[CUDA_CORNERS],
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
    d_x[0] = x[1] - x[0];
    d_x[1] = mix(dy[0], dy[1], cell.w[0]);
    d_x[2] = mix(mix(dz[0], dz[1], cell.w[0]), mix(dz[2], dz[3], cell.w[0]), cell.w[1]);
}

/* Fixed-point sums: sum [rows][features] is the gradient of the table times factor[level], which is
 * a power of two. The weights of a point add up to 1, so no sum exceeds the sum of all |d_z| of its
 * level. The factor scales this upper limit to below 2^61. */
struct fixed {
    unsigned long long *sum; /* NULL: gradients are added as floats */
    double *factor;          /* [levels] */
};

/* Adds WIDTH consecutive values with atomics, 16 bytes at a time on GPUs that have atomics of this
 * size. */
template <int WIDTH> static __device__ void add_floats(float *to, const float *value)
{
#if defined(SPIN_EMU) || (defined(__CUDA_ARCH__) && __CUDA_ARCH__ >= 900)
    if (WIDTH % 4 == 0)
        for (int f = 0; f < WIDTH; f += 4)
            atomicAdd((float4 *)(to + f),
                      make_float4(value[f], value[f + 1], value[f + 2], value[f + 3]));
    else
#endif
        for (int f = 0; f < WIDTH; f++)
            atomicAdd(&to[f], value[f]);
}

template <int WIDTH>
static __device__ void add_to_row(const struct fixed &fixed, int level, float *d_table, size_t at,
                                  const float *value)
{
    if (!fixed.sum) {
        add_floats<WIDTH>(d_table + at, value);
        return;
    }
    for (int f = 0; f < WIDTH; f++)
        if (isfinite(value[f]))
            atomicAdd(&fixed.sum[at + (size_t)f],
                      (unsigned long long)llrint((double)value[f] * fixed.factor[level]));
        else /* such a value is NaN or infinite, which makes the sum nonfinite in any order */
            atomicAdd(&d_table[at + (size_t)f], value[f]);
}

/* Lanes of a warp whose points are in the same cell add up their values in a fixed order, and the
 * first of these lanes adds the sum to the table. This saves atomics, since consecutive points are
 * close to each other and a coarse cell contains many of them. */
enum { MOST_STEPS = 5 };
struct peers {
    unsigned mask; /* lanes with a point */
    bool leads;    /* whether this lane is the first of its cell */
    /* number of steps, which depends on the cell with the most points in this warp */
    int steps;
    /* lane whose value is added in each step; the lane itself: no value is added */
    int from[MOST_STEPS];
};

static __device__ struct peers find_peers(unsigned mask, const struct cuda_cell &cell)
{
    unsigned lane = threadIdx.x % 32, above, rank;
    unsigned same = __match_any_sync(mask, (uint64_t)cell.low[0] << 32 | cell.low[1]) &
                    __match_any_sync(mask, (uint64_t)cell.low[2] << 32 | cell.low[3]);
    struct peers peers;

    peers.mask = mask;
    rank = (unsigned)__popc(same & ((1u << lane) - 1));
    above = same & ~(((1u << lane) - 1) | 1u << lane);
    peers.leads = rank == 0;
    peers.steps = 0;
    /* The rank of a lane is the number of lower lanes with the same cell. Step s adds the values of
     * lanes that are 2^s ranks apart. `above` is the set of lanes above this one whose sums have
     * not been added to another lane yet. */
    for (int s = 0; s < MOST_STEPS; s++) {
        peers.from[s] = above ? __ffs((int)above) - 1 : (int)lane;
        peers.steps += __any_sync(mask, above != 0) != 0;
        above &= __ballot_sync(mask, (rank & 1) == 0);
        rank >>= 1;
    }
    return peers;
}

/* Computes the sum of the values of each cell. The first lane of the cell receives the sum. */
template <int WIDTH> static __device__ void sum_of_cell(const struct peers &peers, float *value)
{
    int lane = (int)(threadIdx.x % 32);

    for (int s = 0; s < MOST_STEPS; s++)
        if (s < peers.steps)
            for (int f = 0; f < WIDTH; f++) {
                float other = __shfl_sync(peers.mask, value[f], peers.from[s]);

                value[f] += peers.from[s] != lane ? other : 0;
            }
}

/* Computes the gradients of the table and, unless d_x is NULL, those of the positions for each
 * level, d_x [levels][most][3]. */
template <int WIDTH>
static __global__ void
grid_back_kernel(struct spin_grid grid, const float *table, struct cuda_rows rows, size_t most,
                 const float *x_u, const float *d_z, float *d_table, struct fixed fixed, float *d_x)
{
    size_t i = GPU_INDEX(), row;
    int level = (int)blockIdx.y;
    float slope[3] = {0, 0, 0};
    struct cuda_cell cell;
    bool there = cuda_row(rows, i, &row);
    bool inside = there && cuda_cell_of(grid, level, x_u + 4 * row, &cell);
    unsigned mask = __ballot_sync(0xffffffff, inside);

    if (inside) {
        struct peers peers = find_peers(mask, cell);
        float g[WIDTH];

        load_row<WIDTH>(d_z + (i * (size_t)grid.n_levels + (size_t)level) * WIDTH, g);
        for (int k = 0; k < CUDA_CORNERS; k++) {
            float weight = corner_weight(cell, k), value[WIDTH];

            for (int f = 0; f < WIDTH; f++)
                value[f] = weight * g[f];
            sum_of_cell<WIDTH>(peers, value);
            if (peers.leads)
                add_to_row<WIDTH>(fixed, level, d_table, cuda_corner_row(cell, k) * WIDTH, value);
        }
        if (d_x) {
            /* `row` contains the features of one corner, and v[k] is the dot product of the
             * features of corner k and the gradient. */
            float v[CUDA_CORNERS], row[WIDTH];

            for (int k = 0; k < CUDA_CORNERS; k++) {
                load_row<WIDTH>(table + cuda_corner_row(cell, k) * WIDTH, row);
                v[k] = 0;
                for (int f = 0; f < WIDTH; f++)
                    v[k] += row[f] * g[f];
            }
            slopes_of(cell, v, slope);
        }
        for (int a = 0; a < 3; a++)
            slope[a] *= cell.slope[a];
    }
    for (int a = 0; there && d_x && a < 3; a++)
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
    d_x_u[4 * i + 3] = 0; /* the gradient with respect to time is not used */
}

/* Computes partial [levels][blocks], the sum of |d_z| over the rows of each block, without
 * nonfinite values. */
static __global__ void size_kernel(int n_levels, int width, struct cuda_rows rows, const float *d_z,
                                   double *partial)
{
    __shared__ double sum[GPU_BLOCK];
    size_t i = GPU_INDEX();
    double own = 0;

    for (int f = 0; i < *rows.count && f < width; f++) {
        float g = fabsf(d_z[(i * (size_t)n_levels + blockIdx.y) * (size_t)width + (size_t)f]);

        own += isfinite(g) ? (double)g : 0;
    }
    own = cuda_block_sum(sum, own);
    if (threadIdx.x == 0)
        partial[(size_t)blockIdx.y * gridDim.x + blockIdx.x] = own;
}

/* Computes the factor of each level, with one block per level. */
static __global__ void factor_kernel(unsigned n_blocks, const double *partial, double *factor)
{
    __shared__ double sum[GPU_BLOCK];
    double own = 0;
    int exponent = 0;

    for (unsigned b = threadIdx.x; b < n_blocks; b += GPU_BLOCK)
        own += partial[(size_t)blockIdx.x * n_blocks + b];
    own = cuda_block_sum(sum, own);
    if (threadIdx.x > 0)
        return;
    frexp(own, &exponent); /* own < 2^exponent */
    factor[blockIdx.x] = own > 0 ? ldexp(1.0, 61 - exponent) : 1;
}

/* Converts the fixed-point sums to floats and adds them to d_table. The blocks of a level are
 * consecutive. */
static __global__ void add_fixed_kernel(struct spin_grid grid, struct fixed fixed, float *d_table)
{
    size_t width = (size_t)grid.n_features, i = GPU_INDEX();
    int level = (int)blockIdx.y;
    size_t at = grid.offset[level] * width + i, end = grid.offset[level + 1] * width;

    if (at < end && fixed.sum[at] != 0)
        d_table[at] += (float)((double)(long long)fixed.sum[at] / fixed.factor[level]);
}

/* Reserves and zeroes the fixed-point sums, and computes the factors. Returns false if out of
 * memory. */
static bool begin_fixed(struct spin_device *d, const struct spin_grid *grid,
                        const struct cuda_rows &rows, size_t most, const float *d_z,
                        struct fixed *fixed)
{
    size_t n = (size_t)grid->offset[grid->n_levels] * (size_t)grid->n_features;
    unsigned blocks = gpu_blocks(most), levels = (unsigned)grid->n_levels;
    size_t partials = (size_t)blocks * levels;
    char *at = (char *)cuda_scratch(d, CUDA_SCRATCH_FIXED,
                                    n * sizeof *fixed->sum + (partials + levels) * sizeof(double));
    double *partial = (double *)(at + n * sizeof *fixed->sum);

    if (!at)
        return false;
    fixed->sum = (unsigned long long *)at;
    fixed->factor = partial + partials;
    gpu_zero(gpu_of(d), at, n * sizeof *fixed->sum);
    GPU_LAUNCH(gpu_of(d), size_kernel, dim3(blocks, levels), GPU_BLOCK, grid->n_levels,
               grid->n_features, rows, d_z, partial);
    GPU_LAUNCH(gpu_of(d), factor_kernel, levels, GPU_BLOCK, blocks, partial, fixed->factor);
    return true;
}

static void end_fixed(struct spin_device *d, const struct spin_grid &grid,
                      const struct fixed &fixed, float *d_table)
{
    size_t widest = 0;

    for (int l = 0; l < grid.n_levels; l++)
        if (grid.offset[l + 1] - grid.offset[l] > widest)
            widest = grid.offset[l + 1] - grid.offset[l];
    GPU_LAUNCH(gpu_of(d), add_fixed_kernel,
               dim3(gpu_blocks(widest * (size_t)grid.n_features), (unsigned)grid.n_levels),
               GPU_BLOCK, grid, fixed, d_table);
}

void cuda_grid_back(struct spin_device *d, const struct spin_grid *grid, const float *table,
                    const struct spin_active *active, const float *x_u, const float *d_z,
                    float *d_table, float *d_x_u)
{
    size_t most = active->most;
    dim3 blocks(gpu_blocks(most), (unsigned)grid->n_levels);
    struct cuda_rows rows = cuda_rows_of(active, 0, SIZE_MAX);
    struct spin_grid g = *grid;
    struct fixed fixed = {};
    float *d_x = NULL;

    if (d_x_u) {
        d_x = (float *)cuda_scratch(d, CUDA_SCRATCH_GRID,
                                    (size_t)grid->n_levels * most * 3 * sizeof *d_x);
        if (!d_x)
            return;
    }
    if (most == 0)
        return;
    cuda_clocked clocked(d, SPIN_OP_GRID_BACK);
    if (d->deterministic && !begin_fixed(d, grid, rows, most, d_z, &fixed))
        return;
    switch (grid->n_features) {
    case 1:
        GPU_LAUNCH(gpu_of(d), grid_back_kernel<1>, blocks, GPU_BLOCK, g, table, rows, most, x_u,
                   d_z, d_table, fixed, d_x);
        break;
    case 2:
        GPU_LAUNCH(gpu_of(d), grid_back_kernel<2>, blocks, GPU_BLOCK, g, table, rows, most, x_u,
                   d_z, d_table, fixed, d_x);
        break;
    case 4:
        GPU_LAUNCH(gpu_of(d), grid_back_kernel<4>, blocks, GPU_BLOCK, g, table, rows, most, x_u,
                   d_z, d_table, fixed, d_x);
        break;
    default:
        GPU_LAUNCH(gpu_of(d), grid_back_kernel<8>, blocks, GPU_BLOCK, g, table, rows, most, x_u,
                   d_z, d_table, fixed, d_x);
    }
    if (fixed.sum)
        end_fixed(d, g, fixed, d_table);
    if (d_x)
        GPU_EACH(gpu_of(d), most, sum_levels_kernel, grid->n_levels, rows, most, d_x, d_x_u);
}
