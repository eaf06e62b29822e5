/* Turns: rotations of the surface around the splats of dynamic tracks. The turn of a splat is the
 * rotation that best maps the offsets from the splat to its neighbours in the track's reference
 * frame to their offsets in the splat's own frame (Horn 1987); it follows from the positions of the
 * source alone. With turns, the direction of a track's long axis, and the halves into which the
 * track is split, are learned once for all frames; without them each frame would have to learn them
 * anew. */
#pragma once

#include "base/pool.h"
#include "spin.h"

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
