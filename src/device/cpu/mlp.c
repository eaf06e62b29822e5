/* The four heads on the CPU, forward and backward.
 *
 * Splats are processed in blocks of 96, so that the activations of a block and all weights stay in
 * the second-level cache, and only the outputs are written to memory. The matrix products compute a
 * tile of the result at a time, whose 6 rows (6 x 64 values with AVX-512) are held in registers.
 * Each step multiplies one row of the right factor by six broadcast values of the left factor and
 * adds the products to the tile. Weights are copied once per call; the copy is padded to whole
 * vectors, and transposed in the forward pass.
 *
 * The backward pass recomputes the activations (docs/method.md 3.4). The gradient of the weights is
 * a sum over splats. The blocks are divided among at most 32 tasks, whose number depends only on
 * the number of splats. Each task has its own partial sum, and the partial sums are added in the
 * order of the tasks. */
#include "device/cpu/cpu.h"

#include <string.h>

#include "math/mlp.h"

#if defined(__AVX512F__)
enum { LANES = 16, TILE_VECS = 4 };
#elif defined(__AVX__)
enum { LANES = 8, TILE_VECS = 2 };
#elif defined(__aarch64__)
enum { LANES = 4, TILE_VECS = 4 };
#else
enum { LANES = 4, TILE_VECS = 2 };
#endif
enum { BLOCK = 96, TILE_ROWS = 6, MAX_TASKS = 32, PAD = 16 };

#define ALWAYS_INLINE static inline __attribute__((always_inline))

/* vec: a vector of LANES floats. vec_at: the same vector, for loads and stores at addresses that
 * need not be aligned. */
typedef float vec __attribute__((vector_size(LANES * 4)));
typedef float vec_at __attribute__((vector_size(LANES * 4), aligned(4), may_alias));

/* ---- Matrix product -------------------------------------------------------------------------- */

/* A matrix product C [m][n] = start + A B, where A(i, k) = a[i * a_row + k * a_col], and the rows
 * of B and C are ldb and ldc floats apart. If `from` is NULL, `start` is zero; otherwise it is the
 * matrix at `from`, whose rows are from_ld floats apart. A from_ld of 0 repeats a single row, such
 * as a bias. n is a multiple of 16. */
struct product {
    int m, n, k;
    const float *a;
    size_t a_row, a_col;
    const float *b;
    size_t ldb;
    float *c;
    size_t ldc;
    const float *from;
    size_t from_ld;
};

/* Computes one tile of C. After inlining, `rows` and `vecs` are constants, so the sums stay in
 * registers. */
ALWAYS_INLINE void multiply_tile(const struct product *x, int rows, int vecs, size_t a_row,
                                 size_t a_col, const float *a, const float *b, const float *from,
                                 float *c)
{
    vec sum[TILE_ROWS][TILE_VECS];
    size_t ldb = x->ldb, ldc = x->ldc, from_ld = x->from_ld;
    int n_k = x->k;

    for (int i = 0; i < rows; i++)
        for (int j = 0; j < vecs; j++)
            sum[i][j] = *(const vec_at *)(from + (size_t)i * from_ld + j * LANES);
    for (int k = 0; k < n_k; k++) {
        vec right[TILE_VECS];

        for (int j = 0; j < vecs; j++)
            right[j] = *(const vec_at *)(b + j * LANES);
        for (int i = 0; i < rows; i++) {
            float left = a[(size_t)i * a_row];

            for (int j = 0; j < vecs; j++)
                sum[i][j] += left * right[j];
        }
        a += a_col;
        b += ldb;
    }
    for (int i = 0; i < rows; i++)
        for (int j = 0; j < vecs; j++)
            *(vec_at *)(c + (size_t)i * ldc + j * LANES) = sum[i][j];
}

/* Computes all rows of C in the column of tiles that starts at column n0: six rows at a time, then
 * four, then one. Callers pass the constant 1 for either a_row or a_col. */
ALWAYS_INLINE void multiply_column(const struct product *x, int vecs, size_t a_row, size_t a_col,
                                   int n0)
{
    static const float zeros[TILE_VECS * LANES];
    const float *a = x->a, *b = x->b + n0, *from = x->from ? x->from + n0 : zeros;
    float *c = x->c + n0;
    int i = 0;

    for (; i + 6 <= x->m; i += 6) {
        multiply_tile(x, 6, vecs, a_row, a_col, a, b, from, c);
        a += 6 * a_row, from += 6 * x->from_ld, c += 6 * x->ldc;
    }
    for (; i + 4 <= x->m; i += 4) {
        multiply_tile(x, 4, vecs, a_row, a_col, a, b, from, c);
        a += 4 * a_row, from += 4 * x->from_ld, c += 4 * x->ldc;
    }
    for (; i < x->m; i++) {
        multiply_tile(x, 1, vecs, a_row, a_col, a, b, from, c);
        a += a_row, from += x->from_ld, c += x->ldc;
    }
}

/* Defines a separate function for each width, since the compiler would run out of registers in a
 * single function for all widths. */
#define COLUMN(name, vecs, a_row, a_col)                                                           \
    static __attribute__((noinline)) void name(const struct product *x, int n0)                    \
    {                                                                                              \
        multiply_column(x, vecs < TILE_VECS ? vecs : TILE_VECS, a_row, a_col, n0);                 \
    }
COLUMN(column_1, 1, x->a_row, 1)
COLUMN(column_2, 2, x->a_row, 1)
COLUMN(column_3, 3, x->a_row, 1)
COLUMN(column_4, 4, x->a_row, 1)
COLUMN(column_turned_1, 1, 1, x->a_col)
COLUMN(column_turned_2, 2, 1, x->a_col)
COLUMN(column_turned_3, 3, 1, x->a_col)
COLUMN(column_turned_4, 4, 1, x->a_col)

typedef void column_fn(const struct product *x, int n0);

static void multiply_columns(const struct product *x, column_fn *const of_width[])
{
    int n0 = 0, width = TILE_VECS * LANES;

    for (; n0 + width <= x->n; n0 += width)
        of_width[TILE_VECS - 1](x, n0);
    if (n0 < x->n)
        of_width[(x->n - n0) / LANES - 1](x, n0);
}

static void multiply(const struct product *x)
{
    static column_fn *const of_width[] = {column_1, column_2, column_3, column_4};

    multiply_columns(x, of_width);
}

/* Like multiply(), for a matrix A that is stored transposed, so that sums run over the stored rows
 * of A. */
static void multiply_transposed(const struct product *x)
{
    static column_fn *const of_width[] = {column_turned_1, column_turned_2, column_turned_3,
                                          column_turned_4};

    multiply_columns(x, of_width);
}

/* ---- Padded weights -------------------------------------------------------------------------- */

/* A weight matrix or bias [rows][cols], which begins at index `param` of the parameters, and its
 * padded copy, which begins at index `at` of the copies. The rows of the copy, or its columns if
 * the copy is transposed, are `ld` floats apart. */
struct piece {
    size_t param, at, ld;
    int rows, cols;
};
enum { W1, B1, W2, B2, W3, B3, PIECES };

struct pieces {
    struct piece of[SPIN_HEADS][PIECES];
    size_t n_floats; /* number of floats of all copies; padding is zero */
    bool transposed;
};

static size_t padded(int n) { return ((size_t)n + PAD - 1) / PAD * PAD; }

/* Returns whether a copy is transposed. Weights have even indices in enum W1 to B3; biases, which
 * have odd ones, are never transposed. */
static bool is_turned(bool transposed, int piece) { return transposed && piece % 2 == 0; }

static struct pieces pieces_of(const struct spin_heads *heads, bool transposed)
{
    struct pieces p = {.transposed = transposed};

    for (int h = 0; h < SPIN_HEADS; h++) {
        int in = heads->n_in, hidden = heads->hidden, out = heads->n_out[h];
        struct spin_head_layout at = spin_head_layout(in, hidden, out);
        size_t param[PIECES] = {at.w1, at.b1, at.w2, at.b2, at.w3, at.b3};
        int rows[PIECES] = {hidden, 1, hidden, 1, out, 1};
        int cols[PIECES] = {in, hidden, hidden, hidden, hidden, out};

        for (int i = 0; i < PIECES; i++) {
            bool turned = is_turned(transposed, i);
            struct piece *piece = &p.of[h][i];

            piece->param = heads->offset[h] + param[i];
            piece->at = p.n_floats;
            piece->rows = rows[i];
            piece->cols = cols[i];
            piece->ld = padded(turned ? rows[i] : cols[i]);
            p.n_floats += piece->ld * (size_t)(turned ? cols[i] : rows[i]);
        }
    }
    return p;
}

static void pack_weights(const struct pieces *p, const float *param, float *copy)
{
    memset(copy, 0, p->n_floats * sizeof *copy);
    for (int h = 0; h < SPIN_HEADS; h++) {
        for (int i = 0; i < PIECES; i++) {
            const struct piece *piece = &p->of[h][i];
            size_t down = is_turned(p->transposed, i) ? 1 : piece->ld;
            size_t along = is_turned(p->transposed, i) ? piece->ld : 1;

            for (int r = 0; r < piece->rows; r++)
                for (int c = 0; c < piece->cols; c++)
                    copy[piece->at + (size_t)r * down + (size_t)c * along] =
                        param[piece->param + (size_t)r * (size_t)piece->cols + (size_t)c];
        }
    }
}

/* ---- Forward --------------------------------------------------------------------------------- */

struct job {
    const struct spin_heads *heads;
    /* layout of the weights as [in][out] (transposed) and as [out][in] */
    struct pieces turned, plain;
    const float *turned_w, *plain_w;
    size_t n;
    const uint32_t *rows;
    const float *z, *d_raw;
    float *raw, *d_z, *d_param;
    float *work; /* [workers][work_floats] */
    size_t work_floats;
    float *partial; /* [n_tasks][plain.n_floats] */
    int n_tasks;
    size_t blocks_each;
};

/* First column of a head's outputs in a row of attributes. */
static const int column_of[SPIN_HEADS] = {SPIN_ATTR_SCALE, SPIN_ATTR_ROTATION, SPIN_ATTR_SH,
                                          SPIN_ATTR_OPACITY};

/* Computes one layer of head h: y [m][n_out] = x [m][n_in] W + bias, where W is piece w and the
 * bias is piece w + 1. Rows of x and y are x_ld and y_ld floats apart, and rows of y are written up
 * to the padded n_out. */
static void layer_forward(const struct job *job, int h, int w, int m, const float *x, size_t x_ld,
                          float *y, size_t y_ld)
{
    const struct piece *piece = &job->turned.of[h][w];
    struct product product = {.m = m,
                              .n = (int)piece->ld,
                              .k = piece->cols,
                              .a = x,
                              .a_row = x_ld,
                              .a_col = 1,
                              .b = job->turned_w + piece->at,
                              .ldb = piece->ld,
                              .c = y,
                              .ldc = y_ld,
                              .from = job->turned_w + piece[1].at};

    multiply(&product);
}

static void activate(bool relu, size_t n, float *restrict x)
{
    if (relu)
        for (size_t i = 0; i < n; i++)
            x[i] = spin_relu(x[i]);
    else
        for (size_t i = 0; i < n; i++)
            x[i] = spin_gelu(x[i]);
}

/* Prefetches n floats, for writing if to_write is true, else for reading. */
ALWAYS_INLINE void prefetch(const float *from, size_t n, int to_write)
{
    for (size_t i = 0; i < n; i += 16) {
        if (to_write)
            __builtin_prefetch(from + i, 1);
        else
            __builtin_prefetch(from + i);
    }
}

static void mlp_task(void *context, size_t first, size_t end)
{
    const struct job *job = context;
    int m = (int)(end - first);
    size_t n_in = (size_t)job->heads->n_in, ld = padded(job->heads->hidden);
    float *h1 = job->work + (size_t)spin_pool_worker() * job->work_floats;
    float *h2 = h1 + BLOCK * ld, *out = h2 + BLOCK * ld;

    prefetch(job->raw + first * SPIN_ATTR, (size_t)m * SPIN_ATTR, 1);
    if (job->n - first > 2 * BLOCK)
        prefetch(job->z + (first + BLOCK) * n_in, BLOCK * n_in, 0);
    for (int h = 0; h < SPIN_HEADS; h++) {
        size_t n_out = (size_t)job->heads->n_out[h], out_ld = padded(job->heads->n_out[h]);
        float *raw = job->raw + first * SPIN_ATTR + column_of[h];

        layer_forward(job, h, W1, m, job->z + first * n_in, n_in, h1, ld);
        activate(job->heads->relu, (size_t)m * ld, h1);
        layer_forward(job, h, W2, m, h1, ld, h2, ld);
        activate(job->heads->relu, (size_t)m * ld, h2);
        /* The outputs are written directly if their padding fits into the row, since later heads
         * overwrite this padding. */
        if ((size_t)column_of[h] + out_ld <= SPIN_ATTR) {
            layer_forward(job, h, W3, m, h2, ld, raw, SPIN_ATTR);
            continue;
        }
        layer_forward(job, h, W3, m, h2, ld, out, out_ld);
        for (size_t i = 0; i < (size_t)m; i++)
            for (size_t j = 0; j < n_out; j++)
                raw[i * SPIN_ATTR + j] = out[i * out_ld + j];
    }
}

static size_t widest_out(const struct spin_heads *heads)
{
    size_t widest = 0;

    for (int h = 0; h < SPIN_HEADS; h++)
        if (padded(heads->n_out[h]) > widest)
            widest = padded(heads->n_out[h]);
    return widest;
}

void SPIN_CPU(mlp)(struct spin_device *d, const struct spin_heads *heads, const float *param,
                   size_t n, const float *z, float *raw)
{
    size_t n_workers = (size_t)spin_pool_n_threads(spin_cpu_pool(d));
    struct job job = {.heads = heads, .n = n, .z = z, .raw = raw};
    SPIN_CPU_CLOCK(d, SPIN_OP_MLP);
    float *scratch;

    job.turned = pieces_of(heads, true);
    job.work_floats = BLOCK * (2 * padded(heads->hidden) + widest_out(heads));
    scratch = spin_cpu_scratch_need(
        d, SPIN_SCRATCH_MLP, (job.turned.n_floats + n_workers * job.work_floats) * sizeof *scratch);
    if (!scratch)
        return;
    pack_weights(&job.turned, param, scratch);
    job.turned_w = scratch;
    job.work = scratch + job.turned.n_floats;
    spin_pool_rows(spin_cpu_pool(d), n, BLOCK, mlp_task, &job);
}

/* ---- Backward -------------------------------------------------------------------------------- */

/* Work arrays of one worker. Each has BLOCK rows; the comments state the length of a row. */
struct work {
    float *z, *d_z; /* padded n_in */
    /* padded `hidden`; activations of both hidden layers and their derivatives */
    float *a1, *slope1, *a2, *slope2;
    float *d;     /* padded `hidden`; gradient of a hidden layer */
    float *d_out; /* padded n_out; gradient of the outputs */
};

static size_t work_floats(const struct spin_heads *heads)
{
    return BLOCK * (2 * padded(heads->n_in) + 5 * padded(heads->hidden) + widest_out(heads));
}

static struct work work_at(const struct spin_heads *heads, float *at)
{
    size_t in = BLOCK * padded(heads->n_in), hidden = BLOCK * padded(heads->hidden);
    struct work w = {.z = at, .d_z = at + in, .a1 = at + 2 * in};

    w.slope1 = w.a1 + hidden;
    w.a2 = w.slope1 + hidden;
    w.slope2 = w.a2 + hidden;
    w.d = w.slope2 + hidden;
    w.d_out = w.d + hidden;
    return w;
}

static void activate_both(bool relu, size_t n, float *restrict x, float *restrict slope)
{
    if (relu)
        for (size_t i = 0; i < n; i++) {
            slope[i] = spin_relu_slope(x[i]);
            x[i] = spin_relu(x[i]);
        }
    else
        for (size_t i = 0; i < n; i++)
            x[i] = spin_gelu_both(x[i], &slope[i]);
}

/* Computes the gradient of a layer's input: d_x [m][ld] = d_y [m][d_y_ld] W. If `add` is true, the
 * product is added to d_x instead. */
static void layer_back(const struct job *job, int h, int w, int m, const float *d_y, size_t d_y_ld,
                       bool add, float *d_x)
{
    const struct piece *piece = &job->plain.of[h][w];
    struct product product = {.m = m,
                              .n = (int)piece->ld,
                              .k = piece->rows,
                              .a = d_y,
                              .a_row = d_y_ld,
                              .a_col = 1,
                              .b = job->plain_w + piece->at,
                              .ldb = piece->ld,
                              .c = d_x,
                              .ldc = piece->ld,
                              .from = add ? d_x : NULL,
                              .from_ld = add ? piece->ld : 0};

    multiply(&product);
}

/* Adds the gradient of a layer's weights, d_y^T x, to the partial sums. Rows of x are piece->ld
 * floats apart. The gradient of the bias is left to the caller. */
static void weights_back(const struct job *job, int h, int w, int m, const float *d_y,
                         size_t d_y_ld, const float *x, float *partial)
{
    const struct piece *piece = &job->plain.of[h][w];
    struct product product = {.m = piece->rows,
                              .n = (int)piece->ld,
                              .k = m,
                              .a = d_y,
                              .a_row = 1,
                              .a_col = d_y_ld,
                              .b = x,
                              .ldb = piece->ld,
                              .c = partial + piece->at,
                              .ldc = piece->ld,
                              .from = partial + piece->at,
                              .from_ld = piece->ld};

    multiply_transposed(&product);
}

/* Multiplies the gradient d by the slopes of the activation function, and adds the sum of the
 * products over the rows to d_bias. */
static void through_activation(int m, size_t ld, float *restrict d, const float *restrict slope,
                               float *restrict d_bias)
{
    for (int i = 0; i < m; i++, d += ld, slope += ld)
        for (size_t j = 0; j < ld; j++) {
            d[j] *= slope[j];
            d_bias[j] += d[j];
        }
}

static void head_back(const struct job *job, int h, int m, const float *d_raw, const struct work *w,
                      float *partial)
{
    const struct spin_heads *heads = job->heads;
    const struct piece *piece = job->plain.of[h];
    size_t in_ld = padded(heads->n_in), ld = padded(heads->hidden),
           out_ld = padded(heads->n_out[h]);
    size_t n_out = (size_t)heads->n_out[h];

    layer_forward(job, h, W1, m, w->z, in_ld, w->a1, ld);
    activate_both(heads->relu, (size_t)m * ld, w->a1, w->slope1);
    layer_forward(job, h, W2, m, w->a1, ld, w->a2, ld);
    activate_both(heads->relu, (size_t)m * ld, w->a2, w->slope2);

    for (int i = 0; i < m; i++) {
        const float *from = d_raw + (size_t)i * SPIN_ATTR + column_of[h];
        float *to = w->d_out + (size_t)i * out_ld;

        for (size_t j = 0; j < n_out; j++) {
            to[j] = from[j];
            partial[piece[B3].at + j] += from[j];
        }
    }
    weights_back(job, h, W3, m, w->d_out, out_ld, w->a2, partial);
    layer_back(job, h, W3, m, w->d_out, out_ld, false, w->d);
    through_activation(m, ld, w->d, w->slope2, partial + piece[B2].at);
    weights_back(job, h, W2, m, w->d, ld, w->a1, partial);
    layer_back(job, h, W2, m, w->d, ld, false, w->a2);
    through_activation(m, ld, w->a2, w->slope1, partial + piece[B1].at);
    weights_back(job, h, W1, m, w->a2, ld, w->z, partial);
    layer_back(job, h, W1, m, w->a2, ld, h > 0, w->d_z);
}

static void block_back(const struct job *job, size_t first, const struct work *w, float *partial)
{
    size_t n_in = (size_t)job->heads->n_in, in_ld = padded(job->heads->n_in);
    int m = job->n - first < BLOCK ? (int)(job->n - first) : BLOCK;

    for (int i = 0; i < m; i++) {
        size_t row = job->rows ? job->rows[first + (size_t)i] : first + (size_t)i;
        float *z = w->z + (size_t)i * in_ld;

        memcpy(z, job->z + row * n_in, n_in * sizeof *z);
        memset(z + n_in, 0, (in_ld - n_in) * sizeof *z);
    }
    for (int h = 0; h < SPIN_HEADS; h++)
        head_back(job, h, m, job->d_raw + first * SPIN_ATTR, w, partial);
    for (int i = 0; i < m; i++)
        memcpy(job->d_z + (first + (size_t)i) * n_in, w->d_z + (size_t)i * in_ld,
               n_in * sizeof *w->d_z);
}

static void mlp_back_task(void *context, int task)
{
    const struct job *job = context;
    struct work w = work_at(job->heads, job->work + (size_t)spin_pool_worker() * job->work_floats);
    float *partial = job->partial + (size_t)task * job->plain.n_floats;
    size_t first = (size_t)task * job->blocks_each * BLOCK;
    size_t end = first + job->blocks_each * BLOCK;

    memset(partial, 0, job->plain.n_floats * sizeof *partial);
    for (; first < end && first < job->n; first += BLOCK)
        block_back(job, first, &w, partial);
}

/* Adds the partial sums of one weight matrix or bias of one head to the gradient of the parameters,
 * in the order of the tasks. */
static void sum_task(void *context, int task)
{
    const struct job *job = context;
    const struct piece *piece = &job->plain.of[task / PIECES][task % PIECES];

    for (int r = 0; r < piece->rows; r++) {
        float *restrict to = job->d_param + piece->param + (size_t)r * (size_t)piece->cols;

        for (int t = 0; t < job->n_tasks; t++) {
            const float *restrict from =
                job->partial + (size_t)t * job->plain.n_floats + piece->at + (size_t)r * piece->ld;

            for (int c = 0; c < piece->cols; c++)
                to[c] += from[c];
        }
    }
}

void SPIN_CPU(mlp_back)(struct spin_device *d, const struct spin_heads *heads, const float *param,
                        const struct spin_active *active, const float *z, const float *d_raw,
                        float *d_param, float *d_z)
{
    size_t n_workers = (size_t)spin_pool_n_threads(spin_cpu_pool(d));
    size_t n_rows = *active->n, n_blocks = (n_rows + BLOCK - 1) / BLOCK, floats;
    struct job job = {.heads = heads,
                      .n = n_rows,
                      .rows = active->row,
                      .z = z,
                      .d_raw = d_raw,
                      .d_param = d_param,
                      .d_z = d_z};
    SPIN_CPU_CLOCK(d, SPIN_OP_MLP_BACK);
    float *scratch;

    if (n_rows == 0)
        return;
    job.blocks_each = (n_blocks + MAX_TASKS - 1) / MAX_TASKS;
    job.n_tasks = (int)((n_blocks + job.blocks_each - 1) / job.blocks_each);
    job.turned = pieces_of(heads, true);
    job.plain = pieces_of(heads, false);
    job.work_floats = work_floats(heads);
    floats = job.turned.n_floats + (1 + (size_t)job.n_tasks) * job.plain.n_floats +
             n_workers * job.work_floats;
    scratch = spin_cpu_scratch_need(d, SPIN_SCRATCH_MLP, floats * sizeof *scratch);
    if (!scratch)
        return;
    pack_weights(&job.turned, param, scratch);
    job.turned_w = scratch;
    scratch += job.turned.n_floats;
    pack_weights(&job.plain, param, scratch);
    job.plain_w = scratch;
    job.partial = scratch + job.plain.n_floats;
    job.work = job.partial + (size_t)job.n_tasks * job.plain.n_floats;
    spin_pool_run(spin_cpu_pool(d), job.n_tasks, mlp_back_task, &job);
    spin_pool_run(spin_cpu_pool(d), SPIN_HEADS * PIECES, sum_task, &job);
}
