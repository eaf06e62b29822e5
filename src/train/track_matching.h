/* Builds tracks for sources without persistent splat ids: each splat is matched with the most
 * similar splat of the next frame, and matched splats form a track. */
#pragma once

#include "train/plan.h"
#include "base/pool.h"
#include "spin.h"

/* ---- Stable matching of two frames ----------------------------------------------------------- */

/* Matches splats of one frame with the most similar splats of the next. */

/* Splats of a frame, to be matched. */
struct spin_link_side {
    size_t n;
    const float *at; /* [n][3] positions */
    /* [n][width] other values, such as colours, in units of the largest difference that matched
     * splats may have. */
    const float *appearance;
};

#define SPIN_NO_LINK UINT32_MAX

/* Sets next [from->n] to the match of each splat of `from` among the splats of `to`, or to
 * SPIN_NO_LINK. Splat i of `from` and its match are at most reach[i] apart and differ by at most 1
 * in each value of `appearance`; with reach[i] 0 it has no match. No splat of `to` is the match of
 * two splats. The cost of a pair is the sum of the squares of its distance, in units of reach[i],
 * and of its differences in `appearance`; pairs with lower cost take precedence. All values must be
 * finite. The result does not depend on the number of threads. */
spin_status spin_link(struct spin_pool *pool, const struct spin_link_side *from, const float *reach,
                      const struct spin_link_side *to, size_t width, uint32_t *next);

/* ---- Matching -------------------------------------------------------------------------------- */

struct spin_track_matching {
    size_t n, capacity;
    float *place; /* [n][3] position of the first splat of each track */
};

/* of [frames][splats, in the bundle's order] is the track of each splat. Only splats whose entry is
 * SPIN_NO_TRACK are matched. The entry of each matched splat becomes `first` plus the index of its
 * track in `chains`. Reads the means and colours of the bundle once. Zero it first; close it also
 * after a failure. */
spin_status spin_track_matching_find(struct spin_track_matching *chains, struct spin_plan *plan,
                                     uint32_t **of, uint32_t first);
void spin_track_matching_close(struct spin_track_matching *chains);

/* ---- Rotation of tracks ---------------------------------------------------------------------- */

/* Turns: rotations of the surface around the splats of dynamic tracks. The turn of a splat is the
 * rotation that best maps the offsets from the splat to its neighbours in the track's reference
 * frame to their offsets in the splat's own frame (Horn 1987); it follows from the positions of the
 * source alone. With turns, the direction of a track's long axis, and the halves into which the
 * track is split, are learned once for all frames; without them each frame would have to learn them
 * anew. */

struct spin_turns {
    int n_frames;
    /* The splats of dynamic tracks in each frame: their tracks [n], ascending; positions `at`
     * [n][3]; turns [n][4], which are unit quaternions. */
    struct spin_turns_frame {
        size_t n;
        uint32_t *track;
        float *at, *turn;
    } * frame;
};

/* Zero it first; close it also after a failure. */
spin_status spin_turns_open(struct spin_turns *turns, int n_frames);
void spin_turns_close(struct spin_turns *turns);
/* Allocates n splats of a frame and sets their turns to the identity. The caller sets their tracks
 * and positions. */
spin_status spin_turns_reserve(struct spin_turns *turns, int frame, size_t n);
/* Computes the turns in all frames. A turn that the neighbours do not determine is that of the
 * preceding frame or, next to the reference frame, the identity. n_tracks: number of tracks of the
 * clip. The result does not depend on the number of threads. */
spin_status spin_turns_find(struct spin_turns *turns, size_t n_tracks, struct spin_pool *pool);
