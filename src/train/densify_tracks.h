/* Densification of a clip with tracks: clones, splits and prunes tracks, and splats without one, by
 * the statistics gathered since the last time. A new track has a splat in every frame in which its
 * parent has one. */
#pragma once

#include "train/densify.h"
#include "train/step.h"

/* Consumes the statistics of all frames. permutation [frames][splats]: the row of each splat in the
 * output; the array of each frame is replaced, with new splats in the last rows. NULL: not needed.
 * counts [frames]: set to the new numbers of splats. iteration and o->seed select the random
 * numbers. o->max_points limits the splats of a frame; tracks take precedence over splats without
 * one. */
spin_status spin_densify_tracks(struct spin_trainer *t, const struct spin_densify_options *o,
                                int iteration, uint32_t **permutation, size_t *counts,
                                struct spin_densify_change *change);
