/* Computes heads that are at most 64 wide on tensor cores. A block keeps the weights of one head in
 * shared memory, each split into two tf32 numbers, and processes all splats of the block before the
 * next head. Each warp has its own rows (splats), whose activations are in the warp's own part of
 * shared memory, so the warp advances from layer to layer without synchronising the block. In the
 * backward pass, shared memory holds the activations and gradients of 128 splats, from which the
 * gradients of the weights are computed; each warp keeps a part of these gradients in registers.
 *
 * The terms of a sum may be added in any order. Columns t and t + 4 of the matrix A of mma.h, and
 * the same rows of B, are therefore stored here as columns 2 t and 2 t + 1, so that a lane reads
 * pairs. */
#include "device/cuda/heads.h"

#include "device/cuda/mma.h"
#include "math/mlp.h"

enum {
    WIDE = CUDA_HEADS_WIDE,
    MOST_OUT = 48, /* largest number of outputs of a head */
    DEEP = 8,      /* a matrix product of mma.h sums DEEP terms and has DEEP columns */
    TILES = WIDE / DEEP,
    LONG = WIDE + 8, /* row stride of activations, which avoids bank conflicts */
    WARP = 32,
    WARPS = 12, /* forward: largest number of warps in a block */
    ROWS = 32,  /* forward: number of rows that a warp processes at a time */
    BACK_WARPS = 8,
    BACK_ROWS = 16,
    BACK_TILE = BACK_WARPS * BACK_ROWS
};

/* The weights of one head in shared memory, padded with zeros. Each of w1 to w3 contains first the
 * high parts of the weights, then the low parts, both in the order of weight_index(). */
struct weights {
    float w1[2 * WIDE * WIDE], w2[2 * WIDE * WIDE], w3[2 * MOST_OUT * WIDE], b1[WIDE], b2[WIDE],
        b3[MOST_OUT];
};
struct forward_room {
    struct weights w;
    float x[1][ROWS * LONG]; /* [warps] */
};
struct back_room {
    struct weights w;
    float x[BACK_TILE * LONG], g[BACK_TILE * LONG];
};

/* Returns the number of warps in a block. The size of shared memory limits it, for example to 8 on
 * sm_80. */
static int warps_of(const struct gpu *gpu)
{
    long warps = ((long)gpu->shared - (long)sizeof(struct weights)) /
                 (long)sizeof(((struct forward_room *)NULL)->x[0]);

    return warps < WARPS ? (int)warps : (int)WARPS;
}

bool cuda_heads_fit_tensor(struct spin_device *d)
{
    const struct gpu *gpu = gpu_of(d);

    return cuda_of(d)->tensor && warps_of(gpu) > 0 &&
           sizeof(struct back_room) <= (size_t)gpu->shared;
}

#if CUDA_HAS_MMA
static __device__ int g() { return (int)threadIdx.x % WARP / 4; }
static __device__ int t() { return (int)threadIdx.x % 4; }
static __device__ int warp() { return (int)threadIdx.x / WARP; }
static __device__ int tiles(int n) { return (n + DEEP - 1) / DEEP; }

/* Returns the index of weight W(o, i) in shared memory, chosen so that lanes that read the weights
 * (g, 2 t) and (g, 2 t + 1), or (2 t, g), use different banks. */
static __device__ int weight_index(int o, int i)
{
    return o * WIDE + (i ^ ((o & 6) << 2 ^ (o & 1) << 4));
}

template <int ROOM>
static __device__ void stage_weights(const float *w, int n_in, int n_out, float *to)
{
    for (int at = (int)threadIdx.x; at < ROOM * WIDE; at += (int)blockDim.x) {
        int o = at / WIDE, i = at % WIDE;
        cuda_split<1> v;

        v.set(0, o < n_out && i < n_in ? w[o * n_in + i] : 0);
        to[weight_index(o, i)] = spin_float_of_bits(v.high[0]);
        to[ROOM * WIDE + weight_index(o, i)] = spin_float_of_bits(v.low[0]);
    }
}

static __device__ void stage_bias(const float *bias, int n_out, int room, float *to)
{
    for (int i = (int)threadIdx.x; i < room; i += (int)blockDim.x)
        to[i] = i < n_out ? bias[i] : 0;
}

/* Copies the weights of a head to shared memory. All threads must call the function; when it
 * returns, each of them can read all weights. */
static __device__ void stage_head(const struct spin_heads &heads, const float *param, int head,
                                  struct weights *w)
{
    int n_in = heads.n_in, hidden = heads.hidden, n_out = heads.n_out[head];
    struct spin_head_layout at = spin_head_layout(n_in, hidden, n_out);
    const float *p = param + heads.offset[head];

    __syncthreads();
    stage_weights<WIDE>(p + at.w1, n_in, hidden, w->w1);
    stage_weights<WIDE>(p + at.w2, hidden, hidden, w->w2);
    stage_weights<MOST_OUT>(p + at.w3, hidden, n_out, w->w3);
    stage_bias(p + at.b1, hidden, WIDE, w->b1);
    stage_bias(p + at.b2, hidden, WIDE, w->b2);
    stage_bias(p + at.b3, n_out, MOST_OUT, w->b3);
    __syncthreads();
}

/* Loads the factor A of a product from shared memory: 16 of the warp's rows, columns [8 step, 8
 * step + 8). */
static __device__ void load_rows(const float *x, int step, cuda_split<4> *to)
{
    CUDA_UNROLL
    for (int r = 0; r < 2; r++) {
        float2 v = *(const float2 *)(x + (g() + 8 * r) * LONG + DEEP * step + 2 * t());

        to->set(r, v.x);
        to->set(r + 2, v.y);
    }
}

/* Loads from each of N tiles the weights (k, n) and (k + 1, n), where k = 8 step + 2 t and n = 8
 * tile + g. They are elements of W^T or, if BACK is true, of W, which has ROOM rows. The index is
 * that of weight_index(), with the terms that do not depend on the step written separately, so that
 * the compiler moves these out of the loop over steps. */
template <int N, bool BACK, int ROOM>
static __device__ void load_weights(const float *w, int step, cuda_split<2 * N> *to)
{
    CUDA_UNROLL
    for (int n = 0; n < N; n++) {
        CUDA_UNROLL
        for (int low = 0; low < 2; low++) {
            const float *from = w + low * ROOM * WIDE;
            uint32_t *pair = (low ? to->low : to->high) + 2 * n;

            if (BACK) {
                from += (step * DEEP + 2 * t()) * WIDE + n / 4 * 32 + g();
                pair[0] = spin_bits_of_float(from[DEEP * (n % 4 ^ t())]);
                pair[1] = spin_bits_of_float(from[WIDE + DEEP * (n % 4 ^ t() ^ 2)]);
            } else {
                float2 v = *(const float2 *)(from + n * DEEP * WIDE +
                                             weight_index(g(), step * DEEP) + 2 * t());

                pair[0] = spin_bits_of_float(v.x);
                pair[1] = spin_bits_of_float(v.y);
            }
        }
    }
}

/* Computes sum [16 M][8 N] = x W^T or, if BACK is true, x W, over 8 * steps columns of x. Each
 * block of 16 rows is distributed over the lanes like C in mma.h. */
template <int M, int N, bool BACK, int ROOM>
static __device__ void product(const float *x, int steps, const float *w, float (*sum)[4 * N])
{
    CUDA_UNROLL
    for (int m = 0; m < M; m++)
        CUDA_UNROLL
    for (int e = 0; e < 4 * N; e++)
        sum[m][e] = 0;
    for (int step = 0; step < steps; step++) {
        cuda_split<2 * N> right;

        load_weights<N, BACK, ROOM>(w, step, &right);
        CUDA_UNROLL
        for (int m = 0; m < M; m++) {
            cuda_split<4> left;

            load_rows(x + 16 * m * LONG, step, &left);
            cuda_mma<N>(sum[m], left, right);
        }
    }
}

/* Stores the sums of all lanes in the warp's part of shared memory, in the layout that load_rows()
 * reads. */
template <int N> static __device__ void store_sums(const float *sum, float *x)
{
    CUDA_UNROLL
    for (int n = 0; n < N; n++) {
        CUDA_UNROLL
        for (int r = 0; r < 2; r++) {
            float2 v = {sum[4 * n + 2 * r], sum[4 * n + 2 * r + 1]};

            *(float2 *)(x + (g() + 8 * r) * LONG + DEEP * n + 2 * t()) = v;
        }
    }
}

/* Sets R rows of COLUMNS columns in the warp's part of shared memory: copies the first n columns of
 * m rows of `from`, and sets all other values to zero. `number` lists the rows to copy; if it is
 * NULL, they are consecutive. */
template <int R, int COLUMNS>
static __device__ void load_input(float *x, const float *from, size_t ld, const uint32_t *number,
                                  int m, int n)
{
    int lane = (int)threadIdx.x % WARP, column = lane * 4 % COLUMNS;

    if (COLUMNS == WIDE && n % 4 == 0) { /* rows of n floats are aligned to 16 bytes */
        from += column;
        CUDA_UNROLL
        for (int i = 0; i < R; i += 4 * WARP / COLUMNS) {
            int row = i + lane * 4 / COLUMNS;
            float4 v = make_float4(0, 0, 0, 0);

            if (row < m && column < n)
                v = *(const float4 *)(from + (number ? number[row] : (size_t)row) * ld);
            *(float4 *)(x + row * LONG + column) = v;
        }
        return;
    }
    for (int at = lane; at < R * COLUMNS; at += WARP) {
        int row = at / COLUMNS, j = at % COLUMNS;

        x[row * LONG + j] =
            row < m && j < n ? from[(number ? number[row] : (size_t)row) * ld + (size_t)j] : 0;
    }
}
#endif

/* ---- Forward --------------------------------------------------------------------------------- */

#if CUDA_HAS_MMA
/* Sets `sum` to activation(sum + bias). Unless `slope` is NULL, sets it to the derivative of the
 * activation function. */
static __device__ void activate(const float *bias, bool relu, float *sum, float *slope)
{
    CUDA_UNROLL
    for (int e = 0; e < 4 * TILES; e++) {
        float x = sum[e] + bias[e / 4 * DEEP + 2 * t() + e % 2];

        if (relu) {
            sum[e] = spin_relu(x);
            if (slope)
                slope[e] = spin_relu_slope(x);
        } else {
            sum[e] = slope ? spin_gelu_both(x, &slope[e]) : spin_gelu(x);
        }
    }
}

/* Computes the last layer for the first m rows of the warp, and writes the outputs to `to`, whose
 * rows are SPIN_ATTR long. */
template <int N>
static __device__ void finish_rows(const float *x, int steps, const struct weights *w, int m,
                                   int n_out, float *to)
{
    float sum[ROWS / 16][4 * N];

    product<ROWS / 16, N, false, MOST_OUT>(x, steps, w->w3, sum);
    CUDA_UNROLL
    for (int e = 0; e < ROWS / 16 * 4 * N; e++) {
        int row = e / (4 * N) * 16 + g() + e % 4 / 2 * 8, column = e % (4 * N) / 4 * DEEP;

        column += 2 * t() + e % 2;
        if (row < m && column < n_out)
            to[(size_t)row * SPIN_ATTR + (size_t)column] =
                sum[e / (4 * N)][e % (4 * N)] + w->b3[column];
    }
}
#endif

static __global__ void __launch_bounds__(WARP *WARPS, 1)
    heads_tensor_kernel(struct spin_heads heads, const float *param, size_t n, const float *z,
                        float *raw)
{
#if CUDA_HAS_MMA
    GPU_SHARED(struct forward_room, room);
    struct weights *w = &room->w;
    float *x = room->x[0] + warp() * ROWS * LONG;
    int n_in = heads.n_in, steps = tiles(heads.hidden);

    for (int head = 0; head < SPIN_HEADS; head++) {
        float *to = raw + cuda_heads_column(head);
        int n_out = heads.n_out[head];

        stage_head(heads, param, head, w);
        for (size_t first = (blockIdx.x + (size_t)gridDim.x * (size_t)warp()) * ROWS; first < n;
             first += (size_t)gridDim.x * (blockDim.x / WARP) * ROWS) {
            int m = n - first < ROWS ? (int)(n - first) : (int)ROWS;

            load_input<ROWS, WIDE>(x, z + first * (size_t)n_in, (size_t)n_in, NULL, m, n_in);
            __syncwarp(0xffffffffu);
            for (int layer = 0; layer < 2; layer++) {
                float sum[ROWS / 16][4 * TILES];

                product<ROWS / 16, TILES, false, WIDE>(x, layer ? steps : tiles(n_in),
                                                       layer ? w->w2 : w->w1, sum);
                CUDA_UNROLL
                for (int i = 0; i < ROWS / 16; i++) {
                    activate(layer ? w->b2 : w->b1, heads.relu, sum[i], NULL);
                    store_sums<TILES>(sum[i], x + 16 * i * LONG);
                }
            }
            if (n_out > DEEP)
                finish_rows<MOST_OUT / DEEP>(x, steps, w, m, n_out, to + first * SPIN_ATTR);
            else
                finish_rows<1>(x, steps, w, m, n_out, to + first * SPIN_ATTR);
            __syncwarp(0xffffffffu);
        }
    }
#endif
}

void cuda_heads_tensor(struct spin_device *d, const struct spin_heads *heads, const float *param,
                       size_t n, const float *z, float *raw)
{
    size_t units = (n + ROWS - 1) / ROWS, most = (size_t)gpu_of(d)->processors;
    unsigned blocks = (unsigned)(units < most ? units : most);
    int warps = warps_of(gpu_of(d));
    size_t room = sizeof(struct weights) + (size_t)warps * sizeof(((struct forward_room *)NULL)->x);
    struct spin_heads h = *heads;

    GPU_LAUNCH_SHARED(gpu_of(d), heads_tensor_kernel, blocks, WARP * warps, room, h, param, n, z,
                      raw);
}

/* ---- Backward -------------------------------------------------------------------------------- */

struct back {
    struct spin_heads heads;
    const float *param;
    struct cuda_rows rows;
    const float *z, *d_raw;
    float *d_z, *partial;
    unsigned blocks;
};

#if CUDA_HAS_MMA
/* Adds d^T x, which is a sum over the rows of the block, to sum [16 M][8 N], for the columns of d
 * from i0 on and those of x from j0 on. Adds this lane's share of the column sums of d to `bias`.
 */
template <int M, int N>
static __device__ void add_outer_product(const float *d, const float *x, int i0, int j0, float *sum,
                                         float *bias)
{
    CUDA_UNROLL_TWICE
    for (int row = 0; row < BACK_TILE; row += DEEP) {
        cuda_split<2 * N> right;

        CUDA_UNROLL
        for (int r = 0; r < 2 * N; r++)
            right.set(r, x[(row + t() + r % 2 * 4) * LONG + j0 + r / 2 * DEEP + g()]);
        CUDA_UNROLL
        for (int m = 0; m < M; m++) {
            cuda_split<4> left;

            CUDA_UNROLL
            for (int r = 0; r < 4; r++) {
                float v = d[(row + t() + r / 2 * 4) * LONG + i0 + 16 * m + r % 2 * 8 + g()];

                left.set(r, v);
                bias[2 * m + r % 2] += v;
            }
            cuda_mma<N>(sum + 4 * N * m, left, right);
        }
    }
}

/* Stores the partial gradients of a block: those of the weights in `to` [n][n_in], those of the
 * bias in to_bias [n]. */
template <int M, int N>
static __device__ void store_gradients(const float *sum, const float *bias, int i0, int j0, int n,
                                       int n_in, float *to, float *to_bias)
{
    CUDA_UNROLL
    for (int e = 0; e < 4 * M * N; e++) {
        int i = i0 + e / (4 * N) * 16 + e % 4 / 2 * 8 + g();
        int j = j0 + e % (4 * N) / 4 * DEEP + 2 * t() + e % 2;

        if (i < n && j < n_in)
            to[i * n_in + j] = sum[e];
    }
    CUDA_UNROLL
    for (int r = 0; r < 2 * M; r++) {
        int i = i0 + 8 * r + g();
        float v = bias[r];

        v += __shfl_xor_sync(0xffffffffu, v, 1);
        v += __shfl_xor_sync(0xffffffffu, v, 2);
        if (j0 == 0 && t() == 0 && i < n)
            to_bias[i] = v;
    }
}

/* Copies n columns of m rows of the warp to `to`; if `add` is true, adds them to `to` instead. */
static __device__ void store_rows(const float *x, int m, int n, bool add, float *to)
{
    int lane = (int)threadIdx.x % WARP, column = lane * 4 % WIDE;

    if (n % 4 == 0) {
        CUDA_UNROLL
        for (int i = 0; i < BACK_ROWS; i += 4 * WARP / WIDE) {
            int row = i + lane * 4 / WIDE;
            float4 v = *(const float4 *)(x + row * LONG + column);
            float4 *at = (float4 *)(to + row * n + column);

            if (row >= m || column >= n)
                continue;
            if (add)
                v = make_float4(at->x + v.x, at->y + v.y, at->z + v.z, at->w + v.w);
            *at = v;
        }
        return;
    }
    for (int at = lane; at < m * n; at += WARP) {
        float v = x[at / n * LONG + at % n];

        to[at] = add ? to[at] + v : v;
    }
}

/* The parts of the gradients of weights and biases that a lane keeps in registers. */
struct back_sums {
    float w1[16], w2[16], w3[12], b1[2], b2[2], b3[6];
};
/* Runs the backward pass of one head for 128 splats, and adds the gradients of weights and biases
 * to *s. The variables `mine` and x are the warp's rows of room->g and room->x. */
static __device__ void back_tile(const struct back &b, int head, size_t first, size_t count,
                                 struct back_room *room, struct back_sums *s)
{
    int n_in = b.heads.n_in, n_out = b.heads.n_out[head], steps = tiles(b.heads.hidden);
    int row0 = warp() * BACK_ROWS, m = 0, i0 = warp() % 4 * 16, j0 = warp() / 4 * 32;
    const struct weights *w = &room->w;
    float *x = room->x + row0 * LONG, *mine = room->g + row0 * LONG;
    float a1[1][4 * TILES], sum[1][4 * TILES], slope1[4 * TILES], slope2[4 * TILES];
    const uint32_t *number;
    const float *d_out;

    first += (size_t)row0;
    if (first < count)
        m = count - first < BACK_ROWS ? (int)(count - first) : (int)BACK_ROWS;
    number = b.rows.row + first;
    d_out = b.d_raw + first * SPIN_ATTR + cuda_heads_column(head);
    __syncwarp(0xffffffffu);
    load_input<BACK_ROWS, WIDE>(x, b.z, (size_t)n_in, number, m, n_in);
    if (n_out > 16)
        load_input<BACK_ROWS, MOST_OUT>(mine, d_out, SPIN_ATTR, NULL, m, n_out);
    else
        load_input<BACK_ROWS, 16>(mine, d_out, SPIN_ATTR, NULL, m, n_out);
    __syncwarp(0xffffffffu);
    product<1, TILES, false, WIDE>(x, tiles(n_in), w->w1, a1);
    activate(w->b1, b.heads.relu, a1[0], slope1);
    store_sums<TILES>(a1[0], x);
    product<1, TILES, false, WIDE>(x, steps, w->w2, sum);
    activate(w->b2, b.heads.relu, sum[0], slope2);
    store_sums<TILES>(sum[0], x);
    __syncthreads();
    if (n_out > 16)
        add_outer_product<3, 1>(room->g, room->x, 0, DEEP * warp(), s->w3, s->b3);
    else
        add_outer_product<1, 1>(room->g, room->x, 0, DEEP * warp(), s->w3, s->b3);
    product<1, TILES, true, MOST_OUT>(mine, tiles(n_out), w->w3, sum);
    CUDA_UNROLL
    for (int e = 0; e < 4 * TILES; e++)
        sum[0][e] *= slope2[e];
    __syncthreads();
    store_sums<TILES>(a1[0], x);
    store_sums<TILES>(sum[0], mine);
    __syncthreads();
    add_outer_product<1, 4>(room->g, room->x, i0, j0, s->w2, s->b2);
    product<1, TILES, true, WIDE>(mine, steps, w->w2, sum);
    CUDA_UNROLL
    for (int e = 0; e < 4 * TILES; e++)
        sum[0][e] *= slope1[e];
    __syncthreads();
    load_input<BACK_ROWS, WIDE>(x, b.z, (size_t)n_in, number, m, n_in);
    store_sums<TILES>(sum[0], mine);
    __syncthreads();
    add_outer_product<1, 4>(room->g, room->x, i0, j0, s->w1, s->b1);
    product<1, TILES, true, WIDE>(mine, steps, w->w1, sum);
    __syncthreads();
    store_sums<TILES>(sum[0], mine);
    __syncwarp(0xffffffffu);
    store_rows(mine, m, n_in, head > 0, b.d_z + first * (size_t)n_in);
}
#endif

static __global__ void __launch_bounds__(WARP *BACK_WARPS, 1)
    heads_back_tensor_kernel(struct back b)
{
#if CUDA_HAS_MMA
    GPU_SHARED(struct back_room, back_room);
    int n_in = b.heads.n_in, hidden = b.heads.hidden, i0 = warp() % 4 * 16, j0 = warp() / 4 * 32;
    size_t count = *b.rows.count;

    for (int head = 0; head < SPIN_HEADS; head++) {
        int n_out = b.heads.n_out[head];
        struct spin_head_layout at = spin_head_layout(n_in, hidden, n_out);
        float *to = b.partial + b.blocks * b.heads.offset[head] + blockIdx.x * at.size;
        struct back_sums s = {};

        stage_head(b.heads, b.param, head, &back_room->w);
        for (size_t first = (size_t)blockIdx.x * BACK_TILE; first < count;
             first += (size_t)b.blocks * BACK_TILE)
            back_tile(b, head, first, count, back_room, &s);
        store_gradients<1, 4>(s.w1, s.b1, i0, j0, hidden, n_in, to + at.w1, to + at.b1);
        store_gradients<1, 4>(s.w2, s.b2, i0, j0, hidden, hidden, to + at.w2, to + at.b2);
        if (n_out > 16)
            store_gradients<3, 1>(s.w3, s.b3, 0, DEEP * warp(), n_out, hidden, to + at.w3,
                                  to + at.b3);
        else
            store_gradients<1, 1>(s.w3, s.b3, 0, DEEP * warp(), n_out, hidden, to + at.w3,
                                  to + at.b3);
    }
#endif
}

/* Returns the number of blocks for n splats, at most one per multiprocessor. */
unsigned cuda_heads_tensor_blocks(struct spin_device *d, size_t n)
{
    size_t tiles = (n + BACK_TILE - 1) / BACK_TILE, most = (size_t)gpu_of(d)->processors;

    return (unsigned)(tiles < most ? tiles : most);
}

void cuda_heads_back_tensor(struct spin_device *d, const struct spin_heads *heads,
                            const float *param, const struct cuda_rows &rows, unsigned blocks,
                            const float *z, const float *d_raw, float *d_z, float *partial)
{
    struct back b = {*heads, param, rows, z, d_raw, d_z, partial, blocks};

    GPU_LAUNCH_SHARED(gpu_of(d), heads_back_tensor_kernel, blocks, WARP * BACK_WARPS,
                      sizeof(struct back_room), b);
}
