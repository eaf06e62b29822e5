/* The tracks of a bundle: splats of several frames that share attributes.
 *
 *   trained/tracks.npy            [n][14] displacement 3, log scale 3, rotation 4, colour 3,
 *                                 logit opacity 1
 *   trained/track/<index>.npy     [splats] uint32, the track of each splat; 0xffffffff: no track.
 *                                 With "same_rows", only index 0 exists and applies to all frames.
 *   trained/means/<index>.npy     [rows][3] positions of splats with a dynamic track or without a
 *                                 track
 *   trained/residual/<index>.npy  [rows][11] values of splats with a varying track or without a
 *                                 track
 *
 * The attributes of a splat are the sum of its own values and those of its track. Tracks are
 * ordered by kind: the first n_moving tracks ("moving" in meta.json) are dynamic, and the first
 * n_varying tracks ("varying") are varying. The displacement of a static track is the position of
 * its splats. */
#pragma once

#include "scene/bundle.h"

enum { SPIN_TRACK_WIDTH = 14 };
#define SPIN_NOT_TRACKED UINT32_MAX

struct spin_bundle_tracks {
    struct spin_bundle *bundle;
    size_t n, n_moving, n_varying;
    size_t n_backdrop; /* the last n_backdrop tracks are the backdrop behind the scene */
    bool same_rows;    /* true: row i has the same track in every frame */
    float *values;     /* [n][SPIN_TRACK_WIDTH]; NULL: the bundle has no tracks */
    /* Scratch memory for one frame of `capacity` splats. */
    void *block;
    size_t capacity;
};

/* Reads the values of all tracks and checks that they are finite. The caller zeroes *out before the
 * call and closes it later, also if the call fails. The bundle must stay open until *out is
 * closed. */
spin_status spin_bundle_tracks_open(struct spin_bundle *bundle, struct spin_bundle_tracks *out);
void spin_bundle_tracks_close(struct spin_bundle_tracks *tracks);
/* Sets track[i] to the track of splat i of frame `index`, which has n splats, or to
 * SPIN_NOT_TRACKED if the splat has no track. In a bundle without tracks, no splat has one. */
spin_status spin_bundle_tracks_numbers(struct spin_bundle_tracks *tracks, int index, size_t n,
                                       uint32_t *track);
/* Computes the values of the n splats of frame `index`: means [n][3] and residual rows [n][11].
 * Each value is the sum of the splat's own value and that of its track. */
spin_status spin_bundle_tracks_frame(struct spin_bundle_tracks *tracks, int index, size_t n,
                                     float *means, float *rows);
