/* A camera's gain and offset over a picture, and back. Sums are in double, blocks in order. */
#include "device/cuda/cuda.h"
#include "math/exposure.h"

static __global__ void exposure_kernel(size_t plane, const float *exposure, const float *image,
                                       float *out)
{
    size_t at = GPU_INDEX(), c = at / plane;

    if (at < 3 * plane)
        out[at] = spin_exposure(expf(exposure[c]), exposure[3 + c], image[at]);
}

void cuda_exposure(struct spin_device *d, const struct spin_view_batch *views,
                   const float *exposure, const float *image, float *out)
{
    cuda_begin(d, SPIN_OP_LOSS);
    for (int k = 0; k < views->n_views; k++) {
        const auto *view = &views->view[k];
        size_t plane = (size_t)view->camera.width * (size_t)view->camera.height;
        size_t at = cuda_picture(views, k);

        GPU_EACH(gpu_of(d), 3 * plane, exposure_kernel, plane,
                 exposure + (size_t)view->exposure * SPIN_EXPOSURE, image + at, out + at);
    }
    cuda_end(d, SPIN_OP_LOSS);
}

/* A block has pixels of channel blockIdx.y; sums [3][blocks][2]. */
static __global__ void back_kernel(size_t plane, const float *exposure, const float *image,
                                   float *d_image, double *sums)
{
    __shared__ double sum[GPU_BLOCK];
    size_t i = GPU_INDEX(), c = blockIdx.y, at = c * plane + i;
    float d_m = 0, d_c = 0;
    double of_block[2];

    if (i < plane)
        d_image[at] = spin_exposure_adj(expf(exposure[c]), image[at], d_image[at], &d_m, &d_c);
    of_block[0] = cuda_block_sum(sum, d_m);
    of_block[1] = cuda_block_sum(sum, d_c);
    if (threadIdx.x == 0)
        for (size_t s = 0; s < 2; s++)
            sums[(c * gridDim.x + blockIdx.x) * 2 + s] = of_block[s];
}

/* One block: the sums of the blocks, to the exposure's gradient. */
static __global__ void add_blocks_kernel(unsigned blocks, const double *sums, float *d_exposure)
{
    __shared__ double sum[GPU_BLOCK];

    for (size_t k = 0; k < SPIN_EXPOSURE; k++) {
        double own = 0;

        for (unsigned b = threadIdx.x; b < blocks; b += GPU_BLOCK)
            own += sums[(k % 3 * blocks + b) * 2 + k / 3];
        own = cuda_block_sum(sum, own);
        if (threadIdx.x == 0)
            d_exposure[k] += (float)own;
    }
}

void cuda_exposure_back(struct spin_device *d, const struct spin_view_batch *views,
                        const float *exposure, const float *image, float *d_image,
                        float *d_exposure)
{
    cuda_begin(d, SPIN_OP_LOSS);
    for (int k = 0; k < views->n_views; k++) {
        const auto *view = &views->view[k];
        size_t plane = (size_t)view->camera.width * (size_t)view->camera.height;
        size_t at = cuda_picture(views, k), row = (size_t)view->exposure * SPIN_EXPOSURE;
        unsigned blocks = gpu_blocks(plane);
        double *sums =
            (double *)cuda_scratch(d, CUDA_SCRATCH_LOSS, (size_t)blocks * 6 * sizeof *sums);

        if (!sums)
            break;
        GPU_LAUNCH(gpu_of(d), back_kernel, dim3(blocks, 3), GPU_BLOCK, plane, exposure + row,
                   image + at, d_image + at, sums);
        GPU_LAUNCH(gpu_of(d), add_blocks_kernel, 1, GPU_BLOCK, blocks, sums, d_exposure + row);
    }
    cuda_end(d, SPIN_OP_LOSS);
}

/* A thread has one of a row's values. */
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
    cuda_begin(d, SPIN_OP_ADAM);
    GPU_LAUNCH(gpu_of(d), centre_kernel, 1, SPIN_EXPOSURE, n, exposure);
    cuda_end(d, SPIN_OP_ADAM);
}
