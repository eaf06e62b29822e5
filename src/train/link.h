/* Which splat of one frame may be a splat of the frame before: the one that is most like it. */
#pragma once

#include "base/pool.h"
#include "spin.h"

/* Splats of a frame. */
struct spin_link_side {
    size_t n;
    const float *at; /* [n][3] places */
    const float
        *look; /* [n][width] other values, in units of the most by which linked splats may differ */
};

#define SPIN_NO_LINK UINT32_MAX

/* next [from->n] = the splat of `to` that goes on with a splat of `from`, or SPIN_NO_LINK. Such a
 * pair is at most reach [from->n] apart and differs by at most 1 in each value; with reach 0 there
 * is none. Of all pairs that may be, the one of the smallest sum of squares is linked first; no
 * splat is in two. Finite values. The same for any number of threads. */
spin_status spin_link(struct spin_pool *pool, const struct spin_link_side *from, const float *reach,
                      const struct spin_link_side *to, size_t width, uint32_t *next);
