/* TSOG, base version 4, as defined by Playback Profile 1.0.1 (OpsiClear-4DGS/ftgs-player): a zip
 * with a meta.json, the images of SOG, images of time (sog_4d.h) unless the file is static, and
 * optionally a sound file. There are three kinds of files:
 *
 *   continuous   Splats have Gaussian windows and straight paths. The time of a clip runs from 0 to
 *                1, also for velocities, which are stored without a logarithm.
 *   discrete     A splat is visible in one frame only, whose number is stored.
 *   static       Splats do not change over time.
 *
 * This description follows the specification of the profile. A file does not specify its axes. */
#pragma once

#include "formats/sog_4d.h"

enum spin_tsog_time { SPIN_TSOG_STATIC, SPIN_TSOG_DISCRETE, SPIN_TSOG_CONTINUOUS };

struct spin_tsog {
    enum spin_tsog_time time;
    int n_frames;
    double fps; /* frames per second; 0 if the file is static */
    /* Length of the clip in seconds; 0 if the file is static and does not state it. */
    double duration;
    /* The sound, whose data are in the memory of the file or, if it was packed, in sound_owned,
     * which the caller frees. */
    struct spin_sound sound;
    void *sound_owned;
    char sound_note[160]; /* why there is no sound although the file has one; or "" */
};

/* The member of "audio" that spin4d adds: an object with the name of the sound, and the time at
 * which it starts, in seconds, unless that is 0. */
#define SPIN_TSOG_OWN "spin4d"

/* Reads a file that is in memory. Zero *splats before the call, and free it even after a failure.
 * The caller must call spin_splats_4d_finish() on the splats. Times are 0 to 1 in continuous files;
 * in discrete files they are frame numbers, and cuts restrict each splat to its frame. Error
 * messages do not contain the path. */
spin_status spin_tsog_read(const void *file, size_t size, struct spin_tsog *out,
                           struct spin_splats_4d *splats);
