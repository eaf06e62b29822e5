/* Loads the splats before training: reads every frame once, checks it, sorts it for memory locality
 * and uploads it. */
#pragma once

#include "train/refinement.h"
#include "train/tracks.h"

struct spin_frames {
    int n;
    uint32_t **permutation; /* [n][splats] row of the bundle for each splat of the trainer */
    double init_log_scale;  /* initial log scale of splats */
};

/* Checks that the means of the source are finite, and reports the share of them outside the unit
 * ball. */
spin_status spin_frames_look(struct spin_plan *plan);
/* Loads all frames, refined ones if available: sets the permutations, the trainer's scene transform
 * and, with first_values (false after a resume), the initial values of its frames and tracks. After
 * a resume with tracks the checkpoint provides the permutations. Zero it first; close it also after
 * a failure. */
spin_status spin_frames_load(struct spin_frames *frames, struct spin_plan *plan,
                             struct spin_refinement *refinement, const struct spin_tracks *tracks,
                             struct spin_trainer *trainer, bool first_values);
void spin_frames_close(struct spin_frames *frames);
