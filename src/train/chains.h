/* Splats that go on from frame to frame though the source does not say so: each is linked to the
 * splat of the next frame that is most like it, and what is linked becomes a track. */
#pragma once

#include "train/plan.h"

struct spin_chains {
    size_t n, capacity;
    float *place; /* [n][3] of the first splat */
};

/* of [frames][splats, in the bundle's order]: SPIN_NO_TRACK where a splat may become part of a
 * chain; where it does, the chain's number + first. One pass over the means and colours of the
 * bundle. Zero chains first; close them also after a failure. */
spin_status spin_chains_find(struct spin_chains *chains, struct spin_plan *plan, uint32_t **of,
                             uint32_t first);
void spin_chains_close(struct spin_chains *chains);
