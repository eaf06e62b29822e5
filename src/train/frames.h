/* The pass over the bundle before training: every frame's splats are read once, checked, put in an
 * order that is good for the memory, and sent to the device. */
#pragma once

#include "train/refinement.h"
#include "train/tracks.h"

struct spin_frames {
    int n;
    uint32_t **permutation; /* [n][splats] the bundle's row at each place of ours */
    double init_log_scale;  /* that splats begin with */
};

/* Means of the source are finite; the share of them outside the unit ball goes into the report. */
spin_status spin_frames_look(struct spin_plan *plan);
/* The whole pass, over the refined frames where there are some: also the permutations, the
 * trainer's scene transform, and with first_values (not after a resume) what the trainer's frames
 * and tracks begin with. After a resume with tracks the permutations come from the state. Zero it
 * first; close it also after a failure. */
spin_status spin_frames_load(struct spin_frames *frames, struct spin_plan *plan,
                             struct spin_refinement *refinement, const struct spin_tracks *tracks,
                             struct spin_trainer *trainer, bool first_values);
void spin_frames_close(struct spin_frames *frames);
