/* The pass over the bundle before training: every frame's splats are read once, checked, put in an order that
 * is good for the memory, and sent to the device. */
#pragma once

#include "train/cloud.h"
#include "train/refinement.h"
#include "train/tracks.h"

struct spin_frames {
    int n;
    uint32_t **permutation; /* [n][splats] the bundle's row at each place of ours */
    double init_log_scale;  /* that splats begin with */
};

/* Means of the source are finite; the share of them outside the unit ball goes into the report. */
spin_status spin_frames_look(struct spin_plan *plan);
/* The whole pass, over the refined frames where there are some: also the permutations, the trainer's scene
 * transform, and with first_values (not after a resume) what the trainer's frames and tracks begin with.
 * After a resume with tracks the permutations come from the state. Zero it first;
 * close it also after a failure. */
spin_status spin_frames_load(struct spin_frames *frames, struct spin_plan *plan,
                             struct spin_refinement *refinement, const struct spin_tracks *tracks,
                             struct spin_trainer *trainer, bool first_values);
/* Splats begin faint, in order to learn. Those that no training camera sees learn nothing, and would stay faint: holes for
 * who looks from elsewhere. They begin as the source has them, or, where it is points, nearly opaque. All others are
 * marked as seen. The cloud is what frame f begins with, made from these splats. */
spin_status spin_frames_show_unseen(const struct spin_plan *plan, const struct spin_splats *s,
                                    int f, struct spin_refine_cloud *cloud);
void spin_frames_close(struct spin_frames *frames);
