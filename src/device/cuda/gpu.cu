/* Implements gpu.h with the CUDA runtime and CUB. This is the only file of the folder that the
 * emulation replaces. */
#include "device/cuda/gpu.h"

#include <cstdio>
#include <cub/device/device_radix_sort.cuh>
#include <cub/device/device_scan.cuh>
#include <cuda_runtime.h>

static const char *text_of(cudaError_t error)
{
    return error == cudaSuccess ? NULL : cudaGetErrorString(error);
}

/* Makes this GPU the current GPU of the thread, and returns its stream. Kernel launches need a
 * current GPU; GPU_LAUNCH relies on an earlier call of this function, such as that by gpu_mark() at
 * the start of each verb. */
static cudaStream_t stream_of(struct gpu *gpu)
{
    cudaSetDevice(gpu->number);
    return (cudaStream_t)gpu->stream;
}

int gpu_count(char *why, size_t n_why)
{
    int n = 0, driver = 0;
    cudaError_t error = cudaGetDeviceCount(&n);

    if (error == cudaSuccess && n > 0)
        return n;
    snprintf(why, n_why, "%s",
             cudaGetErrorString(error == cudaSuccess ? cudaErrorNoDevice : error));
    cudaGetLastError();
    /* CUDA returns this error for an old driver and also without a driver, but the driver version
     * is 0 in the second case. */
    return error == cudaErrorInsufficientDriver && cudaDriverGetVersion(&driver) == cudaSuccess &&
                   driver > 0
               ? -1
               : 0;
}

/* Returns the default memory pool of a GPU, configured to keep freed memory; NULL if the GPU has
 * none. */
static void *pool_of(int number)
{
    int has = 0;
    uint64_t keep = UINT64_MAX;
    cudaMemPool_t pool;

    if (cudaDeviceGetAttribute(&has, cudaDevAttrMemoryPoolsSupported, number) == cudaSuccess &&
        has && cudaDeviceGetDefaultMemPool(&pool, number) == cudaSuccess &&
        cudaMemPoolSetAttribute(pool, cudaMemPoolAttrReleaseThreshold, &keep) == cudaSuccess)
        return pool;
    cudaGetLastError();
    return NULL;
}

/* A kernel with which gpu_open() tests whether this build has code for the GPU. One kernel is
 * enough, since all files of this folder are compiled for the same architectures. */
static __global__ void probe_kernel() {}

bool gpu_open(struct gpu *gpu, int number, char *why, size_t n_why)
{
    cudaDeviceProp card = {};
    cudaFuncAttributes code;
    cudaStream_t stream;
    cudaError_t error = cudaSetDevice(number);

    gpu->number = number;
    if (error == cudaSuccess)
        error = cudaGetDeviceProperties(&card, number);
    if (error == cudaSuccess)
        error = cudaFuncGetAttributes(&code, probe_kernel);
    if (error == cudaSuccess)
        error = cudaStreamCreateWithFlags(&stream, cudaStreamNonBlocking);
    if (error != cudaSuccess) {
        snprintf(why, n_why, "%s (sm_%d%d): %s", card.name, card.major, card.minor,
                 cudaGetErrorString(error));
        cudaGetLastError();
        return false;
    }
    gpu->stream = stream;
    gpu->pool = pool_of(number);
    gpu->major = card.major;
    gpu->minor = card.minor;
    gpu->processors = card.multiProcessorCount;
    gpu->shared = (int)card.sharedMemPerBlockOptin;
    snprintf(gpu->name, sizeof gpu->name, "%s", card.name);
    return true;
}

void gpu_close(struct gpu *gpu)
{
    if (gpu->stream)
        cudaStreamDestroy(stream_of(gpu));
    if (gpu->pool)
        cudaMemPoolTrimTo((cudaMemPool_t)gpu->pool, 0);
    gpu->stream = NULL;
}

/* Allocates memory from the pool in stream order. Freed memory stays in the pool, so that the next
 * allocation is cheap. GPUs without memory pools, such as some virtual GPUs, use cudaMalloc(). */
void *gpu_alloc(struct gpu *gpu, size_t bytes, const char **why)
{
    void *block = NULL;
    cudaStream_t stream = stream_of(gpu);
    size_t room = bytes > 0 ? bytes : 1;
    cudaError_t error =
        gpu->pool ? cudaMallocAsync(&block, room, stream) : cudaMalloc(&block, room);

    /* the pool may be fragmented: empty it and try again */
    if (error == cudaErrorMemoryAllocation && gpu->pool) {
        cudaStreamSynchronize(stream);
        cudaMemPoolTrimTo((cudaMemPool_t)gpu->pool, 0);
        error = cudaMallocAsync(&block, room, stream);
    }
    *why = error == cudaErrorMemoryAllocation ? NULL : text_of(error);
    if (error == cudaErrorMemoryAllocation)
        cudaGetLastError(); /* clears the error, since the result NULL reports it */
    return error == cudaSuccess ? block : NULL;
}

void gpu_free(struct gpu *gpu, void *block)
{
    cudaStream_t stream = stream_of(gpu);

    if (gpu->pool) {
        cudaFreeAsync(block, stream);
        return;
    }
    cudaStreamSynchronize(stream);
    cudaFree(block);
}

size_t gpu_memory_free(struct gpu *gpu)
{
    size_t left = 0, all = 0;
    uint64_t kept = 0, used = 0;

    stream_of(gpu);
    if (cudaMemGetInfo(&left, &all) != cudaSuccess)
        return 0;
    if (gpu->pool &&
        cudaMemPoolGetAttribute((cudaMemPool_t)gpu->pool, cudaMemPoolAttrReservedMemCurrent,
                                &kept) == cudaSuccess &&
        cudaMemPoolGetAttribute((cudaMemPool_t)gpu->pool, cudaMemPoolAttrUsedMemCurrent, &used) ==
            cudaSuccess &&
        kept > used)
        left += kept - used;
    return left;
}

void *gpu_host_alloc(struct gpu *gpu, size_t bytes)
{
    void *block = NULL;

    stream_of(gpu);
    if (cudaHostAlloc(&block, bytes, cudaHostAllocDefault) == cudaSuccess)
        return block;
    /* Clears the error, since the result NULL reports it. If the GPU is lost, later calls fail
     * again. */
    cudaGetLastError();
    return NULL;
}

void gpu_host_free(struct gpu *gpu, void *block)
{
    cudaStreamSynchronize(stream_of(gpu));
    cudaFreeHost(block);
}

void gpu_zero(struct gpu *gpu, void *at, size_t bytes)
{
    cudaMemsetAsync(at, 0, bytes, stream_of(gpu));
}

/* If the bytes are in pageable memory, returns after they were copied; if they are in page-locked
 * memory, returns immediately. */
void gpu_copy_in(struct gpu *gpu, void *to, const void *host, size_t bytes)
{
    cudaMemcpyAsync(to, host, bytes, cudaMemcpyHostToDevice, stream_of(gpu));
}

void gpu_copy_out(struct gpu *gpu, void *host, const void *from, size_t bytes)
{
    cudaMemcpyAsync(host, from, bytes, cudaMemcpyDeviceToHost, stream_of(gpu));
    cudaStreamSynchronize(stream_of(gpu));
}

const char *gpu_error(struct gpu *gpu)
{
    (void)gpu;
    return text_of(cudaGetLastError());
}

const char *gpu_wait(struct gpu *gpu)
{
    const char *before = gpu_error(gpu), *after = text_of(cudaStreamSynchronize(stream_of(gpu)));

    return before ? before : after;
}

void *gpu_mark_new(struct gpu *gpu)
{
    cudaEvent_t mark;

    stream_of(gpu);
    return cudaEventCreate(&mark) == cudaSuccess ? mark : NULL;
}

void gpu_mark_free(void *mark)
{
    if (mark)
        cudaEventDestroy((cudaEvent_t)mark);
}

void gpu_mark(struct gpu *gpu, void *mark)
{
    if (mark)
        cudaEventRecord((cudaEvent_t)mark, stream_of(gpu));
}

double gpu_seconds(void *from, void *to)
{
    float ms = 0;

    if (!from || !to || cudaEventSynchronize((cudaEvent_t)to) != cudaSuccess ||
        cudaEventElapsedTime(&ms, (cudaEvent_t)from, (cudaEvent_t)to) != cudaSuccess)
        return 0;
    return 1e-3 * ms;
}

size_t gpu_scan_bytes(size_t n)
{
    size_t bytes = 0;

    cub::DeviceScan::ExclusiveSum(NULL, bytes, (const uint64_t *)NULL, (uint64_t *)NULL, n);
    return bytes;
}

void gpu_scan(struct gpu *gpu, void *temp, size_t temp_bytes, const uint64_t *in, uint64_t *out,
              size_t n)
{
    if (n > 0)
        cub::DeviceScan::ExclusiveSum(temp, temp_bytes, in, out, n, stream_of(gpu));
}

size_t gpu_sort_bytes(size_t n)
{
    size_t bytes = 0;

    cub::DeviceRadixSort::SortPairs(NULL, bytes, (const uint32_t *)NULL, (uint32_t *)NULL,
                                    (const uint32_t *)NULL, (uint32_t *)NULL, n);
    return bytes;
}

void gpu_sort(struct gpu *gpu, void *temp, size_t temp_bytes, const uint32_t *key,
              uint32_t *key_out, const uint32_t *value, uint32_t *value_out, size_t n, int bits)
{
    if (n > 0)
        cub::DeviceRadixSort::SortPairs(temp, temp_bytes, key, key_out, value, value_out, n, 0,
                                        bits, stream_of(gpu));
}
