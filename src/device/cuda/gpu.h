/* Wraps the CUDA functions that the device uses. gpu.cu implements them with the CUDA runtime and
 * CUB. In the emulation on the host (SPIN_EMU), tests/emu implements them, and the compiler first
 * includes tests/emu/emu.h, which defines the CUDA C++ of the kernels: __global__, threadIdx,
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
bool emu_launches(struct gpu *gpu); /* false: a test simulates the loss of the GPU */
#else
#define GPU_LAUNCH(gpu, kernel, grid, block, ...)                                                  \
    kernel<<<grid, block, 0, (cudaStream_t)(gpu)->stream>>>(__VA_ARGS__)
/* Launches a kernel with `bytes` of dynamic shared memory, at most gpu->shared. In the kernel
 * GPU_SHARED declares this memory, aligned to 16 bytes. */
#define GPU_LAUNCH_SHARED(gpu, kernel, grid, block, bytes, ...)                                    \
    (cudaFuncSetAttribute(kernel, cudaFuncAttributeMaxDynamicSharedMemorySize, bytes),             \
     kernel<<<grid, block, bytes, (cudaStream_t)(gpu)->stream>>>(__VA_ARGS__))
#define GPU_SHARED(type, name) extern __shared__ __align__(16) type name[]
#endif

/* Block size of kernels with one thread per element, and the number of blocks for n elements. */
enum { GPU_BLOCK = 256 };
static inline unsigned gpu_blocks(size_t n) { return (unsigned)((n + GPU_BLOCK - 1) / GPU_BLOCK); }
/* Launches one thread for each of n elements; nothing if n is 0. */
#define GPU_EACH(gpu, n, kernel, ...)                                                              \
    do {                                                                                           \
        if ((n) > 0)                                                                               \
            GPU_LAUNCH(gpu, kernel, gpu_blocks(n), GPU_BLOCK, __VA_ARGS__);                        \
    } while (0)
/* Index of this thread among all threads of the launch, along x. */
#define GPU_INDEX() ((size_t)blockIdx.x * blockDim.x + threadIdx.x)

/* A GPU and its stream. Functions that return nothing are queued; gpu_error() and gpu_wait() return
 * their errors and those of kernels. */
struct gpu {
    void *stream;
    void *pool;       /* memory pool, which keeps freed memory; or NULL */
    char name[48];    /* name of the GPU */
    char id[40];      /* unique id of the GPU */
    int number;       /* index among the GPUs of this machine */
    int major, minor; /* compute capability */
    int processors;   /* number of multiprocessors */
    int shared;       /* largest dynamic shared memory of a block, in bytes */
};

/* Number of GPUs. Sets `why` if it is 0, or -1: a driver is present, but too old for this build's
 * CUDA runtime. */
int gpu_count(char *why, size_t n_why);
/* Opens GPU `number`, below gpu_count(). Returns false and sets `why` if the GPU does not work or
 * this build has no code for it. */
bool gpu_open(struct gpu *gpu, int number, char *why, size_t n_why);
void gpu_close(struct gpu *gpu);

/* Returns NULL if out of memory, with *why NULL; or after any other error, with *why set. */
void *gpu_alloc(struct gpu *gpu, size_t bytes, const char **why);
void gpu_free(struct gpu *gpu, void *block);
size_t gpu_memory_free(struct gpu *gpu);

/* Page-locked host memory; NULL if not available. */
void *gpu_host_alloc(struct gpu *gpu, size_t bytes);
void gpu_host_free(struct gpu *gpu, void *block);

void gpu_zero(struct gpu *gpu, void *at, size_t bytes);
/* `host` may be overwritten after the call; if it is page-locked, only after gpu_wait(). */
void gpu_copy_in(struct gpu *gpu, void *to, const void *host, size_t bytes);
void gpu_copy_out(struct gpu *gpu, void *host, const void *from, size_t bytes); /* waits */
/* Return the first error so far; NULL: none. gpu_wait() waits for the stream first. */
const char *gpu_error(struct gpu *gpu);
const char *gpu_wait(struct gpu *gpu);
bool gpu_done(struct gpu *gpu); /* whether all queued work is done, or has failed */

/* Events in the stream. gpu_seconds() returns the time between two events, and waits for the
 * second. gpu_mark_new() returns NULL if no event can be created; the other functions accept
 * NULL. */
void *gpu_mark_new(struct gpu *gpu);
void gpu_mark_free(void *mark);
void gpu_mark(struct gpu *gpu, void *mark);
double gpu_seconds(void *from, void *to);

/* Exclusive prefix sums: out[i] = in[0] + ... + in[i-1]. temp has gpu_scan_bytes(n). */
size_t gpu_scan_bytes(size_t n);
void gpu_scan(struct gpu *gpu, void *temp, size_t temp_bytes, const uint64_t *in, uint64_t *out,
              size_t n);
/* Stable sort of values by the lowest `bits` bits of their keys. temp has gpu_sort_bytes(n). */
size_t gpu_sort_bytes(size_t n);
void gpu_sort(struct gpu *gpu, void *temp, size_t temp_bytes, const uint32_t *key,
              uint32_t *key_out, const uint32_t *value, uint32_t *value_out, size_t n, int bits);
