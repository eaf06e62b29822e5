/* TSOG, base version 4, as defined by Playback Profile 1.0.1 (OpsiClear-4DGS/ftgs-player): a zip
 * with a meta.json, the images of SOG, the additional images for 4D splats (sog_4d.h) unless the
 * file is static, and optionally a sound file. There are three kinds of files:
 *
 *   continuous   Splats have Gaussian windows and straight paths. Times, and the unit of time of
 *                velocities, are relative to the clip, which lasts from 0 to 1. Velocities are
 *                stored without a logarithm.
 *   discrete     A splat is visible in one frame only, whose number is stored.
 *   static       Splats do not change over time.
 *
 * This description follows the specification of the profile. A file does not specify its axes. */
#pragma once

#include "formats/sog_4d_sound.h"

enum spin_tsog_time { SPIN_TSOG_STATIC, SPIN_TSOG_DISCRETE, SPIN_TSOG_CONTINUOUS };

struct spin_tsog {
    enum spin_tsog_time time;
    int n_frames;
    double fps; /* frames per second; 0 if the file is static */
    /* Length of the clip in seconds; 0: the file is static and contains no duration. */
    double duration;
    struct spin_sog_4d_sound sound;
};

/* Reads a file from memory. Set *splats to zero before the call, and free it even after a failure.
 * The caller must call spin_splats_4d_finish() on the splats. In continuous files, times are 0 to
 * 1; in discrete files, times are frame numbers, and `cuts` restrict each splat to its frame. Error
 * messages do not contain the path. */
spin_status spin_tsog_read(const void *file, size_t size, struct spin_tsog *out,
                           struct spin_splats_4d *splats);
