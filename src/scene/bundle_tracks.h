/* The tracks of a bundle: Gaussians that several frames share.
 *
 *   trained/tracks.npy            [n][14] displacement 3, log scale 3, rotation 4, colour 3,
 *                                 logit opacity 1
 *   trained/track/<index>.npy     [splats] uint32: the track of each splat, 0xffffffff: none; with
 *                                 "same_rows" only index 0 exists, which is valid for all frames
 *   trained/means/<index>.npy     [own][3]  positions: splats without a track or of a dynamic one
 *   trained/residual/<index>.npy  [own][11] values: splats without a track or of a varying one
 *
 * The attributes of a splat are the sum of its own values and those of its track. The first
 * "moving" tracks are dynamic; the displacement of a static track is its whole position. The first
 * "varying" tracks have their own values in every frame. */
#pragma once

#include "scene/bundle.h"

enum { SPIN_TRACK_WIDTH = 14 };
#define SPIN_NOT_TRACKED UINT32_MAX

struct spin_bundle_tracks {
    struct spin_bundle *bundle;
    size_t n, n_moving, n_varying;
    size_t n_backdrop; /* the last n_backdrop tracks close the scene from behind */
    bool same_rows;
    float *values; /* [n][SPIN_TRACK_WIDTH]; NULL: the bundle has no tracks */
    /* Scratch memory for one frame. */
    void *block;
    size_t capacity;
};

/* Checks that all values are finite. Zero *out before the call, and close it even after a
 * failure. */
spin_status spin_bundle_tracks_open(struct spin_bundle *bundle, struct spin_bundle_tracks *out);
void spin_bundle_tracks_close(struct spin_bundle_tracks *tracks);
/* The track of each of the n splats of frame `index`, or SPIN_NOT_TRACKED: for all splats if the
 * bundle has no tracks. */
spin_status spin_bundle_tracks_numbers(struct spin_bundle_tracks *tracks, int index, size_t n,
                                       uint32_t *track);
/* The sums for the n splats of frame `index`: means [n][3] and residual rows [n][11]. */
spin_status spin_bundle_tracks_frame(struct spin_bundle_tracks *tracks, int index, size_t n,
                                     float *means, float *rows);
