/* L1 + SSIM and its gradient, and how far a picture is from a photograph (docs/method.md 5), one thread a value. The
 * window goes down the columns first, then along the rows, as on the CPU. Sums are in double, blocks in order. */
#include "device/cuda/cuda.h"
#include "math/loss.h"

enum { HALF = SPIN_SSIM_HALF, MAPS = 4, SLOPES = 3, SUMS = 3, SQUARES = 3 };

/* One view's picture and photograph. */
struct photo {
    int width, height;
    size_t plane;
    const uint8_t *rgb8, *mask;
    const float *f32;
    float weight[2];
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
    p.image = (float *)image + cuda_picture(views, k);
    return p;
}

/* The photograph's value i of channel c. */
static __device__ float truth_of(const struct photo &p, size_t c, size_t i)
{
    return p.rgb8 ? (float)p.rgb8[3 * i + c] / 255.0f : p.f32[c * p.plane + i];
}

static __device__ int bit_of(const struct photo &p, size_t i) { return p.mask[i / 8] >> i % 8 & 1; }

/* v(offset) summed over the window, v being 0 outside of 0..n-1. */
template <class V> static __device__ float windowed(int at, int n, V v)
{
    const float window[HALF + 1] = SPIN_SSIM_WINDOW;
    float sum = window[0] * v(0);

    for (int k = 1; k <= HALF; k++) {
        float before = at >= k ? v(-k) : 0, after = at + k < n ? v(k) : 0;

        sum += window[k] * (before + after);
    }
    return sum;
}

/* maps [MAPS][3][h][w]: columns of the windowed x, y, x^2 + y^2 and x y. */
static __global__ void down_kernel(struct photo p, float *maps)
{
    size_t at = GPU_INDEX(), c = at / p.plane, i = at % p.plane, w = (size_t)p.width;
    int y = (int)(i / w);
    auto place = [&](int k) { return (size_t)((int64_t)i + (int64_t)k * p.width); };
    auto x_of = [&](int k) { return p.image[c * p.plane + place(k)]; };
    auto y_of = [&](int k) { return truth_of(p, c, place(k)); };

    if (at >= 3 * p.plane)
        return;
    maps[at] = windowed(y, p.height, x_of);
    maps[at + 3 * p.plane] = windowed(y, p.height, y_of);
    maps[at + 6 * p.plane] =
        windowed(y, p.height, [&](int k) { return x_of(k) * x_of(k) + y_of(k) * y_of(k); });
    maps[at + 9 * p.plane] = windowed(y, p.height, [&](int k) { return x_of(k) * y_of(k); });
}

static __device__ float along(const float *map, size_t at, int x, int width)
{
    return windowed(x, width, [&](int k) { return map[(int64_t)at + k]; });
}

/* slopes [SLOPES][3][h][w], and of every block the sums of L1, SSIM and weights. */
static __global__ void ssim_kernel(struct photo p, bool weigh, const float *maps, float *slopes,
                                   double *sums)
{
    __shared__ double sum[GPU_BLOCK];
    size_t at = GPU_INDEX(), c = at / p.plane, i = at % p.plane, all = 3 * p.plane;
    float mean[MAPS], weight = 0, l1 = 0, ssim = 0;
    double of_block[SUMS];

    if (at < all) {
        struct spin_ssim_slope slope;

        for (size_t m = 0; m < MAPS; m++)
            mean[m] = along(maps + m * all, at, (int)(i % (size_t)p.width), p.width);
        weight = weigh && p.mask ? p.weight[bit_of(p, i)] : 1.0f;
        ssim = weight * spin_ssim(mean[0], mean[1], mean[2], mean[3], &slope);
        l1 = weight * fabsf(p.image[at] - truth_of(p, c, i));
        slopes[at] = weight * slope.d_mu;
        slopes[at + all] = weight * slope.d_xx;
        slopes[at + 2 * all] = weight * slope.d_xy;
    }
    of_block[0] = cuda_block_sum(sum, l1);
    of_block[1] = cuda_block_sum(sum, ssim);
    of_block[2] = cuda_block_sum(sum, weight);
    if (threadIdx.x == 0)
        for (int s = 0; s < SUMS; s++)
            sums[(size_t)blockIdx.x * SUMS + (size_t)s] = of_block[s];
}

/* to [n] = sums over the blocks of from [blocks][n]; one block of threads. */
static __global__ void add_blocks_kernel(unsigned blocks, int n, const double *from, double *to)
{
    __shared__ double sum[GPU_BLOCK];

    for (int s = 0; s < n; s++) {
        double own = 0;

        for (unsigned b = threadIdx.x; b < blocks; b += GPU_BLOCK)
            own += from[(size_t)b * (size_t)n + (size_t)s];
        own = cuda_block_sum(sum, own);
        if (threadIdx.x == 0)
            to[s] = own;
    }
}

/* values [SPIN_LOSS_VALUES] of the sums. */
static __global__ void values_kernel(const double *sums, float lambda_dssim, double *values)
{
    double lambda = (double)lambda_dssim;

    values[SPIN_LOSS_L1] = sums[0] / sums[2];
    values[SPIN_LOSS_SSIM] = sums[1] / sums[2];
    values[SPIN_LOSS] = (1 - lambda) * values[SPIN_LOSS_L1] + lambda * (1 - values[SPIN_LOSS_SSIM]);
}

static __global__ void slopes_down_kernel(struct photo p, const float *slopes, float *down)
{
    size_t at = GPU_INDEX(), all = 3 * p.plane;
    int y = (int)(at % p.plane / (size_t)p.width);

    for (size_t m = 0; m < SLOPES && at < all; m++)
        down[at + m * all] = windowed(y, p.height, [&](int k) {
            return slopes[m * all + (size_t)((int64_t)at + (int64_t)k * p.width)];
        });
}

static __global__ void d_image_kernel(struct photo p, float lambda_dssim, float view_weight,
                                      const double *sums, const float *down, float *d_image)
{
    size_t at = GPU_INDEX(), c = at / p.plane, i = at % p.plane, all = 3 * p.plane;
    int column = (int)(i % (size_t)p.width);
    float mass = (float)sums[2], x, y, slope, l1;

    if (at >= all)
        return;
    x = p.image[at];
    y = truth_of(p, c, i);
    l1 = (1 - lambda_dssim) * view_weight / mass * (p.mask ? p.weight[bit_of(p, i)] : 1.0f);
    slope = along(down, at, column, p.width) + 2 * x * along(down + all, at, column, p.width) +
            y * along(down + 2 * all, at, column, p.width);
    d_image[at] = l1 * spin_sign(x - y) + -lambda_dssim * view_weight / mass * slope;
}

/* Scratch of a picture: maps, slopes, the sums of blocks and the sums of all. */
struct work {
    float *maps, *slopes;
    double *blocks, *sums;
};

static bool work_of(struct spin_device *d, size_t plane, struct work *w)
{
    size_t floats = cuda_round_up(3 * plane * (MAPS + SLOPES) * sizeof(float));
    size_t doubles = ((size_t)gpu_blocks(3 * plane) + 1) * 8 * sizeof(double);
    char *at = (char *)cuda_scratch(d, CUDA_SCRATCH_LOSS, floats + doubles);

    w->maps = (float *)at;
    w->slopes = w->maps + 3 * plane * MAPS;
    w->sums = (double *)(at + floats);
    w->blocks = w->sums + 8;
    return at != NULL;
}

/* sums [SUMS] = of L1, SSIM and weights. */
static void lose(struct spin_device *d, const struct photo &p, bool weigh, const struct work &w)
{
    size_t n = 3 * p.plane;
    unsigned blocks = gpu_blocks(n);

    GPU_EACH(gpu_of(d), n, down_kernel, p, w.maps);
    GPU_EACH(gpu_of(d), n, ssim_kernel, p, weigh, w.maps, w.slopes, w.blocks);
    GPU_LAUNCH(gpu_of(d), add_blocks_kernel, 1, GPU_BLOCK, blocks, SUMS, w.blocks, w.sums);
}

void cuda_loss(struct spin_device *d, const struct spin_view_batch *views,
               const struct spin_images *images, float lambda_dssim, const float *image,
               double *values, float *d_image)
{
    cuda_begin(d, SPIN_OP_LOSS);
    for (int k = 0; k < views->n_views; k++) {
        const auto *view = &views->view[k];
        struct photo p = photo_of(views, k, images, image);
        struct work w;

        if (!work_of(d, p.plane, &w))
            break;
        lose(d, p, true, w);
        GPU_LAUNCH(gpu_of(d), values_kernel, 1, 1, w.sums, lambda_dssim,
                   values + (size_t)view->value * SPIN_LOSS_VALUES);
        if (!d_image)
            continue;
        GPU_EACH(gpu_of(d), 3 * p.plane, slopes_down_kernel, p, w.slopes, w.maps);
        GPU_EACH(gpu_of(d), 3 * p.plane, d_image_kernel, p, lambda_dssim, view->weight, w.sums,
                 w.maps, d_image + cuda_picture(views, k));
    }
    cuda_end(d, SPIN_OP_LOSS);
}

/* ---- Measuring ------------------------------------------------------------------------------- */

static __global__ void clamp_kernel(size_t n, float *image)
{
    size_t i = GPU_INDEX();

    if (i < n)
        image[i] = fminf(fmaxf(image[i], 0.0f), 1.0f);
}

/* Of every block, which has pixels: squared differences of each channel where the mask is 0, then where it is 1. */
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
    cuda_begin(d, SPIN_OP_LOSS);
    for (int k = 0; k < views->n_views; k++) {
        struct photo p = photo_of(views, k, images, image);
        double *v = values + (size_t)views->view[k].value * SPIN_MEASURE_VALUES;
        struct work w;

        if (!work_of(d, p.plane, &w))
            break;
        GPU_EACH(gpu_of(d), 3 * p.plane, clamp_kernel, 3 * p.plane, p.image);
        GPU_EACH(gpu_of(d), p.plane, squares_kernel, p, w.blocks);
        GPU_LAUNCH(gpu_of(d), add_blocks_kernel, 1, GPU_BLOCK, gpu_blocks(p.plane), 6, w.blocks,
                   w.sums);
        GPU_LAUNCH(gpu_of(d), measure_kernel, 1, 1, w.sums, (const double *)NULL, v);
        lose(d, p, false, w);
        GPU_LAUNCH(gpu_of(d), measure_kernel, 1, 1, w.sums, w.sums, v);
    }
    cuda_end(d, SPIN_OP_LOSS);
}
