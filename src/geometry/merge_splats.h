/* Merges splats to coarser levels of detail. Pairs of neighbours are replaced by one Gaussian with
 * the same total weight, mean and covariance, where the weight of a splat is its opacity times its
 * projected area. The pairs that change an image least are merged first. */
#pragma once

#include "spin.h"

#define SPIN_MERGE_NONE UINT32_MAX

/* The splats that are merged: pair[i][1] is merged into pair[i][0], one pair after the other. If
 * pair[i][0] is SPIN_MERGE_NONE, the splat is dropped. */
struct spin_merge_plan {
    uint32_t (*pair)[2];
    size_t n;
    double cost; /* sum of the costs of all merges */
};

/* Plans the merges that leave n >= 1 of the splats. frames [n_frames]: the same splats in some
 * frames of a clip, in the same rows, with all attribute columns and without NaN. A merge costs as
 * much as in that of these frames in which it costs most. seen: NULL, or [n] how much of each splat
 * is seen, in any unit; splats may then also be dropped. */
spin_status spin_merge_plan_make(const struct spin_splats *frames, int n_frames, const float *seen,
                                 size_t n, struct spin_merge_plan *out);
void spin_merge_plan_free(struct spin_merge_plan *plan);
/* Copies the splats of a frame to *out, in which the rows that others are merged into have new
 * values. skip: NULL, or [n], not 0 for rows that take no part in any merge. */
spin_status spin_merge_plan_apply(const struct spin_merge_plan *plan,
                                  const struct spin_splats *frame, const unsigned char *skip,
                                  struct spin_splats *out);

/* Merges the splats of `from` until at most n >= 1 are left. *cost: the sum of the costs of all
 * merges is added to it. */
spin_status spin_merge_splats(const struct spin_splats *from, size_t n, struct spin_splats *out,
                              double *cost);
