/* Computes heads that are at most 64 wide, forward and backward, in fp32. A block computes all
 * layers for 32 splats at a time, with activations in shared memory and gradients of the weights in
 * registers. heads_tensor.cu does the same on tensor cores; mlp.cu computes wider heads.
 *
 * In the forward pass, a block computes one head for 32 splats. In the backward pass, each launch
 * is for one head and has at most MOST_BLOCKS blocks, enough to fill a large GPU. A block processes
 * every n-th group of 32 splats, where n is the number of blocks, and stores a partial gradient of
 * the weights. Another kernel adds the partial gradients in order. */
#include "device/cuda/heads.h"

#include "math/mlp.h"

enum { ROWS = 32, WIDE = CUDA_HEADS_WIDE, STEP = 16, THREADS = 256, MOST_BLOCKS = 264 };
/* Numbers of elements that each thread computes: OWN of the activations, OWN_WEIGHTS of a weight
 * matrix. */
enum { OWN = ROWS * WIDE / THREADS, OWN_WEIGHTS = WIDE * WIDE / THREADS };

/* Matrix products. Activations are [ROWS][WIDE] in shared memory, indexed by cell(row, column);
 * `stage` contains STEP rows of a weight matrix, WIDE columns each.
 *     times(): sum += columns [k0, k0 + STEP) of x times stage
 *     element_position(): row and column of element e of a thread's sum of times()
 *     outer(): sum [n][WIDE] += d^T x
 *     outer_position(): the same as element_position(), for the sum of outer() */
enum { ROOM = ROWS * WIDE, STAGE_ROW = WIDE, STAGE = (int)STEP * STAGE_ROW };
static __device__ int cell(int row, int column) { return row * WIDE + column; }

static __device__ void element_position(int e, int *row, int *column)
{
    *row = (int)threadIdx.x / 32 + 8 * (e / 2);
    *column = (int)threadIdx.x % 32 + 32 * (e % 2);
}
static __device__ void times(const float *x, int k0, const float *stage, float *sum)
{
    int row = (int)threadIdx.x / 32, column = (int)threadIdx.x % 32;

    for (int k = 0; k < STEP; k++) {
        float right[2] = {stage[k * STAGE_ROW + column], stage[k * STAGE_ROW + column + 32]};

        for (int e = 0; e < OWN; e++)
            sum[e] += x[cell(row + 8 * (e / 2), k0 + k)] * right[e % 2];
    }
}

static __device__ void outer_position(int e, int *i, int *j)
{
    *i = (int)threadIdx.x / 16 + 16 * (e / 4);
    *j = (int)threadIdx.x % 16 + 16 * (e % 4);
}
static __device__ void outer(int n, const float *d, const float *x, float *sum)
{
    int i = (int)threadIdx.x / 16, j = (int)threadIdx.x % 16;

    for (int row = 0; row < ROWS; row++) {
        float right[4];

        for (int v = 0; v < 4; v++)
            right[v] = x[cell(row, j + 16 * v)];
        for (int u = 0; u < 4; u++)
            if (i + 16 * u < n)
                for (int v = 0; v < 4; v++)
                    sum[4 * u + v] += d[cell(row, i + 16 * u)] * right[v];
    }
}

/* Computes sum = x W^T with W [n_out][n_in]; if `back` is true, sum = x W. All threads must call
 * the function. After the call, x and `stage` may be overwritten. */
static __device__ void multiply(const float *x, const float *w, int n_in, int n_out, bool back,
                                float *stage, float *sum)
{
    int n_k = back ? n_out : n_in, n_j = back ? n_in : n_out;

    for (int e = 0; e < OWN; e++)
        sum[e] = 0;
    for (int k0 = 0; k0 < n_k; k0 += STEP) {
        for (int at = (int)threadIdx.x; at < STEP * WIDE; at += THREADS) {
            int k = back ? at / WIDE : at % STEP, j = back ? at % WIDE : at / STEP;
            bool in = k0 + k < n_k && j < n_j;

            stage[k * STAGE_ROW + j] = in ? w[back ? (k0 + k) * n_in + j : j * n_in + k0 + k] : 0;
        }
        __syncthreads();
        times(x, k0, stage, sum);
        __syncthreads();
    }
}

/* Sets `to` to activation(sum + bias), and to 0 in the columns beyond `hidden`. Unless `slope` is
 * NULL, sets it to the derivative of the activation function. */
static __device__ void activate(const float *sum, const float *bias, int hidden, bool relu,
                                float *to, float *slope)
{
    for (int e = 0; e < OWN; e++) {
        float v = 0, s = 0;
        int row, column;

        element_position(e, &row, &column);
        if (column < hidden) {
            float x = sum[e] + bias[column];

            if (relu) {
                v = spin_relu(x);
                s = spin_relu_slope(x);
            } else {
                v = slope ? spin_gelu_both(x, &s) : spin_gelu(x);
            }
        }
        to[cell(row, column)] = v;
        if (slope)
            slope[e] = s;
    }
}

/* Copies the first n columns of m rows of `from` to `to` [ROWS][WIDE], and sets the rest of `to` to
 * zero. `number` lists the rows to copy; if it is NULL, they are consecutive. */
static __device__ void load_rows(float *to, const float *from, size_t ld, const uint32_t *number,
                                 int m, int n)
{
    for (int at = (int)threadIdx.x; at < ROWS * WIDE; at += THREADS) {
        int row = at / WIDE, column = at % WIDE;
        float v = 0;

        if (row < m && column < n)
            v = from[(number ? number[row] : (size_t)row) * ld + (size_t)column];
        to[cell(row, column)] = v;
    }
}

/* ---- Forward --------------------------------------------------------------------------------- */

static __device__ void forward(const struct spin_heads &heads, const float *param, size_t n,
                               const float *z, float *raw, float *x, float *y, float *stage)
{
    int head = (int)blockIdx.y, n_in = heads.n_in, hidden = heads.hidden, n_out = heads.n_out[head];
    size_t first = (size_t)blockIdx.x * ROWS;
    int m = n - first < ROWS ? (int)(n - first) : (int)ROWS;
    struct spin_head_layout at = spin_head_layout(n_in, hidden, n_out);
    const float *p = param + heads.offset[head];
    float sum[OWN];

    load_rows(x, z + first * (size_t)n_in, (size_t)n_in, NULL, m, n_in);
    multiply(x, p + at.w1, n_in, hidden, false, stage, sum);
    activate(sum, p + at.b1, hidden, heads.relu, y, NULL);
    multiply(y, p + at.w2, hidden, hidden, false, stage, sum);
    activate(sum, p + at.b2, hidden, heads.relu, x, NULL);
    multiply(x, p + at.w3, hidden, n_out, false, stage, sum);
    for (int e = 0; e < OWN; e++) {
        int row, column;

        element_position(e, &row, &column);
        if (row < m && column < n_out)
            raw[(first + (size_t)row) * SPIN_ATTR + (size_t)(cuda_heads_column(head) + column)] =
                sum[e] + p[at.b3 + (size_t)column];
    }
}

static __global__ void heads_kernel(struct spin_heads heads, const float *param, size_t n,
                                    const float *z, float *raw)
{
    __shared__ float x[ROOM], y[ROOM], stage[STAGE];

    forward(heads, param, n, z, raw, x, y, stage);
}

void cuda_heads(struct spin_device *d, const struct spin_heads *heads, const float *param, size_t n,
                const float *z, float *raw)
{
    dim3 blocks((unsigned)((n + ROWS - 1) / ROWS), SPIN_HEADS);
    struct spin_heads h = *heads;

    if (n == 0)
        return;
    if (cuda_heads_fit_tensor(d))
        cuda_heads_tensor(d, heads, param, n, z, raw);
    else
        GPU_LAUNCH(gpu_of(d), heads_kernel, blocks, THREADS, h, param, n, z, raw);
}

/* ---- Backward -------------------------------------------------------------------------------- */

struct back {
    struct spin_heads heads;
    int head;
    const float *param;
    struct cuda_rows rows;
    const float *z, *d_raw;
    float *d_z, *partial; /* `partial`: [blocks][number of parameters of the head] */
};

/* Returns the sum of column threadIdx.x % WIDE over this thread's quarter of the rows. */
static __device__ float sum_of_rows(const float *d)
{
    int column = (int)threadIdx.x % WIDE, first = (int)threadIdx.x / WIDE * (ROWS / 4);
    float sum = 0;

    for (int row = first; row < first + ROWS / 4; row++)
        sum += d[cell(row, column)];
    return sum;
}

/* Stores the partial gradients of a block: those of the weights in `to` [n][n_in], those of the
 * bias in `bias` [n]. For the bias, four threads have each summed a quarter of the rows of a column
 * (sum_of_bias); they exchange these sums in `stage`. */
static __device__ void store_gradients(const float *sum, float sum_of_bias, int n, int n_in,
                                       float *stage, float *to, float *bias)
{
    int me = (int)threadIdx.x;

    for (int e = 0; e < OWN_WEIGHTS; e++) {
        int i, j;

        outer_position(e, &i, &j);
        if (i < n && j < n_in)
            to[i * n_in + j] = sum[e];
    }
    __syncthreads();
    stage[me] = sum_of_bias;
    __syncthreads();
    if (me < n)
        bias[me] = (stage[me] + stage[me + WIDE]) + (stage[me + 2 * WIDE] + stage[me + 3 * WIDE]);
}

/* Sets `to` to `sum` times `slope`, the derivatives of the activation function of the layer below.
 */
static __device__ void through_activation(const float *sum, const float *slope, float *to)
{
    for (int e = 0; e < OWN; e++) {
        int row, column;

        element_position(e, &row, &column);
        to[cell(row, column)] = sum[e] * slope[e];
    }
    __syncthreads();
}

/* Runs the backward pass of one head for all groups of splats of this block. z, a1, a2 and g
 * [ROWS][WIDE] are in shared memory; g contains the gradient of one layer after the other. */
static __device__ void backward(const struct back &b, float *z, float *a1, float *a2, float *g,
                                float *stage)
{
    int n_in = b.heads.n_in, hidden = b.heads.hidden, n_out = b.heads.n_out[b.head];
    struct spin_head_layout at = spin_head_layout(n_in, hidden, n_out);
    const float *p = b.param + b.heads.offset[b.head];
    float w1[OWN_WEIGHTS] = {0}, w2[OWN_WEIGHTS] = {0}, w3[OWN_WEIGHTS] = {0};
    float b1 = 0, b2 = 0, b3 = 0, sum[OWN], slope1[OWN], slope2[OWN], *to;
    size_t count = *b.rows.count;

    for (size_t first = (size_t)blockIdx.x * ROWS; first < count;
         first += (size_t)gridDim.x * ROWS) {
        int m = count - first < ROWS ? (int)(count - first) : (int)ROWS;

        load_rows(z, b.z, (size_t)n_in, b.rows.row + first, m, n_in);
        load_rows(g, b.d_raw + first * SPIN_ATTR + cuda_heads_column(b.head), SPIN_ATTR, NULL, m,
                  n_out);
        multiply(z, p + at.w1, n_in, hidden, false, stage, sum);
        activate(sum, p + at.b1, hidden, b.heads.relu, a1, slope1);
        multiply(a1, p + at.w2, hidden, hidden, false, stage, sum);
        activate(sum, p + at.b2, hidden, b.heads.relu, a2, slope2);
        __syncthreads();
        outer(n_out, g, a2, w3);
        b3 += sum_of_rows(g);
        multiply(g, p + at.w3, hidden, n_out, true, stage, sum);
        through_activation(sum, slope2, g);
        outer(hidden, g, a1, w2);
        b2 += sum_of_rows(g);
        multiply(g, p + at.w2, hidden, hidden, true, stage, sum);
        through_activation(sum, slope1, g);
        outer(hidden, g, z, w1);
        b1 += sum_of_rows(g);
        multiply(g, p + at.w1, n_in, hidden, true, stage, sum);
        for (int e = 0; e < OWN; e++) {
            int row, column;

            element_position(e, &row, &column);
            if (row >= m || column >= n_in)
                continue;
            to = b.d_z + (first + (size_t)row) * (size_t)n_in + (size_t)column;
            *to = b.head > 0 ? *to + sum[e] : sum[e];
        }
    }
    to = b.partial + blockIdx.x * at.size;
    store_gradients(w1, b1, hidden, n_in, stage, to + at.w1, to + at.b1);
    store_gradients(w2, b2, hidden, hidden, stage, to + at.w2, to + at.b2);
    store_gradients(w3, b3, n_out, hidden, stage, to + at.w3, to + at.b3);
}

static __global__ void __launch_bounds__(THREADS, 2) heads_back_kernel(struct back b)
{
    __shared__ float z[ROOM], a1[ROOM], a2[ROOM], g[ROOM], stage[STAGE];

    backward(b, z, a1, a2, g, stage);
}

/* Adds the partial gradients of all blocks to d_param. In `partial`, those of a head start at
 * n_blocks times the offset of the head. */
static __global__ void add_blocks_kernel(struct spin_heads heads, unsigned n_blocks,
                                         const float *partial, float *d_param)
{
    size_t i = GPU_INDEX(), size;
    int head = 0;
    float sum = 0;

    if (i >= heads.offset[SPIN_HEADS])
        return;
    while (i >= heads.offset[head + 1])
        head++;
    size = heads.offset[head + 1] - heads.offset[head];
    partial += n_blocks * heads.offset[head] + (i - heads.offset[head]);
    for (unsigned b = 0; b < n_blocks; b++)
        sum += partial[b * size];
    d_param[i] += sum;
}

void cuda_heads_back(struct spin_device *d, const struct spin_heads *heads, const float *param,
                     const struct spin_active *active, const float *z, const float *d_raw,
                     float *d_param, float *d_z)
{
    size_t tiles = (active->most + ROWS - 1) / ROWS, n = heads->offset[SPIN_HEADS];
    bool tensor = cuda_heads_fit_tensor(d);
    unsigned blocks = tensor                ? cuda_heads_tensor_blocks(d, active->most)
                      : tiles < MOST_BLOCKS ? (unsigned)tiles
                                            : (unsigned)MOST_BLOCKS;
    float *partial = (float *)cuda_scratch(d, CUDA_SCRATCH_MLP, (blocks * n + 1) * sizeof *partial);
    struct cuda_rows rows = cuda_rows_of(active, 0, SIZE_MAX);
    struct spin_heads h = *heads;

    if (!partial || blocks == 0)
        return;
    if (tensor)
        cuda_heads_back_tensor(d, heads, param, rows, blocks, z, d_raw, d_z, partial);
    else
        for (int head = 0; head < SPIN_HEADS; head++) {
            struct back b = {h, head,  param, rows,
                             z, d_raw, d_z,   partial + blocks * heads->offset[head]};

            GPU_LAUNCH(gpu_of(d), heads_back_kernel, blocks, THREADS, b);
        }
    GPU_EACH(gpu_of(d), n, add_blocks_kernel, h, blocks, partial, d_param);
}
