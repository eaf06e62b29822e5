/* Computes the loss, a combination of L1 and SSIM, with its gradient, and measures the differences
 * of an image from the input image (docs/method.md 5). As on the CPU, the SSIM window is applied
 * first to columns, then to rows. A thread filters eight vertically adjacent values of a column.
 * Sums are in double; the sums of the blocks are added in order. */
#include "device/cuda/cuda.h"
#include "math/loss.h"

enum { HALF = SPIN_SSIM_HALF, MAPS = 4, SLOPES = 3, SUMS = 3, WARP = 32 };
enum { STRIP = 8, TALL = STRIP + 2 * HALF };

/* The rendered image and the input image of one view. */
struct photo {
    int width, height;
    size_t plane;
    const uint8_t *rgb8, *mask, *matte;
    const float *f32;
    float weight[2]; /* weights of the pixels whose mask bit is 0 and 1 */
    float change[3]; /* what blend() adds to the background of pixels of known alpha */
    float *image;
};

static struct photo photo_of(const struct spin_view_batch *views, int k,
                             const struct spin_images *images, const float *image)
{
    const auto *view = &views->view[k];
    size_t at = (size_t)view->image * 3 * images->max_pixels;
    struct photo p = {};

    p.width = view->camera.width;
    p.height = view->camera.height;
    p.plane = (size_t)p.width * (size_t)p.height;
    if (images->rgb8)
        p.rgb8 = images->rgb8 + at;
    else
        p.f32 = images->f32 + at;
    if (images->mask)
        p.mask = images->mask + (size_t)view->image * ((images->max_pixels + 7) / 8);
    p.weight[0] = images->mask_weight[0];
    p.weight[1] = images->mask_weight[1];
    p.matte = view->matte;
    memcpy(p.change, view->background_change, sizeof p.change);
    p.image = (float *)image + cuda_picture(views, k);
    return p;
}

/* Returns value i of channel c of the input image, composited over the changed background. */
static __device__ float truth_of(const struct photo &p, size_t c, size_t i)
{
    float value = p.rgb8 ? (float)p.rgb8[3 * i + c] / 255.0f : p.f32[c * p.plane + i];

    /* Indexing `change` by a variable would copy the whole parameter p to local memory. */
    if (p.matte)
        value += spin_matte_transmittance(p.matte[i]) * (c == 0   ? p.change[0]
                                                         : c == 1 ? p.change[1]
                                                                  : p.change[2]);
    return value;
}

static __device__ int bit_of(const struct photo &p, size_t i) { return p.mask[i / 8] >> i % 8 & 1; }

static __device__ float weight_of(const struct photo &p, size_t i)
{
    return !p.mask ? 1.0f : bit_of(p, i) ? p.weight[1] : p.weight[0];
}

/* STRIP values of a column of one plane [h][w], from row y on. `at` is the index of the first of
 * these values. */
struct strip {
    size_t plane, at, width;
    int y, height;
};

static unsigned strips(const struct photo &p, unsigned planes)
{
    return planes * (unsigned)p.width * (unsigned)((p.height + STRIP - 1) / STRIP);
}

/* Returns the strip of this thread. The index of the thread must be below strips(). */
static __device__ struct strip strip_of(const struct photo &p)
{
    unsigned me = (unsigned)GPU_INDEX(), width = (unsigned)p.width;
    unsigned rows = (unsigned)(p.height + STRIP - 1) / STRIP, row = me / width;
    struct strip s;

    s.plane = row / rows;
    s.y = (int)(row % rows * STRIP);
    s.width = width;
    s.height = p.height;
    s.at = s.plane * p.plane + (size_t)s.y * width + me % width;
    return s;
}

/* Fills v [TALL] with the values of a column, starting HALF rows above the strip; rows outside the
 * plane give 0. value(k) returns the value at index s.at + k of the plane. */
template <class V> static __device__ void load_strip(const struct strip &s, float *v, V value)
{
    for (int k = 0; k < TALL; k++) {
        int row = s.y + k - HALF;

        v[k] = row >= 0 && row < s.height ? value((int64_t)(k - HALF) * (int64_t)s.width) : 0;
    }
}

/* Filters v [TALL] with the vertical window, and writes the result to the strip of `map`. */
static __device__ void store_strip(const struct strip &s, const float *v, float *map)
{
    const float window[HALF + 1] = SPIN_SSIM_WINDOW;

    for (int k = 0; k < STRIP; k++) {
        const float *at = v + k + HALF;
        float sum = window[0] * at[0];

        for (int j = 1; j <= HALF; j++)
            sum += window[j] * (at[-j] + at[j]);
        if (s.y + k < s.height)
            map[s.at + (size_t)k * s.width] = sum;
    }
}

/* Computes maps [MAPS][3][h][w]: x, y, x^2 + y^2 and x y of the two images x and y, filtered along
 * columns. */
static __global__ void down_kernel(struct photo p, unsigned n, float *maps)
{
    struct strip s = strip_of(p);
    float x[TALL], y[TALL];
    size_t i = s.at - s.plane * p.plane;

    if (GPU_INDEX() >= n)
        return;
    load_strip(s, x, [&](int64_t k) { return p.image[(int64_t)s.at + k]; });
    load_strip(s, y, [&](int64_t k) { return truth_of(p, s.plane, (size_t)((int64_t)i + k)); });
    store_strip(s, x, maps);
    store_strip(s, y, maps + 3 * p.plane);
    for (int k = 0; k < TALL; k++) {
        float squares = x[k] * x[k] + y[k] * y[k];

        y[k] = x[k] * y[k];
        x[k] = squares;
    }
    store_strip(s, x, maps + 6 * p.plane);
    store_strip(s, y, maps + 9 * p.plane);
}

/* One value of an image: pixel i of channel c, in column x. All values of a block belong to the
 * same channel. */
struct value {
    size_t c, i, at;
    int x;
};

static unsigned blocks_of(size_t plane) { return 3 * gpu_blocks(plane); }

/* Finds the value that this thread computes. Returns false if it has none. */
static __device__ bool value_of(const struct photo &p, struct value *v)
{
    unsigned blocks = gridDim.x / 3, i = blockIdx.x % blocks * GPU_BLOCK + threadIdx.x;

    v->c = blockIdx.x / blocks;
    v->i = i;
    v->at = v->c * p.plane + i;
    v->x = (int)(i % (unsigned)p.width);
    return i < p.plane;
}

/* Returns the sum of the values of `map` at v and to its left and right, weighted by the horizontal
 * window. */
static __device__ float window_along(const float *map, const struct value &v, int width)
{
    const float window[HALF + 1] = SPIN_SSIM_WINDOW;
    float sum = window[0] * map[v.at];

    for (int k = 1; k <= HALF; k++) {
        float before = v.x >= k ? map[v.at - (size_t)k] : 0;
        float after = v.x + k < width ? map[v.at + (size_t)k] : 0;

        sum += window[k] * (before + after);
    }
    return sum;
}

/* Computes slopes [SLOPES][3][h][w], the derivatives of the SSIM map (struct spin_ssim_slope), and
 * sums [blocks][SUMS], the sums of L1, SSIM and weights of each block. */
static __global__ void ssim_kernel(struct photo p, bool weighted, const float *maps, float *slopes,
                                   double *sums)
{
    __shared__ float values[SUMS][GPU_BLOCK];
    unsigned me = threadIdx.x, warp = me / WARP, lane = me % WARP;
    size_t all = 3 * p.plane;
    float mean[MAPS], weight = 0, l1 = 0, ssim = 0;
    struct value v;

    if (value_of(p, &v)) {
        struct spin_ssim_slope slope;

        for (size_t m = 0; m < MAPS; m++)
            mean[m] = window_along(maps + m * all, v, p.width);
        weight = weighted ? weight_of(p, v.i) : 1.0f;
        ssim = weight * spin_ssim(mean[0], mean[1], mean[2], mean[3], &slope);
        l1 = weight * fabsf(p.image[v.at] - truth_of(p, v.c, v.i));
        slopes[v.at] = weight * slope.d_mu;
        slopes[v.at + all] = weight * slope.d_xx;
        slopes[v.at + 2 * all] = weight * slope.d_xy;
    }
    values[0][me] = l1;
    values[1][me] = ssim;
    values[2][me] = weight;
    __syncthreads();
    if (warp < SUMS) { /* each sum is computed by one warp */
        double sum = 0;

        for (unsigned k = lane; k < GPU_BLOCK; k += WARP)
            sum += (double)values[warp][k];
        for (int by = WARP / 2; by > 0; by /= 2)
            sum += __shfl_xor_sync(0xffffffffu, sum, by);
        if (lane == 0)
            sums[(size_t)blockIdx.x * SUMS + warp] = sum;
    }
}

/* Reduces `from` [blocks][n], which contains one row of partial sums for each block of the kernel
 * that wrote it, to the totals `to` [n]. Launched with n blocks, one for each total. */
static __global__ void add_blocks_kernel(unsigned blocks, const double *from, double *to)
{
    __shared__ double sum[GPU_BLOCK];
    size_t n = gridDim.x, s = blockIdx.x;
    double own = 0;

    for (unsigned b = threadIdx.x; b < blocks; b += GPU_BLOCK)
        own += from[(size_t)b * n + s];
    own = cuda_block_sum(sum, own);
    if (threadIdx.x == 0)
        to[s] = own;
}

/* Computes the loss and its parts, values [SPIN_LOSS_VALUES], from the sums over the image. */
static __global__ void values_kernel(const double *sums, float lambda_dssim, double *values)
{
    double lambda = (double)lambda_dssim;

    values[SPIN_LOSS_L1] = sums[0] / sums[2];
    values[SPIN_LOSS_SSIM] = sums[1] / sums[2];
    values[SPIN_LOSS] = (1 - lambda) * values[SPIN_LOSS_L1] + lambda * (1 - values[SPIN_LOSS_SSIM]);
}

static __global__ void slopes_down_kernel(struct photo p, unsigned n, const float *slopes,
                                          float *down)
{
    struct strip s = strip_of(p);
    float v[TALL];

    if (GPU_INDEX() >= n)
        return;
    load_strip(s, v, [&](int64_t k) { return slopes[(int64_t)s.at + k]; });
    store_strip(s, v, down);
}

static __global__ void d_image_kernel(struct photo p, float lambda_dssim, float view_weight,
                                      const double *sums, const float *down, float *d_image)
{
    size_t all = 3 * p.plane;
    float mass = (float)sums[2], x, y, slope, l1;
    struct value v;

    if (!value_of(p, &v))
        return;
    x = p.image[v.at];
    y = truth_of(p, v.c, v.i);
    l1 = (1 - lambda_dssim) * view_weight / mass * weight_of(p, v.i);
    slope = window_along(down, v, p.width) + 2 * x * window_along(down + all, v, p.width) +
            y * window_along(down + 2 * all, v, p.width);
    d_image[v.at] = l1 * spin_sign(x - y) + -lambda_dssim * view_weight / mass * slope;
}

/* Scratch memory for one image: maps, slopes, sums of each block, and sums over the image. */
struct work {
    float *maps, *slopes;
    double *blocks, *sums;
};

static bool work_of(struct spin_device *d, size_t plane, struct work *w)
{
    size_t floats = cuda_round_up(3 * plane * (MAPS + SLOPES) * sizeof(float));
    size_t doubles = ((size_t)blocks_of(plane) + 1) * 8 * sizeof(double);
    char *at = (char *)cuda_scratch(d, CUDA_SCRATCH_LOSS, floats + doubles);

    w->maps = (float *)at;
    w->slopes = w->maps + 3 * plane * MAPS;
    w->sums = (double *)(at + floats);
    w->blocks = w->sums + 8;
    return at != NULL;
}

/* Computes w.sums [SUMS], the sums of L1, SSIM and weights over the image. */
static void sum_loss(struct spin_device *d, const struct photo &p, bool weighted,
                     const struct work &w)
{
    unsigned n = strips(p, 3), blocks = blocks_of(p.plane);

    GPU_EACH(gpu_of(d), n, down_kernel, p, n, w.maps);
    GPU_LAUNCH(gpu_of(d), ssim_kernel, blocks, GPU_BLOCK, p, weighted, w.maps, w.slopes, w.blocks);
    GPU_LAUNCH(gpu_of(d), add_blocks_kernel, SUMS, GPU_BLOCK, blocks, w.blocks, w.sums);
}

void cuda_loss(struct spin_device *d, const struct spin_view_batch *views,
               const struct spin_images *images, float lambda_dssim, const float *image,
               double *values, float *d_image)
{
    cuda_clocked clocked(d, SPIN_OP_LOSS);
    for (int k = 0; k < views->n_views; k++) {
        const auto *view = &views->view[k];
        struct photo p = photo_of(views, k, images, image);
        unsigned n = strips(p, 3 * SLOPES);
        struct work w;

        if (!work_of(d, p.plane, &w))
            break;
        sum_loss(d, p, true, w);
        GPU_LAUNCH(gpu_of(d), values_kernel, 1, 1, w.sums, lambda_dssim,
                   values + (size_t)view->value * SPIN_LOSS_VALUES);
        if (!d_image)
            continue;
        GPU_EACH(gpu_of(d), n, slopes_down_kernel, p, n, w.slopes, w.maps);
        GPU_LAUNCH(gpu_of(d), d_image_kernel, blocks_of(p.plane), GPU_BLOCK, p, lambda_dssim,
                   view->weight, w.sums, w.maps, d_image + cuda_picture(views, k));
    }
}

/* ---- Measuring ------------------------------------------------------------------------------- */

static __global__ void clamp_kernel(size_t n, float *image)
{
    size_t i = GPU_INDEX();

    if (i < n)
        image[i] = fminf(fmaxf(image[i], 0.0f), 1.0f);
}

/* Computes sums [blocks][2][3]: for each block, the sums of squared differences by mask bit and
 * channel. */
static __global__ void squares_kernel(struct photo p, double *sums)
{
    __shared__ double sum[GPU_BLOCK];
    size_t i = GPU_INDEX();

    for (size_t c = 0; c < 3; c++) {
        double square = 0, of_block;
        int bit = i < p.plane && p.mask ? bit_of(p, i) : 0;

        if (i < p.plane) {
            double difference = (double)(p.image[c * p.plane + i] - truth_of(p, c, i));

            square = difference * difference;
        }
        for (int region = 0; region < 2; region++) {
            of_block = cuda_block_sum(sum, bit == region ? square : 0);
            if (threadIdx.x == 0)
                sums[(size_t)blockIdx.x * 6 + (size_t)region * 3 + c] = of_block;
        }
    }
}

static __global__ void measure_kernel(const double *squares, const double *ssim, double *values)
{
    double outside = squares[0] + squares[1] + squares[2];
    double inside = squares[3] + squares[4] + squares[5];

    if (ssim) {
        values[SPIN_MEASURE_SSIM] = ssim[1] / ssim[2];
        return;
    }
    values[SPIN_MEASURE_SQUARES] = outside + inside;
    for (int c = 0; c < 3; c++)
        values[SPIN_MEASURE_RED + c] = squares[c] + squares[3 + c];
    values[SPIN_MEASURE_OUTSIDE] = outside;
    values[SPIN_MEASURE_INSIDE] = inside;
}

void cuda_measure(struct spin_device *d, const struct spin_view_batch *views,
                  const struct spin_images *images, float *image, double *values)
{
    cuda_clocked clocked(d, SPIN_OP_LOSS);
    for (int k = 0; k < views->n_views; k++) {
        struct photo p = photo_of(views, k, images, image);
        double *v = values + (size_t)views->view[k].value * SPIN_MEASURE_VALUES;
        struct work w;

        if (!work_of(d, p.plane, &w))
            break;
        GPU_EACH(gpu_of(d), 3 * p.plane, clamp_kernel, 3 * p.plane, p.image);
        GPU_EACH(gpu_of(d), p.plane, squares_kernel, p, w.blocks);
        GPU_LAUNCH(gpu_of(d), add_blocks_kernel, 6, GPU_BLOCK, gpu_blocks(p.plane), w.blocks,
                   w.sums);
        GPU_LAUNCH(gpu_of(d), measure_kernel, 1, 1, w.sums, (const double *)NULL, v);
        sum_loss(d, p, false, w);
        GPU_LAUNCH(gpu_of(d), measure_kernel, 1, 1, w.sums, w.sums, v);
    }
}
