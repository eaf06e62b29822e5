/* Computes the four heads, forward and backward, as matrix products, on tensor cores if the GPU is
 * faster with them (mma.h). heads.cu computes heads up to 64 wide. For wider heads, this file
 * launches one kernel per product. Splats are processed in chunks, whose activations are in scratch
 * memory; the backward pass recomputes the activations. The gradient of the weights is a sum over
 * splats. This sum is divided into slices that depend only on the sizes, and the partial sums of
 * the slices are added in order. */
#include "device/cuda/cuda.h"

#include "device/cuda/heads.h"
#include "device/cuda/mma.h"
#include "math/mlp.h"

enum { CHUNK = 1 << 15, SLICE = 1 << 10, TILE = 64, STEP = 16, EACH = 4, SIDE = TILE / EACH };

/* A matrix product C [m][n] = epilogue(A B), where A(i, k) = a[i * a_row + k * a_col] and B(k, j) =
 * b[k * b_row + j * b_col]. One dimension, m or k, counts splats; it is at most *count - first,
 * which only the GPU knows. The epilogue is applied to each element of A B, called `sum` below: */
enum epilogue {
    GELU,  /* gelu(sum + bias); `slope`, unless NULL, receives the derivative */
    RELU,  /* relu(sum + bias); `slope`, unless NULL, receives the derivative */
    BIAS,  /* sum + bias */
    TIMES, /* sum times `slope` */
    ADD,   /* adds the sum to C */
    SET,
};
struct product {
    int m, n, k;
    const float *a, *b;
    size_t a_row, a_col, b_row, b_col, c_row;
    float *c;
    const float *bias; /* [n] */
    float *slope;      /* has the layout of c, see enum epilogue */
    /* number of all splats, in device memory, which limits m or k; NULL: no limit */
    const uint32_t *count;
    size_t first; /* first splat of the chunk */
    /* True: the splats are dimension k instead of m. They are divided into slices, and C is
     * [slices][m][c_row]. */
    bool k_counts;
    enum epilogue epilogue;
};

static __device__ void finish(const struct product &x, float sum, size_t i, size_t j)
{
    float *c = x.c + i * x.c_row + j, slope = 1;

    switch (x.epilogue) {
    case GELU:
        sum += x.bias[j];
        *c = x.slope ? spin_gelu_both(sum, &slope) : spin_gelu(sum);
        break;
    case RELU:
        sum += x.bias[j];
        *c = spin_relu(sum);
        slope = spin_relu_slope(sum);
        break;
    case BIAS:
        *c = sum + x.bias[j];
        return;
    case TIMES:
        *c = sum * x.slope[i * x.c_row + j];
        return;
    case ADD:
        *c += sum;
        return;
    default:
        *c = sum;
        return;
    }
    if (x.slope)
        x.slope[i * x.c_row + j] = slope;
}

/* The structs `plain` and `tensor` have the same functions. A block computes a tile of C
 * [TILE][TILE] and keeps STEP columns of A and STEP rows of B in shared memory, with row strides
 * that avoid bank conflicts.
 *     at(): index in shared memory of element k of a row of A or of a column of B, i
 *     add(): adds STEP products to the EACH * EACH elements of a thread
 *     element_position(): row and column of element e of a thread */
/* In fp32, a thread computes the rows side_i + SIDE u and the columns side_j + SIDE v of the tile.
 */
struct plain {
    enum { ROOM = STEP * (TILE + 1) };
    static __device__ int at(int k, int i) { return k * (TILE + 1) + i; }

    static __device__ void add(const float *a, const float *b, float *sum)
    {
        int side_i = (int)threadIdx.x / SIDE, side_j = (int)threadIdx.x % SIDE;

        for (int k = 0; k < STEP; k++) {
            float left[EACH], right[EACH];

            for (int u = 0; u < EACH; u++) {
                left[u] = a[at(k, side_i + SIDE * u)];
                right[u] = b[at(k, side_j + SIDE * u)];
            }
            for (int u = 0; u < EACH; u++)
                for (int v = 0; v < EACH; v++)
                    sum[u * EACH + v] += left[u] * right[v];
        }
    }

    static __device__ void element_position(int e, int *i, int *j)
    {
        *i = (int)threadIdx.x / SIDE + SIDE * (e / EACH);
        *j = (int)threadIdx.x % SIDE + SIDE * (e % EACH);
    }
};

#if CUDA_HAS_MMA
/* On tensor cores, a warp computes 16 rows and 32 columns of the tile: EACH products of mma.h side
 * by side. */
struct tensor {
    enum { LONG = STEP + 4, ROOM = TILE * LONG, DEEP = 8 };
    static __device__ int at(int k, int i) { return i * LONG + k; }
    static __device__ int first_i() { return (int)threadIdx.x / 32 % 4 * 16; }
    static __device__ int first_j() { return (int)threadIdx.x / 128 * 32; }

    static __device__ void add(const float *a, const float *b, float *sum)
    {
        int g = (int)threadIdx.x % 32 / 4, t = (int)threadIdx.x % 4;

        for (int k = 0; k < STEP; k += DEEP) {
            cuda_split<4> left;
            cuda_split<2 * EACH> right;

            for (int r = 0; r < 4; r++)
                left.set(r, a[at(k + t + r / 2 * 4, first_i() + g + r % 2 * 8)]);
            for (int r = 0; r < 2 * EACH; r++)
                right.set(r, b[at(k + t + r % 2 * 4, first_j() + r / 2 * 8 + g)]);
            cuda_mma<EACH>(sum, left, right);
        }
    }

    static __device__ void element_position(int e, int *i, int *j)
    {
        int g = (int)threadIdx.x % 32 / 4, t = (int)threadIdx.x % 4;

        *i = first_i() + g + e % 4 / 2 * 8;
        *j = first_j() + e / 4 * 8 + 2 * t + e % 2;
    }
};
#else
typedef struct plain tensor; /* for GPUs before sm_80, which have no tf32 tensor cores */
#endif

template <class form> static __device__ void multiply_tile(struct product x, float *a, float *b)
{
    int i0 = (int)blockIdx.y * TILE, j0 = (int)blockIdx.x * TILE, m = x.m, k_end = x.k, k0 = 0;
    float sum[EACH * EACH] = {0};

    if (x.count) {
        size_t left = *x.count > x.first ? *x.count - x.first : 0;

        if (x.k_counts)
            k_end = left < (size_t)k_end ? (int)left : k_end;
        else
            m = left < (size_t)m ? (int)left : m;
    }
    if (x.k_counts) {
        k0 = (int)blockIdx.z * SLICE;
        k_end = k_end < k0 + SLICE ? k_end : k0 + SLICE;
        x.c += (size_t)blockIdx.z * (size_t)m * x.c_row;
    }
    if (i0 >= m)
        return;
    for (; k0 < k_end; k0 += STEP) {
        /* The loop index is split so that neighbouring threads read consecutive memory. */
        for (int at = (int)threadIdx.x; at < STEP * TILE; at += (int)blockDim.x) {
            int k = x.a_col == 1 ? at % STEP : at / TILE, i = x.a_col == 1 ? at / STEP : at % TILE;
            bool in = i0 + i < m && k0 + k < k_end;

            a[form::at(k, i)] =
                in ? x.a[(size_t)(i0 + i) * x.a_row + (size_t)(k0 + k) * x.a_col] : 0;
        }
        for (int at = (int)threadIdx.x; at < STEP * TILE; at += (int)blockDim.x) {
            int k = x.b_row == 1 ? at % STEP : at / TILE, j = x.b_row == 1 ? at / STEP : at % TILE;
            bool in = j0 + j < x.n && k0 + k < k_end;

            b[form::at(k, j)] =
                in ? x.b[(size_t)(k0 + k) * x.b_row + (size_t)(j0 + j) * x.b_col] : 0;
        }
        __syncthreads();
        form::add(a, b, sum);
        __syncthreads();
    }
    for (int e = 0; e < EACH * EACH; e++) {
        int i, j;

        form::element_position(e, &i, &j);
        if (i0 + i < m && j0 + j < x.n)
            finish(x, sum[e], (size_t)(i0 + i), (size_t)(j0 + j));
    }
}

static __global__ void product_kernel(struct product x)
{
    __shared__ float a[plain::ROOM], b[plain::ROOM];

    multiply_tile<plain>(x, a, b);
}

static __global__ void tensor_kernel(struct product x)
{
    __shared__ float a[tensor::ROOM], b[tensor::ROOM];

    multiply_tile<tensor>(x, a, b);
}

static bool is_narrow(const struct spin_heads *heads)
{
    return heads->n_in <= CUDA_HEADS_WIDE && heads->hidden <= CUDA_HEADS_WIDE;
}

static int slices_of(int k) { return (k + SLICE - 1) / SLICE; }

static void multiply(struct spin_device *d, const struct product &x)
{
    dim3 blocks((unsigned)((x.n + TILE - 1) / TILE), (unsigned)((x.m + TILE - 1) / TILE),
                x.k_counts ? (unsigned)slices_of(x.k) : 1);
    struct product product = x;

    if (cuda_of(d)->tensor)
        GPU_LAUNCH(gpu_of(d), tensor_kernel, blocks, SIDE * SIDE, product);
    else
        GPU_LAUNCH(gpu_of(d), product_kernel, blocks, SIDE * SIDE, product);
}

/* ---- Forward --------------------------------------------------------------------------------- */

static const int column_of[SPIN_HEADS] = {SPIN_ATTR_SCALE, SPIN_ATTR_ROTATION, SPIN_ATTR_SH,
                                          SPIN_ATTR_OPACITY};

/* A chunk of splats and its activations, [CHUNK][hidden] each. */
struct chunk {
    const struct spin_heads *heads;
    const float *param, *z;
    int n;                 /* capacity of the chunk, in splats */
    const uint32_t *count; /* number of splats; NULL: n */
    size_t first;
    /* activations and slopes; slopes are NULL in the forward pass */
    float *a1, *a2, *slope1, *slope2;
};

static struct spin_head_layout layout_of(const struct spin_heads *heads, int h)
{
    return spin_head_layout(heads->n_in, heads->hidden, heads->n_out[h]);
}

/* Returns the product of a layer: y = W x + b, with W [n_out][n_in]. */
static struct product layer(const struct chunk *chunk, const float *w, const float *bias, int n_in,
                            int n_out, const float *x, size_t x_ld, float *y, size_t y_ld)
{
    struct product p = {};

    p.m = chunk->n;
    p.n = n_out;
    p.k = n_in;
    p.a = x;
    p.a_row = x_ld;
    p.a_col = 1;
    p.b = w;
    p.b_row = 1;
    p.b_col = (size_t)n_in;
    p.c = y;
    p.c_row = y_ld;
    p.bias = bias;
    p.count = chunk->count;
    p.first = chunk->first;
    p.epilogue = BIAS;
    return p;
}

static void hidden_layers(struct spin_device *d, const struct chunk *chunk, int h)
{
    const struct spin_heads *heads = chunk->heads;
    struct spin_head_layout at = layout_of(heads, h);
    const float *p = chunk->param + heads->offset[h];
    size_t ld = (size_t)heads->hidden;
    struct product one = layer(chunk, p + at.w1, p + at.b1, heads->n_in, heads->hidden, chunk->z,
                               (size_t)heads->n_in, chunk->a1, ld);
    struct product two = layer(chunk, p + at.w2, p + at.b2, heads->hidden, heads->hidden, chunk->a1,
                               ld, chunk->a2, ld);

    one.epilogue = two.epilogue = heads->relu ? RELU : GELU;
    one.slope = chunk->slope1;
    two.slope = chunk->slope2;
    multiply(d, one);
    multiply(d, two);
}

void cuda_mlp(struct spin_device *d, const struct spin_heads *heads, const float *param, size_t n,
              const float *z, float *raw)
{
    size_t ld = (size_t)heads->hidden, room = n < CHUNK ? n : (size_t)CHUNK;
    float *scratch;
    cuda_clocked clocked(d, SPIN_OP_MLP);

    if (is_narrow(heads)) {
        cuda_heads(d, heads, param, n, z, raw);
        return;
    }
    scratch = (float *)cuda_scratch(d, CUDA_SCRATCH_MLP, 2 * room * ld * sizeof *scratch);
    if (!scratch)
        return;
    for (size_t first = 0; first < n; first += CHUNK) {
        struct chunk chunk = {};

        chunk.heads = heads;
        chunk.param = param;
        chunk.z = z + first * (size_t)heads->n_in;
        chunk.n = n - first < CHUNK ? (int)(n - first) : CHUNK;
        chunk.a1 = scratch;
        chunk.a2 = scratch + room * ld;
        for (int h = 0; h < SPIN_HEADS; h++) {
            struct spin_head_layout at = layout_of(heads, h);
            const float *p = param + heads->offset[h];

            hidden_layers(d, &chunk, h);
            multiply(d, layer(&chunk, p + at.w3, p + at.b3, heads->hidden, heads->n_out[h],
                              chunk.a2, ld, raw + first * SPIN_ATTR + column_of[h], SPIN_ATTR));
        }
    }
}

/* ---- Backward -------------------------------------------------------------------------------- */

/* Computes partial [slices][n], the sums of d_y over the splats of each slice. Rows of d_y are ld
 * floats apart. */
static __global__ void bias_kernel(int n, const uint32_t *count, size_t first, int n_splats,
                                   const float *d_y, size_t ld, float *partial)
{
    int j = (int)threadIdx.x, i = (int)blockIdx.x * SLICE, end = i + SLICE;
    size_t left = *count > first ? *count - first : 0;
    float sum = 0;

    end = end < n_splats ? end : n_splats;
    end = (size_t)end < left ? end : (int)left;
    if (j >= n)
        return;
    for (; i < end; i++)
        sum += d_y[(size_t)i * ld + (size_t)j];
    partial[blockIdx.x * (size_t)n + (size_t)j] = sum;
}

static __global__ void add_slices_kernel(int n_slices, size_t n, const float *partial, float *to)
{
    size_t i = GPU_INDEX();

    for (int s = 0; i < n && s < n_slices; s++)
        to[i] += partial[(size_t)s * n + i];
}

/* Adds the gradients of a layer's weights and bias: d_w [n_out][n_in] += d_y^T x, and d_b [n_out]
 * += the sum of d_y over the splats. */
static void weights_back(struct spin_device *d, const struct chunk *chunk, int n_in, int n_out,
                         const float *d_y, size_t d_y_ld, const float *x, size_t x_ld,
                         float *partial, float *d_w, float *d_b)
{
    struct product p = {};
    int slices = slices_of(chunk->n);

    p.m = n_out;
    p.n = n_in;
    p.k = chunk->n;
    p.a = d_y;
    p.a_row = 1;
    p.a_col = d_y_ld;
    p.b = x;
    p.b_row = x_ld;
    p.b_col = 1;
    p.c = partial;
    p.c_row = (size_t)n_in;
    p.count = chunk->count;
    p.first = chunk->first;
    p.k_counts = true;
    p.epilogue = SET;
    multiply(d, p);
    GPU_EACH(gpu_of(d), (size_t)n_out * (size_t)n_in, add_slices_kernel, slices,
             (size_t)n_out * (size_t)n_in, partial, d_w);
    GPU_LAUNCH(gpu_of(d), bias_kernel, (unsigned)slices, (unsigned)n_out, n_out, chunk->count,
               chunk->first, chunk->n, d_y, d_y_ld, partial);
    GPU_EACH(gpu_of(d), (size_t)n_out, add_slices_kernel, slices, (size_t)n_out, partial, d_b);
}

/* Computes the gradient of a layer's input, d_x = epilogue(d_y W). With TIMES, `slope` is the
 * derivative of the activation function of the layer below. */
static void layer_back(struct spin_device *d, const struct chunk *chunk, const float *w, int n_in,
                       int n_out, const float *d_y, size_t d_y_ld, enum epilogue epilogue,
                       float *slope, float *d_x)
{
    struct product p = {};

    p.m = chunk->n;
    p.n = n_in;
    p.k = n_out;
    p.a = d_y;
    p.a_row = d_y_ld;
    p.a_col = 1;
    p.b = w;
    p.b_row = (size_t)n_in;
    p.b_col = 1;
    p.c = d_x;
    p.c_row = (size_t)n_in;
    p.slope = slope;
    p.count = chunk->count;
    p.first = chunk->first;
    p.epilogue = epilogue;
    multiply(d, p);
}

static __global__ void gather_kernel(size_t n, size_t width, const uint32_t *count, size_t first,
                                     const uint32_t *row, const float *from, float *to)
{
    size_t i = GPU_INDEX(), at = i / width;

    if (at < n && first + at < *count)
        to[i] = from[row[at] * width + i % width];
}

/* Runs the backward pass of head h for a chunk. d_hidden and d_below [CHUNK][hidden] are scratch
 * memory. */
static void head_back(struct spin_device *d, const struct chunk *chunk, int h, const float *d_raw,
                      float *d_hidden, float *d_below, float *partial, float *d_param, float *d_z)
{
    const struct spin_heads *heads = chunk->heads;
    struct spin_head_layout at = layout_of(heads, h);
    const float *p = chunk->param + heads->offset[h], *d_out = d_raw + column_of[h];
    float *g = d_param + heads->offset[h];
    int hidden = heads->hidden, n_out = heads->n_out[h];
    size_t ld = (size_t)hidden, in_ld = (size_t)heads->n_in;

    hidden_layers(d, chunk, h);
    weights_back(d, chunk, hidden, n_out, d_out, SPIN_ATTR, chunk->a2, ld, partial, g + at.w3,
                 g + at.b3);
    layer_back(d, chunk, p + at.w3, hidden, n_out, d_out, SPIN_ATTR, TIMES, chunk->slope2,
               d_hidden);
    weights_back(d, chunk, hidden, hidden, d_hidden, ld, chunk->a1, ld, partial, g + at.w2,
                 g + at.b2);
    layer_back(d, chunk, p + at.w2, hidden, hidden, d_hidden, ld, TIMES, chunk->slope1, d_below);
    weights_back(d, chunk, heads->n_in, hidden, d_below, ld, chunk->z, in_ld, partial, g + at.w1,
                 g + at.b1);
    layer_back(d, chunk, p + at.w1, heads->n_in, hidden, d_below, ld, h > 0 ? ADD : SET, NULL, d_z);
}

void cuda_mlp_back(struct spin_device *d, const struct spin_heads *heads, const float *param,
                   const struct spin_active *active, const float *z, const float *d_raw,
                   float *d_param, float *d_z)
{
    size_t n = active->most, ld = (size_t)heads->hidden, in_ld = (size_t)heads->n_in;
    size_t room = n < CHUNK ? n : (size_t)CHUNK, widest = ld > in_ld ? ld : in_ld;
    size_t partials = (size_t)slices_of((int)room) * (widest > 48 ? widest : 48) * widest;
    size_t floats = room * (6 * ld + in_ld) + partials;
    float *at, *rows_of_z;
    cuda_clocked clocked(d, SPIN_OP_MLP_BACK);

    if (is_narrow(heads)) {
        cuda_heads_back(d, heads, param, active, z, d_raw, d_param, d_z);
        return;
    }
    at = (float *)cuda_scratch(d, CUDA_SCRATCH_MLP, floats * sizeof *at);
    if (!at || n == 0)
        return;
    rows_of_z = at + 6 * room * ld;
    for (size_t first = 0; first < n; first += CHUNK) {
        struct chunk chunk = {};

        chunk.heads = heads;
        chunk.param = param;
        chunk.z = rows_of_z;
        chunk.n = n - first < CHUNK ? (int)(n - first) : CHUNK;
        chunk.count = active->n;
        chunk.first = first;
        chunk.a1 = at;
        chunk.a2 = at + room * ld;
        chunk.slope1 = at + 2 * room * ld;
        chunk.slope2 = at + 3 * room * ld;
        GPU_EACH(gpu_of(d), (size_t)chunk.n * in_ld, gather_kernel, (size_t)chunk.n, in_ld,
                 active->n, first, active->row + first, z, rows_of_z);
        for (int h = 0; h < SPIN_HEADS; h++)
            head_back(d, &chunk, h, d_raw + first * SPIN_ATTR, at + 4 * room * ld,
                      at + 5 * room * ld, rows_of_z + room * in_ld, d_param, d_z + first * in_ld);
    }
}
