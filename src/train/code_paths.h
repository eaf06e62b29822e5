/* Records the SIMD paths of the CPU device that took part in a training, since their results differ
 * in the last bits. */
#pragma once

#include "spin.h"

struct spin_code_paths {
    const char *now; /* path of this run's device */
    char all[32];    /* "v4", or "v3+v4" after a resume */
};

void spin_code_paths_begin(struct spin_code_paths *paths, const char *now);
/* Adds the paths of earlier parts of the work: "v3", "v3+v4" or NULL. Warns if a path is new. */
void spin_code_paths_add(struct spin_code_paths *paths, const char *before);
