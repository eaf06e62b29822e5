/* Which splats of a clip's frames are one and the same Gaussian (a track). Either the source says
 * that its rows keep their identity; or rows are found that stand at the same place, to the bit, in
 * more than half of the frames, and the others are linked from frame to frame (chains.h). */
#pragma once

#include "train/plan.h"
#include "train/train_frame.h"
#include "train/photos.h"

struct spin_tracks {
    size_t n;        /* tracks; 0: none were looked for, or found */
    size_t n_moving; /* the first of them move: a position in every frame */
    size_t
        n_varying; /* the first of them have residual values in every frame: those that move, and
                      those that stand still and look different over time; or 0: none are wanted */
    size_t n_backdrop; /* the last of them are the backdrop (backdrop.h) */
    float *place;      /* [n][3] where those that stand still are: the mean over the frames */
    uint32_t **of; /* [frames][splats, in the bundle's order] a splat's track, or SPIN_NO_TRACK */
    int n_frames;
    bool identity; /* row i is track of[0][i] in every frame */
};

/* One pass over the means of the bundle, and with photos over images; NULL: no residual values of
 * every frame. Zero it first; close it also after a failure. */
spin_status spin_tracks_find(struct spin_tracks *tracks, struct spin_plan *plan,
                             struct spin_photos *photos);
void spin_tracks_close(struct spin_tracks *tracks);

/* How many of a frame's n splats have a position, and residual values, of their own. */
struct spin_frame_size spin_tracks_size(const struct spin_tracks *tracks, int frame, size_t n);
/* A frame's order [n] from that of a space-filling curve: splats without a track first, in this
 * order, then the others in the order of their tracks. */
spin_status spin_tracks_sort(const struct spin_tracks *tracks, int frame, size_t n,
                             uint32_t *permutation);
