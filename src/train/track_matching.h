/* Builds tracks for sources without persistent splat ids: each splat is matched with the most
 * similar splat of the next frame, and matched splats form a track. */
#pragma once

#include "train/plan.h"

struct spin_track_matching {
    size_t n, capacity;
    float *place; /* [n][3] position of the first splat of each track */
};

/* of [frames][splats, in the bundle's order] is the track of each splat. Only splats whose entry is
 * SPIN_NO_TRACK are matched. The entry of each matched splat becomes `first` plus the index of its
 * track in `chains`. Reads the means and colours of the bundle once. Zero it first; close it also
 * after a failure. */
spin_status spin_track_matching_find(struct spin_track_matching *chains, struct spin_plan *plan,
                                     uint32_t **of, uint32_t first);
void spin_track_matching_close(struct spin_track_matching *chains);
