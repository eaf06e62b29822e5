/* Matches splats of one frame with the most similar splats of the next. */
#pragma once

#include "base/pool.h"
#include "spin.h"

/* Splats of a frame, to be matched. */
struct spin_link_side {
    size_t n;
    const float *at;   /* [n][3] positions */
    const float *look; /* [n][width] other values, where matched splats differ by at most 1 */
};

#define SPIN_NO_LINK UINT32_MAX

/* next [from->n] = the splat of `to` that matches a splat of `from`, or SPIN_NO_LINK. Matched
 * splats are at most reach [from->n] apart (0: no match) and differ by at most 1 in each value; no
 * splat is matched twice. Pairs with the smallest sum of squares (of the distance in units of
 * reach, and of the differences) take precedence. All values must be finite. The result does not
 * depend on the number of threads. */
spin_status spin_link(struct spin_pool *pool, const struct spin_link_side *from, const float *reach,
                      const struct spin_link_side *to, size_t width, uint32_t *next);
