/* Finds tracks: sets of splats in several frames that represent the same Gaussian. If the source
 * has persistent ids (row i is the same Gaussian in every frame), each row is a track. Otherwise,
 * splats at bit-identical positions in more than half of the frames form a track; the remaining
 * splats are matched from frame to frame (track_matching.h). */
#pragma once

#include "train/plan.h"
#include "train/train_frame.h"
#include "train/photos.h"

struct spin_tracks {
    size_t n; /* number of tracks */
    /* The first n_moving tracks are dynamic: their splats have their own position in each frame. */
    size_t n_moving;
    /* The splats of the first n_varying tracks have residual values in each frame. These tracks are
     * the dynamic tracks, followed by the static tracks whose appearance varies over time. 0 if
     * splats with a track have no residual values. */
    size_t n_varying;
    size_t n_backdrop; /* the last n_backdrop tracks are the backdrop (backdrop.h) */
    /* [n][3] position of each track: the mean over all frames if the track is static, otherwise the
     * position of its first splat. */
    float *place;
    /* [frames][splats, in the bundle's order] track of each splat, or SPIN_NO_TRACK; NULL for
     * frames that spin_frames_load() has loaded. */
    uint32_t **of;
    int n_frames;
    /* True if the source has persistent ids: row i belongs to track of[0][i] in every frame. */
    bool identity;
};

/* Finds tracks in the means of the bundle, and varying tracks in the training images. For trainings
 * without residual values per frame, `photos` may be NULL: n_varying is then 0. Zero *tracks before
 * the call, and close it also after a failure. */
spin_status spin_tracks_find(struct spin_tracks *tracks, struct spin_plan *plan,
                             struct spin_photos *photos);
/* Returns an upper bound of the number of pixels that spin_tracks_find() decodes. */
double spin_tracks_pixels(const struct spin_plan *plan);
void spin_tracks_close(struct spin_tracks *tracks);

/* Returns the sizes (train_frame.h) of a frame with n splats. */
struct spin_frame_size spin_tracks_size(const struct spin_tracks *tracks, int frame, size_t n);
/* Sorts permutation [n] of a frame, which lists its splats along a space-filling curve: splats
 * without a track come first, still along the curve; splats with a track follow, sorted by track.
 */
spin_status spin_tracks_sort(const struct spin_tracks *tracks, int frame, size_t n,
                             uint32_t *permutation);

/* ---- Tracks whose appearance varies ---------------------------------------------------------- */

/* Finds points whose appearance varies over time, for example because of moving shadows or
 * reflections. */

/* Sets varies [n] to 1 for each point of place [n][3] (world units) whose brightness varies over
 * the clip, and to 0 for all other points. In an image, a point deviates if its brightness differs
 * from the median over the clip in the same camera. A point varies if, in any frame, it deviates in
 * at least two training cameras and in more than half of the training cameras whose images contain
 * it. Objects that pass in front of a point are thus ignored, since they occlude it in few cameras
 * at a time. At most 32 frames of the clip are examined. */
spin_status spin_appearance_varies(const struct spin_plan *plan, struct spin_photos *photos,
                                   size_t n, const float *place, uint8_t *varies);
