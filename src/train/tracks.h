/* Finds tracks: splats of several frames that are one and the same Gaussian. If the source has
 * persistent ids (row i is the same Gaussian in every frame), each row is a track. Otherwise splats
 * at bit-identical positions form a track if they occur in more than half of the frames; the other
 * splats are matched from frame to frame (track_matching.h). */
#pragma once

#include "train/plan.h"
#include "train/train_frame.h"
#include "train/photos.h"

struct spin_tracks {
    size_t n; /* number of tracks */
    /* The first n_moving tracks are dynamic: their splats have a position in every frame. */
    size_t n_moving;
    /* The splats of the first n_varying tracks have residual values in every frame. These tracks
     * are the dynamic ones, and after them the static ones whose appearance varies over time. 0 if
     * no splat of a track has residual values. */
    size_t n_varying;
    size_t n_backdrop; /* the last n_backdrop tracks are the backdrop (backdrop.h) */
    /* [n][3] position of each track: the mean over all frames if the track is static, otherwise
     * that of its first splat. */
    float *place;
    /* [frames][splats, in the bundle's order] the track of each splat, or SPIN_NO_TRACK. */
    uint32_t **of;
    int n_frames;
    /* True if the source has persistent ids: row i belongs to track of[0][i] in every frame. */
    bool identity;
};

/* Reads the means of the bundle to find tracks and then, to find varying tracks, training images.
 * With `photos` NULL no images are read and no track varies, for trainings without residual values
 * per frame. Zero *tracks first; close it also after a failure. */
spin_status spin_tracks_find(struct spin_tracks *tracks, struct spin_plan *plan,
                             struct spin_photos *photos);
/* Returns the number of pixels that spin_tracks_find() decodes, at most. */
double spin_tracks_pixels(const struct spin_plan *plan);
void spin_tracks_close(struct spin_tracks *tracks);

/* Returns the sizes (train_frame.h) of a frame with n splats. */
struct spin_frame_size spin_tracks_size(const struct spin_tracks *tracks, int frame, size_t n);
/* Sorts a frame's permutation [n], which lists its splats along a space-filling curve: splats
 * without a track come first and keep the order of the curve; then the others follow, sorted by
 * track. */
spin_status spin_tracks_sort(const struct spin_tracks *tracks, int frame, size_t n,
                             uint32_t *permutation);

/* ---- Tracks whose appearance varies ---------------------------------------------------------- */

/* Finds the places of a scene whose appearance varies over time, because of moving shadows or
 * reflections. */

/* Sets varies [n] to 1 for each point of place [n][3] (world units) whose brightness varies over
 * the clip, and to 0 for the others. The brightness varies if there is a frame in which at least
 * two training cameras, and more than half of those whose image contains the point, measure a
 * brightness that differs from the camera's own median over time. An object that passes in front of
 * a point does not count, since at any time it covers the point in the images of few cameras only.
 * At most 32 frames of the clip are examined. */
spin_status spin_appearance_varies(const struct spin_plan *plan, struct spin_photos *photos,
                                   size_t n, const float *place, uint8_t *varies);
