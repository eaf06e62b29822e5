/* The sound track of an export: the file of --sound or, without this option, the sound of the
 * bundle. */
#pragma once

#include "scene/clip.h"
#include "spin_run.h"

struct spin_export_sound {
    /* The track. sound.start is relative to the first exported frame; sound.data is NULL if the
     * output has no sound. */
    struct spin_sound sound;
    double fps; /* frames per second of the exported frames; 0: there is no sound */
    struct spin_map file;
    unsigned char *owned; /* memory of sound.data if spin_sound_align() made it, else NULL */
};

/* Checks that the file of --sound exists and has a known format. To be called before the training,
 * to fail early. */
spin_status spin_export_sound_check(const char *sound);
/* Opens the sound. If the output cannot contain it, warns and leaves out->sound.data NULL. `fps` is
 * the rate of the exported frames, 0 if it is unknown; `stride` is the mean difference between the
 * numbers of consecutive exported frames. */
spin_status spin_export_sound_open(const struct spin_export_options *o,
                                   const struct spin_exporter *exporter,
                                   const struct spin_clip *clip, double fps, double stride,
                                   struct spin_export_sound *out);
void spin_export_sound_close(struct spin_export_sound *sound);
