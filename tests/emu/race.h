/* What the race detector knows of the thread that runs. */
#ifndef SPIN_TESTS_EMU_RACE_H
#define SPIN_TESTS_EMU_RACE_H

#include <stddef.h>
#include <stdint.h>

struct emu_epoch {
    uint32_t launch, block; /* counted over all */
    uint32_t thread, barriers, warp_barriers[32];
};

struct emu_epoch *
emu_now(const void *at);            /* NULL: the host, or `at` is on the thread's own stack */
bool emu_is_shared(const void *at); /* by the threads of one block */
void emu_die(const char *what) __attribute__((noreturn));

#endif
