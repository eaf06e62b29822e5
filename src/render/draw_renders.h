/* Draws the images of the data set "renders", see scene/renders.h. */
#pragma once

#include "spin.h"

/* Make images of that data set readable until the end of a call. Usage, at its start:
 * SPIN_LEAVES(spin_renders_end) int renders = spin_renders_begin(n_threads). Nested calls share the
 * state. n_threads: threads that draw; 0: one for each core. */
int spin_renders_begin(int n_threads);
void spin_renders_end(const int *renders);
