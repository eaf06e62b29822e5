/* Draws the images of the data set "renders", see scene/renders.h. */
#pragma once

#include "spin.h"

/* Between these two calls, the images of that data set can be read. A function that needs them
 * begins with SPIN_LEAVES(spin_renders_end) int renders = spin_renders_begin(n_threads). Nested
 * calls share the state. n_threads: number of threads that render; 0 means one for each core. */
int spin_renders_begin(int n_threads);
void spin_renders_end(const int *renders);
