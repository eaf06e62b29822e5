/* Internals of the CPU device. Every file of this folder is compiled once for each SIMD path, with
 * matching compiler flags, and device.c selects a path at run time. SPIN_CPU_PATH is the path:
 * base, v3 or v4 on x86-64, elsewhere only base, which uses NEON on Arm. SPIN_CPU(name) makes names
 * unique by adding the path. */
#pragma once

#include "base/log.h"
#include "base/mem.h"
#include "base/pool.h"
#include "device/device.h"

#define SPIN_CPU_JOIN2(path, name) spin_cpu_##path##_##name
#define SPIN_CPU_JOIN(path, name) SPIN_CPU_JOIN2(path, name)
#define SPIN_CPU(name) SPIN_CPU_JOIN(SPIN_CPU_PATH, name)

/* Scratch buffers of the verbs. A buffer is enlarged on demand and kept for later calls. */
enum spin_cpu_scratch {
    SPIN_SCRATCH_GRID,
    SPIN_SCRATCH_MLP,
    SPIN_SCRATCH_TILE,
    SPIN_SCRATCH_TILE_KEYS,
    SPIN_SCRATCH_BLEND,
    SPIN_SCRATCH_LOSS,
    SPIN_SCRATCH_TRUTH,
    SPIN_SCRATCH_ACTIVE,
    SPIN_SCRATCHES
};

struct spin_cpu {
    struct spin_pool *pool;
    struct spin_scratch scratch[SPIN_SCRATCHES];
    /* time spent in each operation since clock() was last called for it */
    double seconds[SPIN_N_OPS];
    spin_status failed; /* error that the next wait() reports and clears */
    char why[256];      /* message of this error */
};

/* Returns a scratch buffer of at least `bytes` bytes, 64-byte aligned, with undefined contents.
 * Returns NULL if out of memory; the calling verb then leaves its results unchanged, and the next
 * wait() or download() reports the error. */
void *SPIN_CPU(scratch_need)(struct spin_device *d, enum spin_cpu_scratch which, size_t bytes);
#define spin_cpu_scratch_need SPIN_CPU(scratch_need)

static inline struct spin_pool *spin_cpu_pool(struct spin_device *d)
{
    return ((struct spin_cpu *)d->state)->pool;
}

/* Scope guard: adds the time from its definition to the end of its scope to the time of operation
 * `op`. */
struct spin_cpu_clock {
    struct spin_device *d;
    int op;
    double start_s;
};
static inline void spin_cpu_stop(struct spin_cpu_clock *c)
{
    ((struct spin_cpu *)c->d->state)->seconds[c->op] += spin_now_s() - c->start_s;
}
/* Defines a variable of type struct spin_cpu_clock. The attribute `unused` prevents a warning of
 * Clang, since the variable is never read. */
#define SPIN_CPU_CLOCK(d, op)                                                                      \
    __attribute__((unused))                                                                        \
    SPIN_LEAVES(spin_cpu_stop) struct spin_cpu_clock clock_of_verb = {d, op, spin_now_s()}

static inline float *spin_cpu_picture(const struct spin_view_batch *views, int view,
                                      float *pictures)
{
    return pictures ? pictures + (size_t)view * 3 * views->max_pixels : NULL;
}

/* Finds the active rows of one frame, which are consecutive in active->row. Sets *first to the
 * index of the first one in active->row, and returns their number. */
size_t SPIN_CPU(active_of)(const struct spin_active *active,
                           const struct spin_frame_of_batch *frame, size_t *first);

/* Declares each verb with the type of its member of spin_device_ops. */
#define SPIN_CPU_VERB(name) __typeof__(*((struct spin_device_ops *)0)->name) SPIN_CPU(name);
SPIN_DEVICE_VERBS(SPIN_CPU_VERB)
