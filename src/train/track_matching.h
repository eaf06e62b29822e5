/* Builds tracks for sources without persistent splat ids: each splat is matched with the most
 * similar splat of the next frame, and a sequence of matched splats forms a track. */
#pragma once

#include "train/plan.h"
#include "base/pool.h"
#include "spin.h"

/* ---- Stable matching of two frames ----------------------------------------------------------- */

/* Matches splats of one frame with the most similar splats of the next frame. */

/* The splats of a frame that are to be matched. */
struct spin_link_side {
    size_t n;
    const float *at; /* [n][3] positions */
    /* [n][width] other values, such as colours. The unit of each value is the largest difference
     * that matched splats may have. */
    const float *appearance;
};

#define SPIN_NO_LINK UINT32_MAX

/* Computes a stable matching: sets next [from->n] to the match of each splat of `from` among the
 * splats of `to`, or to SPIN_NO_LINK. The distance of splat i of `from` to its match is at most
 * reach[i], a search radius, and each value of `appearance` differs by at most 1; if reach[i] is 0,
 * the splat has no match. A splat of `to` is the match of at most one splat. The cost of a pair is
 * the squared distance, in units of reach[i], plus the squared differences in `appearance`; pairs
 * with a lower cost take precedence. All values must be finite. The result does not depend on the
 * number of threads. */
spin_status spin_link(struct spin_pool *pool, const struct spin_link_side *from, const float *reach,
                      const struct spin_link_side *to, size_t width, uint32_t *next);

/* ---- Matching -------------------------------------------------------------------------------- */

struct spin_track_matching {
    size_t n, capacity;
    float *place; /* [n][3] position of the first splat of each track */
};

/* Matches the splats of a clip. of [frames][splats, in the bundle's order] is the track of each
 * splat; only splats with the entry SPIN_NO_TRACK are matched. The entry of a matched splat becomes
 * `first` plus the index of its track in `chains`. Reads the means and colours of the bundle once.
 * Zero the struct before the call, and close it also after a failure. */
spin_status spin_track_matching_find(struct spin_track_matching *chains, struct spin_plan *plan,
                                     uint32_t **of, uint32_t first);
void spin_track_matching_close(struct spin_track_matching *chains);

/* ---- Rotation of tracks ---------------------------------------------------------------------- */

/* Turns: rotations of the surface around the splats of dynamic tracks, relative to the reference
 * frame of the track (docs/method.md 8.3). The turn of a splat is the rotation that best maps the
 * offsets of its neighbours in the reference frame to their offsets in the splat's own frame (Horn
 * 1987); it is computed from the positions of the source only. Because turns are applied to the
 * values of a track, the direction of its long axis, and the positions of the halves of a split
 * track, are learned once for all frames instead of separately in each frame. */

struct spin_turns {
    int n_frames;
    /* Set by the caller: folder of temporary files for the frames; NULL: they are in memory. */
    const char *scratch;
    /* The splats of dynamic tracks in each frame: track [n], in ascending order; position `at`
     * [n][3]; turn [n][4], a unit quaternion. */
    struct spin_turns_frame {
        size_t n;
        uint32_t *track;
        float *at, *turn;
    } * frame;
};

/* Zero *turns before the call, and close it also after a failure. */
spin_status spin_turns_open(struct spin_turns *turns, int n_frames);
void spin_turns_close(struct spin_turns *turns);
/* Allocates n splats of a frame and sets their turns to the identity. The caller sets their tracks
 * and positions. */
spin_status spin_turns_reserve(struct spin_turns *turns, int frame, size_t n);
/* Computes the turns of all frames, in steps away from the reference frame. If the neighbours of a
 * splat do not determine a turn, it is copied from the previous step; at the reference frame, it is
 * the identity. n_tracks: number of tracks of the clip. The result does not depend on the number of
 * threads. */
spin_status spin_turns_find(struct spin_turns *turns, size_t n_tracks, struct spin_pool *pool);
