/* Densification of a clip with tracks: tracks, and splats without one, are cloned, split and pruned
 * by what their views showed since the last time. A new track has a splat in every frame in which
 * its parent has one. */
#pragma once

#include "train/densify.h"
#include "train/step.h"

/* Statistics of all frames are used up. permutation [frames][splats]: places in the output, which
 * new splats come last in; a frame's array is replaced. counts [frames] =. iteration and o->seed
 * name the random numbers; o->max_points is the most of a frame, tracks before other splats. */
spin_status spin_densify_tracks(struct spin_trainer *t, const struct spin_densify_options *o,
                                int iteration, uint32_t **permutation, size_t *counts,
                                struct spin_densify_change *change);
