/* A race detector for emulated kernels. They are compiled with -fsanitize=thread, so that the
 * compiler calls __tsan_read4() and the like before every access; this file defines these functions
 * instead of the sanitizer's library.
 *
 * Two accesses to the same 4 bytes in one launch race if they are by different threads, one of them
 * writes, not both are atomic, and nothing orders them: a barrier orders threads of one block, a
 * warp operation also orders lanes of a warp, and nothing orders threads of different blocks. Stack
 * memory is private to a thread. The last write and the last reads of each word are kept in a hash
 * table; a collision overwrites them, so there are no false alarms, but a race may be missed. */
#include "tests/emu/race.h"

#include <stdio.h>

enum { LOG2_PLACES = 17, PLACES = 1 << LOG2_PLACES, NOBODY = -1, SEVERAL = -2 };

struct access { /* kept small, since a kernel touches many words */
    uint32_t launch, block, barriers, warp_barriers;
    int16_t thread;
    bool atomic;
};
struct place {
    uintptr_t at;
    struct access write, read;
};
static struct place places[PLACES];

static bool ordered(const struct access *a, const struct emu_epoch *e)
{
    if (a->thread == NOBODY || a->launch != e->launch)
        return true;
    if (a->block != e->block)
        return false;
    if (a->barriers != e->barriers || a->thread == (int)e->thread)
        return true;
    return a->thread >= 0 && a->thread / 32 == (int)e->thread / 32 &&
           a->warp_barriers != e->warp_barriers[e->thread / 32];
}

static struct access access_of(const struct emu_epoch *e, bool atomic)
{
    return {e->launch,          e->block, e->barriers, e->warp_barriers[e->thread / 32],
            (int16_t)e->thread, atomic};
}

static void die(const char *what, uintptr_t at, const struct access *other)
{
    char text[160];

    snprintf(text, sizeof text,
             "a race: %s at %p, %s thread %d of %s block, and nothing between them", what,
             (void *)at, other->atomic ? "atomically by" : "by", other->thread,
             other->block == emu_now(NULL)->block ? "the same" : "another");
    emu_die(text);
}

/* The table entry of a word; neighbouring words are neighbours in the table, for cache locality. */
static struct place *place_of(uintptr_t at)
{
    enum { LOG2_NEAR = 6 };
    uint64_t word = at >> 2, far = (word >> LOG2_NEAR) * 0x9e3779b97f4a7c15u;

    return &places[far >> (64 - LOG2_PLACES + LOG2_NEAR) << LOG2_NEAR |
                   (word & ((1 << LOG2_NEAR) - 1))];
}

static void touch(uintptr_t at, bool write, bool atomic)
{
    struct emu_epoch *e = emu_now((const void *)at);
    struct place *p;

    if (!e)
        return;
    p = place_of(at);
    at &= ~(uintptr_t)3;
    if (p->at != at || (p->write.launch != e->launch && p->read.launch != e->launch)) {
        p->at = at;
        p->write.thread = p->read.thread = NOBODY;
    }
    if (p->write.block != e->block && emu_is_shared((const void *)at))
        p->write.thread = NOBODY;
    if (p->read.block != e->block && emu_is_shared((const void *)at))
        p->read.thread = NOBODY;
    if (!ordered(&p->write, e) && !(atomic && p->write.atomic))
        die(write ? "written twice" : "read while it is written", at, &p->write);
    if (write) {
        if (!ordered(&p->read, e))
            die("written while it is read", at, &p->read);
        p->write = access_of(e, atomic);
    } else if (p->read.thread != NOBODY && !ordered(&p->read, e)) {
        if (p->read.block != e->block) {
            p->read.thread = SEVERAL; /* every later write is a race */
            p->read.block = 0;        /* not the number of any block */
        } else if (p->read.thread == SEVERAL || p->read.thread / 32 != (int)e->thread / 32) {
            p->read.thread = SEVERAL; /* later writes race, unless after a barrier */
        } else {
            p->read = access_of(e, false); /* keeps only the last read of a warp */
        }
    } else {
        p->read = access_of(e, false);
    }
}

static void touch_all(const void *from, size_t bytes, bool write)
{
    uintptr_t at = (uintptr_t)from & ~(uintptr_t)3, end = (uintptr_t)from + bytes;

    for (; at < end; at += 4)
        touch(at, write, false);
}

void emu_touch_atomic(const void *at, size_t bytes)
{
    for (size_t i = 0; i < bytes; i += 4)
        touch((uintptr_t)at + i, true, true);
}

#define HOOK extern "C" __attribute__((visibility("hidden"))) void
#define HOOKS(n)                                                                                   \
    HOOK __tsan_read##n(void *at) { touch_all(at, n, false); }                                     \
    HOOK __tsan_write##n(void *at) { touch_all(at, n, true); }                                     \
    HOOK __tsan_unaligned_read##n(void *at) { touch_all(at, n, false); }                           \
    HOOK __tsan_unaligned_write##n(void *at) { touch_all(at, n, true); }                           \
    HOOK __tsan_volatile_read##n(void *at) { touch_all(at, n, false); }                            \
    HOOK __tsan_volatile_write##n(void *at) { touch_all(at, n, true); }
HOOKS(1)
HOOKS(2)
HOOKS(4)
HOOKS(8)
HOOKS(16)
HOOK __tsan_read_range(void *at, size_t n) { touch_all(at, n, false); }
HOOK __tsan_write_range(void *at, size_t n) { touch_all(at, n, true); }
HOOK __tsan_func_entry(void *) {}
HOOK __tsan_func_exit(void) {}
HOOK __tsan_init(void) {}
HOOK __tsan_vptr_update(void **, void *) {}
