/* Matches splats of one frame with the most similar splats of the next. */
#pragma once

#include "base/pool.h"
#include "spin.h"

/* Splats of a frame, to be matched. */
struct spin_link_side {
    size_t n;
    const float *at; /* [n][3] positions */
    /* [n][width] other values, such as colours, in units of the largest difference that matched
     * splats may have. */
    const float *look;
};

#define SPIN_NO_LINK UINT32_MAX

/* Sets next [from->n] to the match of each splat of `from` among the splats of `to`, or to
 * SPIN_NO_LINK. Splat i of `from` and its match are at most reach[i] apart and differ by at most 1
 * in each value of `look`; with reach[i] 0 it has no match. No splat of `to` is the match of two
 * splats. The cost of a pair is the sum of the squares of its distance, in units of reach[i], and
 * of its differences in `look`; pairs with lower cost take precedence. All values must be finite.
 * The result does not depend on the number of threads. */
spin_status spin_link(struct spin_pool *pool, const struct spin_link_side *from, const float *reach,
                      const struct spin_link_side *to, size_t width, uint32_t *next);
