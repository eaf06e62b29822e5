/* SIMD paths of the CPU device that took part in a training. Their results differ in the last bits.
 */
#pragma once

#include "spin.h"

struct spin_code_paths {
    const char *now; /* of this run's device */
    char all[32];    /* "v4", or "v3+v4" after a resume */
};

void spin_code_paths_begin(struct spin_code_paths *paths, const char *now);
/* Adds the paths, "v3" or "v3+v4" or NULL, that did earlier parts of the work. Warns if one differs
 * from the current path. */
void spin_code_paths_add(struct spin_code_paths *paths, const char *before);
