/* Which splats of a clip's frames are one and the same Gaussian (a track). Either the source says that its rows
 * keep their identity, or rows are found that stand at the same place, to the bit, in two frames or more. */
#ifndef SPIN_TRAIN_TRACKS_H
#define SPIN_TRAIN_TRACKS_H

#include "train/plan.h"
#include "train/train_frame.h"

struct spin_tracks {
    size_t n;        /* tracks; 0: none were looked for, or found */
    size_t n_static; /* the first of them never move */
    uint32_t **of;   /* [frames][splats, in the bundle's order] a splat's track, or SPIN_NO_TRACK */
    int n_frames;
    bool identity; /* row i is track of[0][i] in every frame */
};

/* One pass over the means of the bundle. Zero it first; close it also after a failure. */
spin_status spin_tracks_find(struct spin_tracks *tracks, struct spin_plan *plan);
void spin_tracks_close(struct spin_tracks *tracks);

/* How many of a frame's n splats need a position, and residual values, of their own: those without a track, and
 * positions also where the track moves. own_residual: splats whose track moves have residual values as well. */
struct spin_frame_size spin_tracks_size(const struct spin_tracks *tracks, int frame, size_t n,
                                        bool own_residual);
/* A frame's order [n] from that of a space-filling curve: splats without a track first, in this order, then those
 * whose tracks move, then the others, both in the order of their tracks. */
spin_status spin_tracks_sort(const struct spin_tracks *tracks, int frame, size_t n,
                             uint32_t *permutation);

#endif
