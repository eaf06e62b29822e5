/* Densification of a clip with tracks: clones, splits and prunes tracks and splats without a track,
 * according to the statistics gathered since the previous densification. A new track has a splat in
 * every frame in which its parent has one. */
#pragma once

#include "train/densify.h"
#include "train/step.h"

/* Densifies the clip and clears the statistics of all frames. permutation [frames][splats] is the
 * row of each splat in the output; the function replaces the array of each frame and gives the last
 * rows to new splats. permutation NULL: the caller does not need the rows. Sets counts [frames] to
 * the new numbers of splats. iteration and o->seed select the random numbers. o->max_points limits
 * the number of splats of a frame; if the limit is reached, tracks take precedence over splats
 * without a track. */
spin_status spin_densify_tracks(struct spin_trainer *t, const struct spin_densify_options *o,
                                int iteration, uint32_t **permutation, size_t *counts,
                                struct spin_densify_change *change);
