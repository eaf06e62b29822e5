/* CUDA C++ for the host compiler, as far as our kernels use it. The compiler includes this file
 * first, with SPIN_EMU defined. A block runs on one host thread, each of its threads is a fiber,
 * and the test chooses the order in which blocks and fibers are resumed: SPIN_EMU_ORDER = forward,
 * reverse or shuffle:SEED.
 *
 * Shared memory is poisoned before every block. It must be declared in functions that are not
 * templates, since compilers ignore the section attribute in templates. Barriers and warp
 * operations are one primitive, emu_meet(): threads leave a value and wait for the participants.
 * Behaviour that CUDA leaves undefined ends the program with a message: threads that never arrive,
 * wait at different places, or name a different mask or one without themselves; see emu.cpp. */
#ifndef SPIN_TESTS_EMU_EMU_H
#define SPIN_TESTS_EMU_EMU_H

#include <math.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>

#define __global__
#define __device__
#define __host__
#define __forceinline__ inline
#define __launch_bounds__(...)

/* The shared memory of all kernels of one file is a section, whose name the Makefile gives. */
#ifndef EMU_SHARED
#define EMU_SHARED emu_shared
#endif
#define EMU_TEXT_OF(name) #name
#define EMU_TEXT(name) EMU_TEXT_OF(name)
#define EMU_JOIN_OF(a, b) a##b
#define EMU_JOIN(a, b) EMU_JOIN_OF(a, b)
#define __shared__ static __attribute__((section(EMU_TEXT(EMU_SHARED)), aligned(16)))
struct emu_shared {
    char *from, *to;
};
extern "C" {
extern char EMU_JOIN(__start_, EMU_SHARED)[] __attribute__((weak, visibility("hidden")));
extern char EMU_JOIN(__stop_, EMU_SHARED)[] __attribute__((weak, visibility("hidden")));
}
static const struct emu_shared emu_shared_of_file = {EMU_JOIN(__start_, EMU_SHARED),
                                                     EMU_JOIN(__stop_, EMU_SHARED)};

struct dim3 {
    unsigned x, y, z;
    dim3(unsigned a = 1, unsigned b = 1, unsigned c = 1) : x(a), y(b), z(c) {}
};

/* The running thread, and its launch. */
extern dim3 emu_thread_index, emu_block_index, emu_block_size, emu_grid_size;
#define threadIdx emu_thread_index
#define blockIdx emu_block_index
#define blockDim emu_block_size
#define gridDim emu_grid_size

void emu_run(const char *name, dim3 grid, dim3 block, size_t dynamic_bytes,
             struct emu_shared of_file, void (*call)(void *), void *kernel);

template <class F> void emu_launch(const char *name, dim3 grid, dim3 block, F kernel)
{
    emu_run(
        name, grid, block, 0, emu_shared_of_file, [](void *k) { (*(F *)k)(); }, &kernel);
}
template <class F>
void emu_launch_dynamic(const char *name, dim3 grid, dim3 block, size_t bytes, F kernel)
{
    emu_run(
        name, grid, block, bytes, emu_shared_of_file, [](void *k) { (*(F *)k)(); }, &kernel);
}
enum { EMU_MOST_SHARED = 163 * 1024 }; /* as on sm_80; requesting more ends the program */
void *emu_dynamic(void);               /* the dynamic shared memory of the running block */

enum emu_op {
    EMU_SYNC,
    EMU_SYNC_AND,
    EMU_SYNC_OR,
    EMU_SYNC_COUNT,
    EMU_WARP_SYNC,
    EMU_SHUFFLE,
    EMU_SHUFFLE_UP,
    EMU_SHUFFLE_DOWN,
    EMU_SHUFFLE_XOR,
    EMU_BALLOT,
    EMU_ANY,
    EMU_ALL,
    EMU_MATCH,
    EMU_REDUCE_ADD,
    EMU_MMA
};
/* Waits for the threads of the block or of the warp's mask; returns this thread's result of the
 * operation. */
uint64_t emu_meet(enum emu_op op, const char *file, int line, uint32_t mask, uint64_t value,
                  int arg);

#define EMU_MEET(op, mask, value, arg) emu_meet(op, __FILE__, __LINE__, mask, value, arg)
#define __syncthreads() ((void)EMU_MEET(EMU_SYNC, 0, 0, 0))
#define __syncthreads_and(v) ((int)EMU_MEET(EMU_SYNC_AND, 0, !!(v), 0))
#define __syncthreads_or(v) ((int)EMU_MEET(EMU_SYNC_OR, 0, !!(v), 0))
#define __syncthreads_count(v) ((int)EMU_MEET(EMU_SYNC_COUNT, 0, !!(v), 0))
#define __syncwarp(mask) ((void)EMU_MEET(EMU_WARP_SYNC, mask, 0, 0))
#define __shfl_sync(mask, v, lane) emu_as(v, EMU_MEET(EMU_SHUFFLE, mask, emu_bits(v), lane))
#define __shfl_up_sync(mask, v, by)                                                                \
    emu_as(v, EMU_MEET(EMU_SHUFFLE_UP, mask, emu_bits(v), (int)(by)))
#define __shfl_down_sync(mask, v, by)                                                              \
    emu_as(v, EMU_MEET(EMU_SHUFFLE_DOWN, mask, emu_bits(v), (int)(by)))
#define __shfl_xor_sync(mask, v, by) emu_as(v, EMU_MEET(EMU_SHUFFLE_XOR, mask, emu_bits(v), by))
#define __ballot_sync(mask, v) ((unsigned)EMU_MEET(EMU_BALLOT, mask, !!(v), 0))
#define __any_sync(mask, v) ((int)EMU_MEET(EMU_ANY, mask, !!(v), 0))
#define __all_sync(mask, v) ((int)EMU_MEET(EMU_ALL, mask, !!(v), 0))
#define __match_any_sync(mask, v) ((unsigned)EMU_MEET(EMU_MATCH, mask, emu_bits(v), 0))
#define __reduce_add_sync(mask, v) ((unsigned)EMU_MEET(EMU_REDUCE_ADD, mask, (uint32_t)(v), 0))
unsigned emu_active(void);

/* mma.sync of tensor cores: registers of the lane, as in src/device/cuda/mma.h. Consecutive
 * products wait only once. */
struct emu_mma_queue {
    enum { MOST = 24 };
    struct {
        float *c;
        const uint32_t *a, *b;
    } at[MOST];
    int n = 0;

    void add(float *c, const uint32_t *a, const uint32_t *b) { at[n++] = {c, a, b}; }
    void run() { EMU_MEET(EMU_MMA, 0xffffffffu, (uint64_t)(uintptr_t)this, 0); }
};
/* The nearest tf32 number; ties round away from 0. */
static inline uint32_t emu_tf32(float v)
{
    uint32_t bits;

    memcpy(&bits, &v, sizeof bits);
    return v != v ? 0x7fffffffu : v - v != 0 ? bits : (bits + 0x1000u) & ~0x1fffu;
}

template <class T> uint64_t emu_bits(T v)
{
    uint64_t bits = 0;

    static_assert(sizeof v <= sizeof bits);
    memcpy(&bits, &v, sizeof v);
    return bits;
}
template <class T> T emu_as(T like, uint64_t bits)
{
    memcpy(&like, &bits, sizeof like);
    return like;
}

static inline int __popc(unsigned v) { return __builtin_popcount(v); }
static inline int __ffs(int v) { return __builtin_ffs(v); }
static inline int __clz(int v) { return v ? __builtin_clz((unsigned)v) : 32; }

struct float2 {
    float x, y;
};
struct float4 {
    float x, y, z, w;
};
static inline float4 make_float4(float x, float y, float z, float w) { return {x, y, z, w}; }
static inline float4 operator+(float4 a, float4 b)
{
    return {a.x + b.x, a.y + b.y, a.z + b.z, a.w + b.w};
}

/* Fibers switch only where they wait, so plain code is atomic here. The race detector is notified,
 * if built in. */
void emu_touch_atomic(const void *at, size_t bytes);
#define EMU_ATOMIC template <class T> __attribute__((noinline, no_sanitize("thread"))) T
EMU_ATOMIC atomicAdd(T *at, T v)
{
    T before = *at;

    emu_touch_atomic(at, sizeof *at);
    *at = before + v;
    return before;
}
EMU_ATOMIC atomicExch(T *at, T v)
{
    T before = *at;

    emu_touch_atomic(at, sizeof *at);
    *at = v;
    return before;
}
EMU_ATOMIC atomicMax(T *at, T v)
{
    T before = *at;

    emu_touch_atomic(at, sizeof *at);
    *at = before > v ? before : v;
    return before;
}
EMU_ATOMIC atomicMin(T *at, T v)
{
    T before = *at;

    emu_touch_atomic(at, sizeof *at);
    *at = before < v ? before : v;
    return before;
}

#endif
