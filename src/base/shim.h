/* Shared objects that are loaded when first needed. Those of ours stand before a C++ library: who
 * does not need them pays neither for their start-up nor for a C++ runtime. Those of the system may
 * be missing. */
#pragma once

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
 * beside the bin/ of the program (of the build, and of a prefix), and in spin4d/ of the LIBDIR of
 * the build; takes none that others can write, or whose folder they can. By any thread. */
spin_status spin_shim_need(struct spin_shim *shim, const void **table);

/* A library of the system. Its header has the types of the functions. */
struct spin_library {
    const char *file;     /* "libzstd.so.1" */
    const char *override; /* environment variable that may name another file */
    const char *user;     /* "zstd", for the message */
    const struct spin_library_function {
        const char *name;
        void *into; /* points to the pointer to the function */
    } * function;   /* ended by a NULL name */
    bool tried;
    char why[256]; /* it is not there */
};

/* Loads it once and fills in the functions; else SPIN_E_UNSUPPORTED. By any thread. */
spin_status spin_library_need(struct spin_library *library);
