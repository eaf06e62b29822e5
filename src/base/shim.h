/* Shared objects that are loaded on first use. There are two kinds: shims, which are part of spin4d
 * and wrap libraries that are slow to load or need the C++ runtime; and libraries of the system,
 * which may be missing. */
#pragma once

#include "spin.h"

struct spin_shim {
    const char *file;     /* name of the shared object, such as "spin-image.so" */
    const char *override; /* environment variable with the path of a file to load instead */
    /* Name of the function table in the shared object; the first member of the table is int abi. */
    const char *symbol;
    int abi;
    /* Beginning of the error message if the shared object is missing, such as "images cannot be
     * read: the OpenImageIO shim". */
    const char *lacking;
    const char *debian; /* Debian packages that are needed to build the shared object */
    bool tried;
    bool refused;  /* other users could have written the object; `why` states what to do */
    char why[512]; /* why the shared object cannot be loaded; "" if its file does not exist */
};

/* Load the shared object, unless that was already done or tried, and set *table. Returns
 * SPIN_E_UNSUPPORTED if the object cannot be loaded. Returns SPIN_E_MEMORY if memory ran out; the
 * next call then tries again. Searches lib/ and lib/spin4d/ beside the program's bin/ (of the
 * build, or of an installation prefix), then spin4d/ in the LIBDIR of the build. Refuses files and
 * folders that other users can write to. Thread-safe. */
spin_status spin_shim_load(struct spin_shim *shim, const void **table);

/* A library of the system. Its header declares the types of the functions. */
struct spin_library {
    const char *file;     /* name of the library, such as "libzstd.so.1" */
    const char *override; /* environment variable with the path of a file to load instead */
    /* Beginning of the error message: the word "zstd" in "zstd needs the library ...". */
    const char *user;
    const struct spin_library_function {
        const char *name;
        void *into; /* address of the function pointer to set */
    } * function;   /* the last entry has the name NULL */
    bool tried;
    char why[256]; /* why the library is unavailable */
};

/* Load the library, unless that was already done or tried, and set the function pointers. Returns
 * the same errors as spin_shim_load(). Thread-safe. */
spin_status spin_library_load(struct spin_library *library);
