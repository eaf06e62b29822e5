/* Computes attributes from the outputs of the heads by their activation functions, and propagates
 * gradients back. Lists the rows with a nonzero gradient. */
#include "device/cuda/cuda.h"
#include "math/activate.h"

/* Each thread processes four values of a row, so that a warp reads and writes consecutive memory.
 * The values of scale and rotation belong to the first two threads of a row, and each of the two
 * computes them all. The last thread computes the opacity; the threads in between copy their
 * values. */
enum { FOURS = SPIN_ATTR / 4, LAST = FOURS - 1 };
static_assert(SPIN_ATTR_SCALE == 0 && SPIN_ATTR_ROTATION + 4 == 7 &&
                  SPIN_ATTR_OPACITY == SPIN_ATTR - 1 && SPIN_ATTR % 4 == 0,
              "scale and rotation are in the first two fours of a row, opacity in the last");

/* Reads the first eight values of a row. */
static __device__ void first_two(const float4 *row, float *out)
{
    *(float4 *)out = row[0];
    *(float4 *)(out + 4) = row[1];
}

static __global__ void activate_kernel(size_t n, const float4 *raw, float4 *attr)
{
    size_t at = GPU_INDEX(), four = at % FOURS;
    float4 v;

    if (at >= n * FOURS)
        return;
    v = raw[at];
    if (four < 2) {
        alignas(16) float h[8], a[8];

        first_two(raw + (at - four), h);
        for (int k = 0; k < 3; k++)
            a[SPIN_ATTR_SCALE + k] = spin_scale_of(h[SPIN_ATTR_SCALE + k]);
        spin_rotation_of(h + SPIN_ATTR_ROTATION, a + SPIN_ATTR_ROTATION);
        a[7] = h[7];
        v = *(float4 *)(a + 4 * four);
    }
    if (four == LAST)
        v.w = spin_opacity_of(v.w);
    attr[at] = v;
}

void cuda_activate(struct spin_device *d, const struct spin_frame_batch *frames, const float *raw,
                   float *attr)
{
    cuda_clocked clocked(d, SPIN_OP_ACTIVATE);
    GPU_EACH(gpu_of(d), frames->n * FOURS, activate_kernel, frames->n, (const float4 *)raw,
             (float4 *)attr);
}

static __global__ void activate_back_kernel(struct cuda_rows rows, const float4 *raw,
                                            const float4 *d_attr, float4 *d_raw)
{
    size_t at = GPU_INDEX(), four = at % FOURS, row;
    float4 d;

    if (!cuda_row(rows, at / FOURS, &row))
        return;
    d = d_attr[row * FOURS + four];
    if (four < 2) {
        alignas(16) float h[8], g[8], d_h[8];

        first_two(raw + row * FOURS, h);
        first_two(d_attr + row * FOURS, g);
        for (int k = 0; k < 3; k++)
            d_h[SPIN_ATTR_SCALE + k] =
                spin_scale_adj(h[SPIN_ATTR_SCALE + k], g[SPIN_ATTR_SCALE + k]);
        spin_rotation_adj(h + SPIN_ATTR_ROTATION, g + SPIN_ATTR_ROTATION, d_h + SPIN_ATTR_ROTATION);
        d_h[7] = g[7];
        d = *(float4 *)(d_h + 4 * four);
    }
    if (four == LAST)
        d.w = spin_opacity_adj(raw[row * FOURS + LAST].w, d.w);
    d_raw[at] = d;
}

void cuda_activate_back(struct spin_device *d, const struct spin_frame_batch *,
                        const struct spin_active *active, const float *raw, const float *d_attr,
                        float *d_raw)
{
    cuda_clocked clocked(d, SPIN_OP_ACTIVATE_BACK);
    GPU_EACH(gpu_of(d), active->most * FOURS, activate_back_kernel,
             cuda_rows_of(active, 0, SIZE_MAX), (const float4 *)raw, (const float4 *)d_attr,
             (float4 *)d_raw);
}

/* ---- The list of active rows ----------------------------------------------------------------- */

/* Returns a number that is nonzero if any value is nonzero. NaN is nonzero, -0 is zero. The bits of
 * all values, without their signs, are combined by OR. */
static __device__ uint32_t any_set(const float *x, int n)
{
    uint32_t bits = 0;

    for (int i = 0; i < n; i++)
        bits |= spin_bits_of_float(x[i]);
    return bits & 0x7fffffffu;
}

static __global__ void flag_kernel(size_t n, const float *d_attr, const float *d_means,
                                   uint64_t *flag)
{
    size_t i = GPU_INDEX();

    if (i < n)
        flag[i] =
            any_set(d_attr + i * SPIN_ATTR, SPIN_ATTR) || (d_means && any_set(d_means + 3 * i, 3));
}

/* Lists the rows whose flag is 1. `flag` and its exclusive prefix sums `before` have n + 1 entries;
 * the last flag is 0. */
static __global__ void list_kernel(size_t n, const uint64_t *flag, const uint64_t *before,
                                   uint32_t *row, uint32_t *count)
{
    size_t i = GPU_INDEX();

    if (i < n && flag[i])
        row[before[i]] = (uint32_t)i;
    if (i == n)
        *count = (uint32_t)before[n];
}

void cuda_nonzero_grad(struct spin_device *d, const struct spin_frame_batch *frames,
                       const float *d_attr, const struct spin_active *active)
{
    size_t n = frames->n;
    uint64_t *flag = (uint64_t *)cuda_scratch(d, CUDA_SCRATCH_ROWS, 2 * (n + 1) * sizeof *flag);

    if (!flag) { /* out of memory: the list becomes empty, since its entries are undefined */
        gpu_zero(gpu_of(d), active->n, sizeof *active->n);
        return;
    }
    cuda_clocked clocked(d, SPIN_OP_NONZERO_GRAD);
    gpu_zero(gpu_of(d), flag, (n + 1) * sizeof *flag);
    for (int f = 0; f < frames->n_frames; f++) {
        const auto *frame = &frames->frame[f];

        GPU_EACH(gpu_of(d), frame->n, flag_kernel, frame->n, d_attr + frame->first * SPIN_ATTR,
                 frame->d_means, flag + frame->first);
    }
    if (cuda_scan(d, flag, flag + n + 1, n + 1))
        GPU_EACH(gpu_of(d), n + 1, list_kernel, n, flag, flag + n + 1, active->row, active->n);
    else
        gpu_zero(gpu_of(d), active->n, sizeof *active->n);
}
