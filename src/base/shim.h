/* Shared objects of ours that stand before a C++ library, loaded when first needed: who does not need
 * them pays neither for their start-up nor for a C++ runtime. */
#ifndef SPIN_BASE_SHIM_H
#define SPIN_BASE_SHIM_H

#include "spin.h"

struct spin_shim {
    const char *file;     /* "spin-image.so" */
    const char *override; /* environment variable that may name another file */
    const char *symbol;   /* of its table, which begins with an int abi */
    int abi;
    const char *lacking; /* "images cannot be read: the OpenImageIO shim", for the message */
    const char *debian;  /* packages that its build needs */
    bool tried;
    char why[512]; /* it does not load; "" when there simply is no such file */
};

/* Loads it once and sets *table; else SPIN_E_UNSUPPORTED. Looks in lib/ and lib/spin4d/
 * beside the bin/ of the program (of the build, and of a prefix), and in spin4d/ of the LIBDIR of the build; takes
 * none that others can write, or whose folder they can. By any thread. */
spin_status spin_shim_need(struct spin_shim *shim, const void **table);

#endif
