/* The sound in a TSOG (tsog.h) or a .sogst (sogst.h) is a member of the zip that the object "audio"
 * of meta.json describes: file, mimeType, volume. The object "spin4d" in it, which spin4d adds,
 * contains the name of the sound and, unless it is 0, the time in seconds at which the sound
 * starts. .sogst itself has no sound: spin4d stores "audio" in "asset", whose members readers may
 * define, and readers of .sogst ignore unknown members of the zip. */
#pragma once

#include "formats/sog_4d.h"
#include "io/sound.h"

#define SPIN_SOG_4D_OWN "spin4d"

struct spin_sog_4d_sound {
    /* Without data if there is none. The data point into the file in memory or, if the zip member
     * was compressed, to `owned`, which the caller frees. */
    struct spin_sound sound;
    void *owned;
    char note[160]; /* the reason why the sound was not imported; "" if there is none */
};

/* Reads the sound that `audio` describes; NULL: there is none. */
spin_status spin_sog_4d_sound(const struct spin_sog_4d *r, const spin_json *audio,
                              struct spin_sog_4d_sound *out);
