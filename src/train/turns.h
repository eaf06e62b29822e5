/* How the surface around each splat of a moving track turns: found from the source's places alone,
 * as the rotation that takes the offsets of its neighbours from the track's own frame to each other
 * one (Horn 1987). With it, what a track learns in one frame holds in all: which way it is long,
 * and where it is split. Without it, each frame has to learn both anew. */
#pragma once

#include "base/pool.h"
#include "spin.h"

struct spin_turns {
    int n_frames;
    /* The splats of moving tracks of a frame: the tracks ascending, places [n][3], unit quaternions
     * [n][4]. */
    struct spin_turns_frame {
        size_t n;
        uint32_t *track;
        float *at, *turn;
    } * frame;
};

/* Zero it first; close it also after a failure. */
spin_status spin_turns_open(struct spin_turns *turns, int n_frames);
void spin_turns_close(struct spin_turns *turns);
/* Room for n splats in a frame, whose tracks and places the caller fills in. */
spin_status spin_turns_reserve(struct spin_turns *turns, int frame, size_t n);
/* The turns of all frames; those of tracks without enough neighbours are the identity. n_tracks: of
 * all numbers. The same for any number of threads. */
spin_status spin_turns_find(struct spin_turns *turns, size_t n_tracks, struct spin_pool *pool);
