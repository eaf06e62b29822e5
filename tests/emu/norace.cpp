/* Without a race detector nobody wants to know of atomic operations. */
#include "tests/emu/emu.h"

void emu_touch_atomic(const void *, size_t) {}
