/* The sound track of an export: the one that the user names, or else that of the bundle. */
#pragma once

#include "scene/clip.h"
#include "spin_run.h"

struct spin_export_sound {
    /* The track, which starts relative to the first exported frame; without data if the output has
     * no sound. */
    struct spin_sound sound;
    double fps; /* frames per second of the exported frames; 0: there is no sound */
    struct spin_map file;
    unsigned char *owned; /* samples that were cut, or NULL */
};

/* Checks that the file of --sound exists and has a known format, before hours of work. */
spin_status spin_export_sound_check(const char *sound);
/* Opens the sound and warns, in one line each, of all that the output loses. `fps` is the rate of
 * the exported frames, 0 if it is unknown; `stride` is the mean difference of their numbers. */
spin_status spin_export_sound_open(const struct spin_export_options *o,
                                   const struct spin_exporter *exporter,
                                   const struct spin_clip *clip, double fps, double stride,
                                   struct spin_export_sound *out);
void spin_export_sound_close(struct spin_export_sound *sound);
