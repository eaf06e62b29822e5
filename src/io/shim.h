/* Shared objects of ours that stand before a C++ library, loaded when first needed: who does not need
 * them pays neither for their start-up nor for a C++ runtime. */
#ifndef SPIN_IO_SHIM_H
#define SPIN_IO_SHIM_H

#include "spin.h"

struct spin_shim {
    const char *file;     /* "spin-image.so" */
    const char *override; /* environment variable that may name another file */
    const char *symbol;   /* of its table, which begins with an int abi */
    int abi;
};

/* The table, or NULL with the reason in why ("" when there simply is no such file). Looks beside the
 * program (in lib/ of the build, where `make install` puts it) and below the prefix. */
const void *spin_shim_load(const struct spin_shim *shim, char *why, size_t n_why);

#endif
