/* Tracks: splats of a clip's frames that are one and the same Gaussian. If the rows of the source
 * keep their identity, each row is a track. Otherwise splats at a bit-identical position in more
 * than half of the frames form a track, and other splats are matched from frame to frame
 * (chains.h). */
#pragma once

#include "train/plan.h"
#include "train/train_frame.h"
#include "train/photos.h"

struct spin_tracks {
    size_t n;        /* number of tracks */
    size_t n_moving; /* the first n_moving are dynamic: a position in every frame */
    /* The first n_varying have residual values in every frame: the dynamic ones, and static ones
     * whose appearance varies over time. 0 without residual values per frame. */
    size_t n_varying;
    size_t n_backdrop; /* the last n_backdrop are the backdrop (backdrop.h) */
    float *place;      /* [n][3] position; of a static track, the mean over the frames */
    uint32_t **of; /* [frames][splats, in the bundle's order] a splat's track, or SPIN_NO_TRACK */
    int n_frames;
    bool identity; /* rows keep their identity: row i is track of[0][i] in every frame */
};

/* Makes one pass over the means of the bundle and one over images, to find varying tracks. With
 * `photos` NULL only the former, for trainings without residual values per frame. Zero it first;
 * close it also after a failure. */
spin_status spin_tracks_find(struct spin_tracks *tracks, struct spin_plan *plan,
                             struct spin_photos *photos);
void spin_tracks_close(struct spin_tracks *tracks);

/* Sizes of a frame with n splats (train_frame.h). */
struct spin_frame_size spin_tracks_size(const struct spin_tracks *tracks, int frame, size_t n);
/* Sorts a permutation [n] that follows a space-filling curve: first splats without a track, in the
 * order of the curve, then the others by track. */
spin_status spin_tracks_sort(const struct spin_tracks *tracks, int frame, size_t n,
                             uint32_t *permutation);
