/* Applies the gain and offset of a camera and the falloff of its lens to an image, and propagates
 * gradients back. The gradients of the parameters are sums over the pixels, which are added in
 * double, first within each block and then over the blocks in order. */
#include "device/cuda/cuda.h"
#include "math/exposure.h"

enum { SUMS = 4 };

/* The parameters of a view that the kernels need. */
struct lens_exposure {
    int width;
    size_t plane;
    float cx, cy;
    const float *exposure, *lens;
};

static struct lens_exposure lens_exposure_of(const struct spin_view_batch *views, int k,
                                             const float *exposure)
{
    const auto *view = &views->view[k];

    return {view->camera.width,
            (size_t)view->camera.width * (size_t)view->camera.height,
            view->camera.cx,
            view->camera.cy,
            exposure + (size_t)view->exposure * SPIN_EXPOSURE,
            exposure + (size_t)view->lens * SPIN_EXPOSURE};
}

static __device__ float r2_of(const struct lens_exposure &l, size_t pixel)
{
    return spin_lens_r2((int)(pixel % (size_t)l.width), (int)(pixel / (size_t)l.width), l.cx, l.cy,
                        0.5f * (float)l.width);
}

static __global__ void exposure_kernel(struct lens_exposure l, const float *image, float *out)
{
    size_t at = GPU_INDEX(), c = at / l.plane;

    if (at < 3 * l.plane) {
        float falloff = spin_falloff(l.lens[c], l.lens[3 + c], r2_of(l, at % l.plane));

        out[at] = spin_exposure(expf(l.exposure[c]) * falloff, l.exposure[3 + c], image[at]);
    }
}

void cuda_exposure(struct spin_device *d, const struct spin_view_batch *views,
                   const float *exposure, const float *image, float *out)
{
    cuda_clocked clocked(d, SPIN_OP_LOSS);
    for (int k = 0; k < views->n_views; k++) {
        struct lens_exposure l = lens_exposure_of(views, k, exposure);
        size_t at = cuda_picture(views, k);

        GPU_EACH(gpu_of(d), 3 * l.plane, exposure_kernel, l, image + at, out + at);
    }
}

/* Computes d_image, and the sums of each block, sums [3][blocks][SUMS]. blockIdx.y is the channel.
 */
static __global__ void back_kernel(struct lens_exposure l, const float *image, float *d_image,
                                   double *sums)
{
    __shared__ double sum[GPU_BLOCK];
    size_t i = GPU_INDEX(), c = blockIdx.y, at = c * l.plane + i;
    struct spin_exposure_slopes s = {0, 0, 0, 0};
    double of_block[SUMS];

    if (i < l.plane) {
        float r2 = r2_of(l, i);

        d_image[at] =
            spin_exposure_adj(expf(l.exposure[c]), spin_falloff(l.lens[c], l.lens[3 + c], r2),
                              l.exposure[3 + c], r2, image[at], d_image[at], &s);
    }
    of_block[0] = cuda_block_sum(sum, s.m);
    of_block[1] = cuda_block_sum(sum, s.offset);
    of_block[2] = cuda_block_sum(sum, s.c1);
    of_block[3] = cuda_block_sum(sum, s.c2);
    if (threadIdx.x == 0)
        for (size_t k = 0; k < SUMS; k++)
            sums[(c * gridDim.x + blockIdx.x) * SUMS + k] = of_block[k];
}

/* Runs as a single block, which adds the sums of all blocks to the gradients of camera and lens. */
static __global__ void add_blocks_kernel(unsigned blocks, const double *sums, float *d_exposure,
                                         float *d_lens)
{
    __shared__ double sum[GPU_BLOCK];

    for (size_t k = 0; k < 3 * SUMS; k++) {
        float *to = (k / 3 < 2 ? d_exposure : d_lens) + k / 3 % 2 * 3 + k % 3;
        double own = 0;

        for (unsigned b = threadIdx.x; b < blocks; b += GPU_BLOCK)
            own += sums[(k % 3 * blocks + b) * SUMS + k / 3];
        own = cuda_block_sum(sum, own);
        if (threadIdx.x == 0)
            *to += (float)own;
    }
}

void cuda_exposure_back(struct spin_device *d, const struct spin_view_batch *views,
                        const float *exposure, const float *image, float *d_image,
                        float *d_exposure)
{
    cuda_clocked clocked(d, SPIN_OP_LOSS);
    for (int k = 0; k < views->n_views; k++) {
        const auto *view = &views->view[k];
        struct lens_exposure l = lens_exposure_of(views, k, exposure);
        size_t at = cuda_picture(views, k);
        unsigned blocks = gpu_blocks(l.plane);
        double *sums =
            (double *)cuda_scratch(d, CUDA_SCRATCH_LOSS, (size_t)blocks * 3 * SUMS * sizeof *sums);

        if (!sums)
            break;
        GPU_LAUNCH(gpu_of(d), back_kernel, dim3(blocks, 3), GPU_BLOCK, l, image + at, d_image + at,
                   sums);
        GPU_LAUNCH(gpu_of(d), add_blocks_kernel, 1, GPU_BLOCK, blocks, sums,
                   d_exposure + (size_t)view->exposure * SPIN_EXPOSURE,
                   d_exposure + (size_t)view->lens * SPIN_EXPOSURE);
    }
}

/* Subtracts from each value the mean of its column, with one thread per column. */
static __global__ void centre_kernel(size_t n, float *exposure)
{
    size_t k = threadIdx.x;
    double mean = 0;

    for (size_t i = 0; i < n; i++)
        mean += (double)exposure[SPIN_EXPOSURE * i + k] / (double)n;
    for (size_t i = 0; i < n; i++)
        exposure[SPIN_EXPOSURE * i + k] -= (float)mean;
}

void cuda_exposure_centre(struct spin_device *d, size_t n, float *exposure)
{
    cuda_clocked clocked(d, SPIN_OP_ADAM);
    GPU_LAUNCH(gpu_of(d), centre_kernel, 1, SPIN_EXPOSURE, n, exposure);
}
