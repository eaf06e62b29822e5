/* Loads the splats of all frames before training: reads every frame once, checks its values, sorts
 * its splats for memory locality and uploads them. */
#pragma once

#include "train/refinement.h"
#include "train/tracks.h"

struct spin_frames {
    int n;
    /* [n][splats] for each frame: the row in the bundle of each of the trainer's splats. */
    uint32_t **permutation;
};

/* Checks that the means of the source are finite, and stores the share of the means outside the
 * encoder's unit ball in the report. */
spin_status spin_frames_check_points(struct spin_plan *plan);
/* Loads all frames: the refined ones if frames were refined, otherwise those of the source. Sets
 * the permutations and the trainer's scene transform. If first_values is true, also sets the
 * initial values of the trainer's frames and tracks; after a resume it is false, since the
 * checkpoint provides these values and, with tracks, the permutations. Zero *frames first; close it
 * also after a failure. */
spin_status spin_frames_load(struct spin_frames *frames, struct spin_plan *plan,
                             struct spin_refinement *refinement, const struct spin_tracks *tracks,
                             struct spin_trainer *trainer, bool first_values);
void spin_frames_close(struct spin_frames *frames);
