/* Renders the images of the data set kind "renders" (scene/renders.h), whose images do not exist as
 * files: each is a render of the splats of a bundle. */
#pragma once

#include "spin.h"

/* Images of such data sets can be read only between these two calls. A function that reads images
 * begins with SPIN_LEAVES(spin_renders_end) int renders = spin_renders_begin(n_threads), which ends
 * the access when the function returns. Pairs of calls may be nested; the n_threads of the
 * outermost call is used. n_threads: number of threads that render; 0 means one for each core. */
int spin_renders_begin(int n_threads);
void spin_renders_end(const int *renders);
