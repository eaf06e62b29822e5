/* Turns: rotations of the surface around each splat of a dynamic track. A turn maps the offsets of
 * neighbouring splats from the track's reference frame to another frame (Horn 1987); it is found
 * from the positions of the source alone. Turns let all frames use the direction of a track's long
 * axis, and its splits, which each frame would otherwise have to learn anew. */
#pragma once

#include "base/pool.h"
#include "spin.h"

struct spin_turns {
    int n_frames;
    /* Splats of dynamic tracks in a frame: tracks [n], ascending; positions [n][3]; unit
     * quaternions [n][4]. */
    struct spin_turns_frame {
        size_t n;
        uint32_t *track;
        float *at, *turn;
    } * frame;
};

/* Zero it first; close it also after a failure. */
spin_status spin_turns_open(struct spin_turns *turns, int n_frames);
void spin_turns_close(struct spin_turns *turns);
/* Allocates n splats of a frame. The caller sets tracks and positions; turns are the identity. */
spin_status spin_turns_reserve(struct spin_turns *turns, int frame, size_t n);
/* Finds the turns in all frames. Tracks without enough neighbours keep the identity. n_tracks:
 * number of tracks of the clip. The result does not depend on the number of threads. */
spin_status spin_turns_find(struct spin_turns *turns, size_t n_tracks, struct spin_pool *pool);
