/* Internals of the CUDA device. The files of this folder are compiled by nvcc, and for the
 * emulation by the host compiler. All work is queued in one stream and runs in order. The first
 * error is kept until the next wait() or download() returns it. */
#pragma once

#include <string.h>

#include "device/cuda/gpu.h"
#include "device/device.h"
#include "math/portable.h"

/* Scratch buffers of the verbs. A buffer is enlarged on demand and kept for later calls. */
enum cuda_scratch_of {
    CUDA_SCRATCH_SORT, /* for gpu_sort() and gpu_scan() */
    CUDA_SCRATCH_ROWS,
    CUDA_SCRATCH_GRID,
    CUDA_SCRATCH_FIXED,
    CUDA_SCRATCH_MLP,
    CUDA_SCRATCH_TILE,
    CUDA_SCRATCH_BLEND,
    CUDA_SCRATCH_LOSS,
    CUDA_SCRATCHES
};

enum { CUDA_MARKS = 64 };
struct cuda_clock {
    void *mark[CUDA_MARKS][2];
    int n; /* number of pairs of marks whose time is not yet added to `seconds` */
    double seconds;
};

struct cuda {
    struct gpu gpu;
    struct {
        void *block;
        size_t bytes;
    } scratch[CUDA_SCRATCHES];
    bool sync;          /* SPIN_CUDA_SYNC=1: waits for every verb, so that errors name the verb */
    bool tensor;        /* true: heads are computed on tensor cores */
    spin_status failed; /* error that the next wait() returns and clears */
    char why[256];
    struct cuda_clock clock[SPIN_N_OPS];
    /* number of pairs of each view, kept from tile_count() to tile_fill() */
    uint64_t view_pairs[SPIN_MAX_VIEWS];
};

static inline struct cuda *cuda_of(struct spin_device *d) { return (struct cuda *)d->state; }
static inline struct gpu *gpu_of(struct spin_device *d) { return &cuda_of(d)->gpu; }

/* Returns a scratch buffer with undefined contents (cuda.cu). Returns NULL if out of memory; the
 * calling verb then leaves its results unchanged, and the next wait() returns the error. */
void *cuda_scratch(struct spin_device *d, enum cuda_scratch_of which, size_t bytes);
/* These functions of cuda.cu set the error message and return the status, like spin_fail().
 * cuda_no_memory() is for a host that is out of memory, cuda_fail() for any other failure. */
spin_status cuda_no_memory(void);
spin_status cuda_fail(spin_status status, const char *what, const char *why);
/* Scope guard: measures the time of the operation `op`, and checks for launch errors when its scope
 * ends. */
struct cuda_clocked {
    struct spin_device *d;
    int op;
    cuda_clocked(struct spin_device *device, int number);
    ~cuda_clocked();
};
/* gpu_scan() and gpu_sort() of gpu.h with a scratch buffer for their temporary memory. They return
 * false if out of memory; the next wait() then returns the error. */
bool cuda_scan(struct spin_device *d, const uint64_t *in, uint64_t *out, size_t n);
bool cuda_sort(struct spin_device *d, const uint32_t *key, uint32_t *key_out, const uint32_t *value,
               uint32_t *value_out, size_t n, int bits);

/* Checks that the number of pairs of a view is within the limits (cuda.cu). `before` is the number
 * of pairs of all views before this one. */
spin_status cuda_pairs_fit(uint64_t pairs, uint64_t before);

static inline size_t cuda_round_up(size_t bytes) { return (bytes + 255) / 256 * 256; }
static inline size_t cuda_picture(const struct spin_view_batch *views, int k)
{
    return (size_t)k * 3 * views->max_pixels;
}

/* The active rows of one frame, whose rows in the batch are [first, first + n). The host does not
 * know the number of active rows, so kernels are launched with one thread for each entry that the
 * list can hold. */
struct cuda_rows {
    const uint32_t *row, *count;
    size_t first, n;
};
static inline struct cuda_rows cuda_rows_of(const struct spin_active *active, size_t first,
                                            size_t n)
{
    return cuda_rows{active->row, active->n, first, n};
}
/* Sets *row_of_frame to active row i, counted from the frame's first row. Returns false if there is
 * no active row i, or if the row belongs to another frame. */
static inline __device__ bool cuda_row(const struct cuda_rows &rows, size_t i, size_t *row_of_frame)
{
    if (i >= *rows.count)
        return false;
    *row_of_frame = rows.row[i] - rows.first;
    return *row_of_frame < rows.n;
}

/* Adds the values of a block's threads in a fixed order, and returns the sum in every thread. All
 * threads must call the function. sum [threads] is shared memory. The number of threads is a power
 * of two. */
static inline __device__ double cuda_block_sum(double *sum, double value)
{
    unsigned me = threadIdx.x;

    sum[me] = value;
    __syncthreads();
    for (unsigned half = blockDim.x / 2; half > 0; half /= 2) {
        if (me < half)
            sum[me] += sum[me + half];
        __syncthreads();
    }
    value = sum[0];
    __syncthreads();
    return value;
}

/* Declares each verb with the type of its member of spin_device_ops. */
#define CUDA_VERB(name) __typeof__(*((struct spin_device_ops *)0)->name) cuda_##name;
SPIN_DEVICE_VERBS(CUDA_VERB)
CUDA_VERB(copy_rows)
