/* Merges splats to coarser levels of detail. Pairs of neighbours are replaced by one Gaussian with
 * the same total weight, mean and covariance, where the weight of a splat is its opacity times its
 * projected area. The pairs that change an image least are merged first. */
#pragma once

#include "spin.h"

/* Merges the splats of `from`, which has all attribute columns and no NaN, until at most n >= 1 are
 * left. *error: the sum of the costs of all merges is added to it. */
spin_status spin_merge_splats(const struct spin_splats *from, size_t n, struct spin_splats *out,
                              double *error);
