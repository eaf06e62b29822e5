/* TSOG, base version 4, by its Playback Profile 1.0.1 (OpsiClear-4DGS/ftgs-player): a zip of a
 * meta.json, the images of SOG and, for two of three kinds of time, those of time (sog_4d.h). It
 * may contain one sound file.
 *
 *   continuous   Gaussian windows at times of a clip from 0 to 1, on straight paths; velocities are
 *                per clip, stored without a logarithm
 *   discrete     every splat has the number of the only frame that shows it
 *   static       no time
 *
 * The description is based on the profile's specification. A file does not specify its axes. */
#pragma once

#include "formats/sog_4d.h"

enum spin_tsog_time { SPIN_TSOG_STATIC, SPIN_TSOG_DISCRETE, SPIN_TSOG_CONTINUOUS };

struct spin_tsog {
    enum spin_tsog_time time;
    int n_frames;
    double fps;      /* 0: static, and not given */
    double duration; /* seconds; 0: static, and not given */
    bool sound;
};

/* Reads a file into *out and *splats, which must be zero before, and be freed even after a failure;
 * the splats are not settled. Times are 0 to 1; for discrete files they are frame numbers, with
 * cuts around each frame. Errors do not name the file. */
spin_status spin_tsog_read(const void *file, size_t size, struct spin_tsog *out,
                           struct spin_splats_4d *splats);
