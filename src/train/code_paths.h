/* The processor's code paths that did the work of a training. Their results differ in the last
 * bits. */
#pragma once

#include "spin.h"

struct spin_code_paths {
    const char *now; /* of this run's device */
    char all[32];    /* "v4", or "v3+v4" after a resume */
};

void spin_code_paths_begin(struct spin_code_paths *paths, const char *now);
/* Part of the work was done before by these, "v3" or "v3+v4"; or NULL. Another than now is a
 * warning. */
void spin_code_paths_add(struct spin_code_paths *paths, const char *before);
