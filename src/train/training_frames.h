/* Loads the splats of all frames before the training: reads each frame once, checks its values,
 * sorts its splats for memory locality and uploads them. */
#pragma once

#include "train/refinement.h"
#include "train/tracks.h"

struct spin_frames {
    int n;
    /* [n][splats] for each frame: row in the bundle of each splat of the trainer; released with
     * spin_pages_release(). */
    uint32_t **permutation;
};

/* Checks that the means of the source are finite, and sets report->outside_ball. */
spin_status spin_frames_check_points(struct spin_plan *plan);
/* Loads all frames: refined frames if frames were refined, otherwise those of the source. Sets the
 * permutations and the trainer's scene transform. If first_values is true, also sets the initial
 * values of the trainer's frames and tracks. On a resume it is false: the checkpoint then contains
 * these values and, with tracks, the permutations. Frees tracks->of[] of each frame. Zero *frames
 * before the call, and close it also after a failure. */
spin_status spin_frames_load(struct spin_frames *frames, struct spin_plan *plan,
                             struct spin_refinement *refinement, struct spin_tracks *tracks,
                             struct spin_trainer *trainer, bool first_values);
/* Allocates the permutation of frame f, of n splats, where the trainer keeps the frame. */
spin_status spin_frames_reserve(struct spin_frames *frames, const struct spin_trainer *trainer,
                                int f, size_t n);
void spin_frames_close(struct spin_frames *frames);
