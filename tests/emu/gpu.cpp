/* Implements src/device/cuda/gpu.h for the emulation: a GPU whose memory is host memory, and which
 * finishes every operation before the call returns.
 *
 * Environment variables for tests:
 *     SPIN_EMU_CARDS=N       number of GPUs (default 1); old: the driver is too old
 *     SPIN_EMU_OLD=N         the first N GPUs have no matching kernel image
 *     SPIN_EMU_NAME=NAME     name of the GPUs, to look like a real one
 *     SPIN_EMU_MEMORY=BYTES  memory of a GPU; 0: it does not report its memory
 *     SPIN_EMU_FULL=N        out of memory at the N-th allocation and the next one
 *     SPIN_EMU_FULL_FOR=M    or for M allocations
 *     SPIN_EMU_LOST=N        the GPU is lost at the N-th operation; later ones do nothing
 *     SPIN_EMU_PINNED=0      page-locked memory is not available
 *     SPIN_EMU_COPIES=FILE   closing the GPU appends a line: bytes copied from and to host memory
 *                            of each kind, kernel launches (including CUB's), and host waits */
#include "device/cuda/gpu.h"

#include <algorithm>
#include <malloc.h>
#include <map>
#include <numeric>
#include <stdio.h>
#include <stdlib.h>
#include <time.h>
#include <vector>

static size_t used, work, blocks, copied[2]; /* copied: ordinary, page-locked memory */
static size_t launches, waits;
static bool busy; /* something was queued since the host last waited */
static bool lost;

static size_t number_of(const char *name, size_t fallback)
{
    const char *text = getenv(name);

    return text && *text ? strtoull(text, NULL, 10) : fallback;
}

/* Page-locked blocks and their sizes in bytes. */
static std::map<char *, size_t> pinned;

static bool is_pinned(const void *at)
{
    auto block = pinned.upper_bound((char *)at);

    return block != pinned.begin() && (char *)at < (--block)->first + block->second;
}

/* A copy from page-locked memory is delayed as long as allowed: until the next operation begins, or
 * the host waits. */
static struct {
    void *to;
    const void *host;
    size_t bytes;
} late;

static void copy_late(void)
{
    if (late.bytes)
        memcpy(late.to, late.host, late.bytes);
    late.bytes = 0;
}

static void count(const void *host, size_t bytes) { copied[is_pinned(host)] += bytes; }

/* Counts an operation; returns false if the GPU is lost. */
static bool emu_works(struct gpu *)
{
    copy_late();
    busy = true;
    lost |= ++work == number_of("SPIN_EMU_LOST", 0);
    return !lost;
}

int gpu_count(char *why, size_t n_why)
{
    const char *cards = getenv("SPIN_EMU_CARDS");
    int n = (int)number_of("SPIN_EMU_CARDS", 1);

    if (cards && strcmp(cards, "old") == 0) {
        snprintf(why, n_why, "CUDA driver version is insufficient for CUDA runtime version");
        return -1;
    }
    if (n == 0)
        snprintf(why, n_why, "no CUDA-capable device is detected");
    return n;
}

bool emu_launches(struct gpu *gpu)
{
    launches++;
    return emu_works(gpu);
}

bool gpu_open(struct gpu *gpu, int number, char *why, size_t n_why)
{
    const char *name = getenv("SPIN_EMU_NAME");

    if ((size_t)number < number_of("SPIN_EMU_OLD", 0)) {
        snprintf(why, n_why, "GPU %d: no kernel image is available for execution on the device",
                 number);
        return false;
    }
    work = blocks = copied[0] = copied[1] = launches = waits = 0;
    lost = false;
    snprintf(gpu->name, sizeof gpu->name, "%s", name && *name ? name : "emulated");
    gpu->number = number;
    gpu->major = 8;
    gpu->processors = 3;
    gpu->shared = EMU_MOST_SHARED;
    return true;
}

void gpu_close(struct gpu *)
{
    const char *name = getenv("SPIN_EMU_COPIES");
    FILE *file = name && *name ? fopen(name, "a") : NULL;

    copy_late();
    if (!file)
        return;
    fprintf(file, "ordinary %zu pinned %zu launches %zu waits %zu\n", copied[0], copied[1],
            launches, waits);
    fclose(file);
}

size_t gpu_memory_free(struct gpu *)
{
    size_t all = number_of("SPIN_EMU_MEMORY", (size_t)1 << 32);

    return used < all ? all - used : 0;
}

/* Filled with NaN, so that code which relies on zeros fails. */
void *gpu_alloc(struct gpu *gpu, size_t bytes, const char **why)
{
    size_t full = number_of("SPIN_EMU_FULL", 0);
    void *block = NULL;

    *why = gpu_error(gpu);
    if (*why || (full && ++blocks >= full && blocks < full + number_of("SPIN_EMU_FULL_FOR", 2)))
        return NULL;
    if ((number_of("SPIN_EMU_MEMORY", 1) > 0 && bytes > gpu_memory_free(gpu)) ||
        posix_memalign(&block, 256, bytes + 1) != 0)
        return NULL;
    memset(block, 0xff, bytes);
    used += malloc_usable_size(block);
    return block;
}

void gpu_free(struct gpu *, void *block)
{
    used -= malloc_usable_size(block);
    free(block);
}

void *gpu_host_alloc(struct gpu *, size_t bytes)
{
    void *block = number_of("SPIN_EMU_PINNED", 1) > 0 ? aligned_alloc(64, bytes) : NULL;

    if (block)
        pinned[(char *)block] = bytes;
    return block;
}

void gpu_host_free(struct gpu *, void *block)
{
    copy_late();
    pinned.erase((char *)block);
    free(block);
}

void gpu_zero(struct gpu *gpu, void *at, size_t bytes)
{
    launches++;
    if (emu_works(gpu))
        memset(at, 0, bytes);
}

void gpu_copy_in(struct gpu *gpu, void *to, const void *host, size_t bytes)
{
    if (!emu_works(gpu))
        return;
    if (is_pinned(host))
        late = {to, host, bytes};
    else
        memcpy(to, host, bytes);
    count(host, bytes);
}

void gpu_copy_out(struct gpu *gpu, void *host, const void *from, size_t bytes)
{
    if (!emu_works(gpu))
        return;
    waits++;
    busy = false;
    memcpy(host, from, bytes);
    count(host, bytes);
}

const char *gpu_error(struct gpu *) { return lost ? "the GPU is lost" : NULL; }

const char *gpu_wait(struct gpu *gpu)
{
    waits += busy;
    busy = false;
    copy_late();
    return gpu_error(gpu);
}

void *gpu_mark_new(struct gpu *) { return calloc(1, sizeof(double)); }
void gpu_mark_free(void *mark) { free(mark); }

void gpu_mark(struct gpu *, void *mark)
{
    struct timespec t;

    clock_gettime(CLOCK_MONOTONIC, &t);
    if (mark)
        *(double *)mark = (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

double gpu_seconds(void *from, void *to)
{
    return from && to ? *(double *)to - *(double *)from : 0;
}

/* About as much as CUB needs. */
size_t gpu_scan_bytes(size_t n) { return 1024 + n / 64; }
size_t gpu_sort_bytes(size_t n) { return 4096 + 8 * n; }

void gpu_scan(struct gpu *gpu, void *temp, size_t temp_bytes, const uint64_t *in, uint64_t *out,
              size_t n)
{
    launches += 2; /* about as many as CUB */
    memset(temp, 0xff, temp_bytes);
    if (emu_works(gpu))
        std::exclusive_scan(in, in + n, out, (uint64_t)0);
}

void gpu_sort(struct gpu *gpu, void *temp, size_t temp_bytes, const uint32_t *key,
              uint32_t *key_out, const uint32_t *value, uint32_t *value_out, size_t n, int bits)
{
    uint32_t mask = bits == 32 ? UINT32_MAX : ((uint32_t)1 << bits) - 1;
    std::vector<size_t> order(n);

    launches += 2 + (size_t)(bits + 7) / 8;
    memset(temp, 0xff, temp_bytes);
    if (!emu_works(gpu))
        return;
    std::iota(order.begin(), order.end(), (size_t)0);
    std::stable_sort(order.begin(), order.end(),
                     [&](size_t a, size_t b) { return (key[a] & mask) < (key[b] & mask); });
    for (size_t i = 0; i < n; i++) {
        key_out[i] = key[order[i]];
        value_out[i] = value[order[i]];
    }
}
