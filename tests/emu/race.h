/* The state of the running thread, for the race detector. */
#ifndef SPIN_TESTS_EMU_RACE_H
#define SPIN_TESTS_EMU_RACE_H

#include <stddef.h>
#include <stdint.h>

struct emu_epoch {
    uint32_t launch, block; /* counted over the whole program */
    uint32_t thread, barriers, warp_barriers[32];
};

struct emu_epoch *
emu_now(const void *at);            /* NULL: host code, or `at` is on the thread's own stack */
bool emu_is_shared(const void *at); /* whether `at` is shared memory of a block */
void emu_die(const char *what) __attribute__((noreturn));

#endif
