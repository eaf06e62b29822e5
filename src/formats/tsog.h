/* TSOG, base version 4, by its Playback Profile 1.0.1 (OpsiClear-4DGS/ftgs-player): a zip of a
 * meta.json, the pictures of SOG and, in one of two kinds of time, those of it (sog_4d.h). One
 * sound file may be there.
 *
 *   continuous   bells at times of a clip that lasts from 0 to 1, on straight paths; velocities are linear, per clip
 *   discrete     every splat has the number of the one frame that shows it
 *   static       no time
 *
 * Facts from the profile's specification. Nothing says which axes a file has. */
#pragma once

#include "formats/sog_4d.h"

enum spin_tsog_time { SPIN_TSOG_STATIC, SPIN_TSOG_DISCRETE, SPIN_TSOG_CONTINUOUS };

struct spin_tsog {
    enum spin_tsog_time time;
    int n_frames;
    double fps;      /* 0: static, and it does not say */
    double duration; /* seconds; 0: the same */
    bool sound;
};

/* Also fills *splats, which is zero and to be freed also after a failure, not settled: times from 0
 * to 1; those of discrete ones are frame numbers, with a cut for each. Errors do not name the file.
 */
spin_status spin_tsog_read(const void *file, size_t size, struct spin_tsog *out,
                           struct spin_splats_4d *splats);
