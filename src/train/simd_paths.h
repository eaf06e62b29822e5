/* Records the SIMD paths of the CPU device that took part in a training, since their results differ
 * in the last bits. */
#pragma once

#include "spin.h"

struct spin_simd_paths {
    const char *now; /* SIMD path of this run's device */
    char all[32];    /* all paths of the training: "v4", or "v3+v4" after a resume on another CPU */
};

void spin_simd_paths_begin(struct spin_simd_paths *paths, const char *now);
/* Adds the SIMD paths that did earlier parts of the work: "v3", "v3+v4" or, if there are none,
 * NULL. Warns if one of them is not in the list yet. */
void spin_simd_paths_add(struct spin_simd_paths *paths, const char *before);
