/* Shared objects that are loaded on first use. Shims are our own; they wrap libraries that are slow
 * to load or need the C++ runtime. Libraries of the system may be missing. */
#pragma once

#include "spin.h"

struct spin_shim {
    const char *file;     /* "spin-image.so" */
    const char *override; /* environment variable with the path of another file */
    const char *symbol;   /* name of the function table in it, whose first member is int abi */
    int abi;
    /* Begin of the message if it is missing: "images cannot be read: the OpenImageIO shim" */
    const char *lacking;
    const char *debian; /* Debian packages that are needed to build it */
    bool tried;
    char why[512]; /* why it cannot be loaded; "" if the file does not exist */
};

/* Load the object once and set *table; SPIN_E_UNSUPPORTED if that fails, SPIN_E_MEMORY if memory
 * ran out, after which the next call tries again. Searches lib/ and lib/spin4d/ beside the
 * program's bin/ (of the build, or of an installation prefix), then spin4d/ in the LIBDIR of the
 * build. Refuses files and folders that other users can write to. Thread-safe. */
spin_status spin_shim_need(struct spin_shim *shim, const void **table);

/* A library of the system. Its header declares the types of the functions. */
struct spin_library {
    const char *file;     /* "libzstd.so.1" */
    const char *override; /* environment variable with the path of another file */
    const char *user;     /* begin of the message "zstd needs the library ..." */
    const struct spin_library_function {
        const char *name;
        void *into; /* address of the function pointer to set */
    } * function;   /* terminated by a NULL name */
    bool tried;
    char why[256]; /* why it is unavailable */
};

/* Load the library once and set the function pointers; fails as spin_shim_need() does.
 * Thread-safe. */
spin_status spin_library_need(struct spin_library *library);
