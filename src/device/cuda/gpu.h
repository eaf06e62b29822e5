/* What the CUDA device needs of CUDA, under names of ours. gpu.cu has them by the CUDA runtime and
 * CUB; in the host emulation (SPIN_EMU) tests/emu has them, and the compiler is told to include
 * tests/emu/emu.h first, which has the words of CUDA C++ that kernels use: __global__, threadIdx,
 * __syncthreads() and so on. */
#pragma once

#include <stddef.h>
#include <stdint.h>

#ifdef SPIN_EMU
#define GPU_LAUNCH(gpu, kernel, grid, block, ...)                                                  \
    (emu_launches(gpu) ? emu_launch(#kernel, grid, block, [=] { kernel(__VA_ARGS__); }) : (void)0)
#define GPU_LAUNCH_SHARED(gpu, kernel, grid, block, bytes, ...)                                    \
    (emu_launches(gpu)                                                                             \
         ? emu_launch_dynamic(#kernel, grid, block, bytes, [=] { kernel(__VA_ARGS__); })           \
         : (void)0)
#define GPU_SHARED(type, name) type *name = (type *)emu_dynamic()
bool emu_launches(struct gpu *gpu); /* false: the card was lost, as a test wanted it */
#else
#define GPU_LAUNCH(gpu, kernel, grid, block, ...)                                                  \
    kernel<<<grid, block, 0, (cudaStream_t)(gpu)->stream>>>(__VA_ARGS__)
/* With so many bytes of shared memory beside what the kernel declares, up to gpu->shared; the
 * kernel finds them by GPU_SHARED, aligned to 16. */
#define GPU_LAUNCH_SHARED(gpu, kernel, grid, block, bytes, ...)                                    \
    (cudaFuncSetAttribute(kernel, cudaFuncAttributeMaxDynamicSharedMemorySize, bytes),             \
     kernel<<<grid, block, bytes, (cudaStream_t)(gpu)->stream>>>(__VA_ARGS__))
#define GPU_SHARED(type, name) extern __shared__ __align__(16) type name[]
#endif

/* Threads of a block where a kernel has one thread for each of n things, and the blocks for them.
 */
enum { GPU_BLOCK = 256 };
static inline unsigned gpu_blocks(size_t n) { return (unsigned)((n + GPU_BLOCK - 1) / GPU_BLOCK); }
/* One thread for each of n things; nothing for none. */
#define GPU_EACH(gpu, n, kernel, ...)                                                              \
    do {                                                                                           \
        if ((n) > 0)                                                                               \
            GPU_LAUNCH(gpu, kernel, gpu_blocks(n), GPU_BLOCK, __VA_ARGS__);                        \
    } while (0)
/* This thread's place among all of its launch, along x. */
#define GPU_INDEX() ((size_t)blockIdx.x * blockDim.x + threadIdx.x)

/* The card and its queue of work. Functions that return nothing are queued; their errors, like
 * those of kernels, are what gpu_error() and gpu_wait() tell. */
struct gpu {
    void *stream;
    void *pool;    /* that keeps memory which is given back, or NULL */
    char name[48]; /* of the card */
    char id[40];   /* as no other card has */
    int number;    /* of the cards here */
    int major, minor;
    int processors; /* its multiprocessors */
    int shared;     /* bytes of shared memory that a block may have */
};

/* How many cards there are; 0 with why, -1 with why when the driver knows of none that it can
 * serve, as it is too old. */
int gpu_count(char *why, size_t n_why);
/* The card of this number, below gpu_count(). False, with why, when it does not work or has no code
 * here. */
bool gpu_open(struct gpu *gpu, int number, char *why, size_t n_why);
void gpu_close(struct gpu *gpu);

/* NULL: there is no memory left; or, with *why, the card failed before. */
void *gpu_alloc(struct gpu *gpu, size_t bytes, const char **why);
void gpu_free(struct gpu *gpu, void *block);
size_t gpu_memory_free(struct gpu *gpu);

/* Page-locked host memory; NULL: none to be had. */
void *gpu_host_alloc(struct gpu *gpu, size_t bytes);
void gpu_host_free(struct gpu *gpu, void *block);

void gpu_zero(struct gpu *gpu, void *at, size_t bytes);
void gpu_copy_in(struct gpu *gpu, void *to, const void *host,
                 size_t bytes); /* host is free on return, page-locked memory after gpu_wait() */
void gpu_copy_out(struct gpu *gpu, void *host, const void *from, size_t bytes); /* waits */
/* What went wrong so far, without waiting or after all that is queued; NULL: nothing. */
const char *gpu_error(struct gpu *gpu);
const char *gpu_wait(struct gpu *gpu);
bool gpu_done(struct gpu *gpu); /* whether all that is queued is done, or failed */

/* Marks in the queue, and the seconds between two of them, which waits for the second. NULL: none
 * to be had. */
void *gpu_mark_new(struct gpu *gpu);
void gpu_mark_free(void *mark);
void gpu_mark(struct gpu *gpu, void *mark);
double gpu_seconds(void *from, void *to);

/* Sums before each place: out[i] = in[0] + ... + in[i-1]. temp has gpu_scan_bytes(n). */
size_t gpu_scan_bytes(size_t n);
void gpu_scan(struct gpu *gpu, void *temp, size_t temp_bytes, const uint64_t *in, uint64_t *out,
              size_t n);
/* Values in the order of the lowest `bits` bits of their keys; equal keys stay in order. temp has
 * gpu_sort_bytes(n). */
size_t gpu_sort_bytes(size_t n);
void gpu_sort(struct gpu *gpu, void *temp, size_t temp_bytes, const uint32_t *key,
              uint32_t *key_out, const uint32_t *value, uint32_t *value_out, size_t n, int bits);
