/* The tracks of a bundle's network: Gaussians that several frames share.
 *
 *   trained/tracks.npy            [n][14] displacement 3, log scale 3, rotation 4, colour 3, logit of opacity 1
 *   trained/track/<index>.npy     [splats] uint32: the track of each, 0xffffffff: none; with "same_rows" of
 *                                 index 0 only, for all frames
 *   trained/means/<index>.npy     [own][3]  positions of splats without a track, or of a moving one
 *   trained/residual/<index>.npy  [own][11] of splats without a track, or of a varying one
 *
 * A splat has the sum of what it has of its own and of what its track has. The first "moving"
 * tracks move; of the others the displacement is the whole position. The first "varying" ones have
 * values in every frame. */
#pragma once

#include "scene/bundle.h"

enum { SPIN_TRACK_WIDTH = 14 };
#define SPIN_NOT_TRACKED UINT32_MAX

struct spin_bundle_tracks {
    struct spin_bundle *bundle;
    size_t n, n_moving, n_varying;
    size_t n_backdrop; /* the last ones close the scene from behind */
    bool same_rows;
    float *values; /* [n][SPIN_TRACK_WIDTH]; NULL: the bundle has none */
    /* Scratch of the frame read last. */
    void *block;
    size_t capacity;
};

/* Checks the values. Zero it first; close it also after a failure. */
spin_status spin_bundle_tracks_open(struct spin_bundle *bundle, struct spin_bundle_tracks *out);
void spin_bundle_tracks_close(struct spin_bundle_tracks *tracks);
/* Of frame `index` with n splats: the track of each, or SPIN_NOT_TRACKED, which all have where
 * there are no tracks. */
spin_status spin_bundle_tracks_numbers(struct spin_bundle_tracks *tracks, int index, size_t n,
                                       uint32_t *track);
/* Of frame `index` with n splats: means [n][3] and the residual rows [n][11] = the sums. */
spin_status spin_bundle_tracks_frame(struct spin_bundle_tracks *tracks, int index, size_t n,
                                     float *means, float *rows);
