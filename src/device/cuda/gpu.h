/* Wraps the CUDA functions that the device uses. gpu.cu implements these wrappers with the CUDA
 * runtime and CUB. In the emulation on the host (SPIN_EMU), tests/emu implements them, and the
 * compiler first includes tests/emu/emu.h, which defines the CUDA C++ of the kernels: __global__,
 * threadIdx, __syncthreads() and so on. */
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
bool emu_launches(struct gpu *gpu); /* false if a test simulates the loss of the GPU */
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

/* GPU_BLOCK is the block size of kernels with one thread per element; gpu_blocks(n) is the number
 * of blocks for n elements. */
enum { GPU_BLOCK = 256 };
static inline unsigned gpu_blocks(size_t n) { return (unsigned)((n + GPU_BLOCK - 1) / GPU_BLOCK); }
/* Launches one thread for each of n elements. Does nothing if n is 0. */
#define GPU_EACH(gpu, n, kernel, ...)                                                              \
    do {                                                                                           \
        if ((n) > 0)                                                                               \
            GPU_LAUNCH(gpu, kernel, gpu_blocks(n), GPU_BLOCK, __VA_ARGS__);                        \
    } while (0)
/* Index of this thread among all threads of the launch, along x. */
#define GPU_INDEX() ((size_t)blockIdx.x * blockDim.x + threadIdx.x)

/* A GPU and its stream. Functions that return nothing only queue their work; gpu_error() and
 * gpu_wait() return the errors of this work and of kernels. */
struct gpu {
    void *stream;
    void *pool;       /* memory pool, which keeps freed memory; NULL: no pool */
    char name[48];    /* name of the GPU */
    int number;       /* index among the GPUs of this machine */
    int major, minor; /* compute capability */
    int processors;   /* number of multiprocessors */
    int shared;       /* largest dynamic shared memory of a block, in bytes */
};

/* Returns the number of GPUs; or -1 if a driver is present but too old for this build's CUDA
 * runtime. For 0 and -1, sets `why` to the reason. */
int gpu_count(char *why, size_t n_why);
/* Opens GPU `number`, which must be below gpu_count(). Returns false and sets `why` if the GPU does
 * not work, or if this build has no code for it. */
bool gpu_open(struct gpu *gpu, int number, char *why, size_t n_why);
void gpu_close(struct gpu *gpu);

/* Allocates device memory. Returns NULL on failure; *why is then NULL if memory ran out, otherwise
 * the text of the error. */
void *gpu_alloc(struct gpu *gpu, size_t bytes, const char **why);
void gpu_free(struct gpu *gpu, void *block);
size_t gpu_memory_free(struct gpu *gpu);

/* Returns page-locked host memory; NULL if none is available. */
void *gpu_host_alloc(struct gpu *gpu, size_t bytes);
void gpu_host_free(struct gpu *gpu, void *block);

void gpu_zero(struct gpu *gpu, void *at, size_t bytes);
/* Copies host memory to the device. The caller may overwrite pageable memory after the call, but
 * page-locked memory only after gpu_wait(). */
void gpu_copy_in(struct gpu *gpu, void *to, const void *host, size_t bytes);
/* Copies device memory to the host, and waits until the bytes are copied. */
void gpu_copy_out(struct gpu *gpu, void *host, const void *from, size_t bytes);
/* gpu_error() and gpu_wait() return the text of the first error so far, or NULL if there was none.
 * gpu_wait() first waits until all queued work is done. */
const char *gpu_error(struct gpu *gpu);
const char *gpu_wait(struct gpu *gpu);

/* Functions for events in the stream. gpu_mark_new() creates an event, or returns NULL if that
 * fails; the other functions accept NULL. gpu_mark() queues the event. gpu_seconds() waits for the
 * second of two events, and returns the time between them. */
void *gpu_mark_new(struct gpu *gpu);
void gpu_mark_free(void *mark);
void gpu_mark(struct gpu *gpu, void *mark);
double gpu_seconds(void *from, void *to);

/* gpu_scan() computes exclusive prefix sums: out[i] = in[0] + ... + in[i-1]. `temp` must have
 * gpu_scan_bytes(n) bytes. */
size_t gpu_scan_bytes(size_t n);
void gpu_scan(struct gpu *gpu, void *temp, size_t temp_bytes, const uint64_t *in, uint64_t *out,
              size_t n);
/* gpu_sort() sorts values by the lowest `bits` bits of their keys; the sort is stable. `temp` must
 * have gpu_sort_bytes(n) bytes. */
size_t gpu_sort_bytes(size_t n);
void gpu_sort(struct gpu *gpu, void *temp, size_t temp_bytes, const uint32_t *key,
              uint32_t *key_out, const uint32_t *value, uint32_t *value_out, size_t n, int bits);
