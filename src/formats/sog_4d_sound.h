/* The sound in a TSOG (tsog.h) or a .sogst (sogst.h) is a file in the zip. The object "audio" of
 * meta.json describes it with the keys file, mimeType and volume. spin4d adds an object "spin4d" to
 * "audio", with the name of the sound and, if that is not 0, the time in seconds at which the sound
 * starts. The format .sogst itself has no sound: spin4d stores "audio" in the object "asset", where
 * programs may add keys of their own, and readers of .sogst ignore unknown files in the zip. */
#pragma once

#include "formats/sog_4d.h"
#include "io/sound.h"

#define SPIN_SOG_4D_OWN "spin4d"

struct spin_sog_4d_sound {
    /* The sound; its data are NULL if there is none. They point into the file in memory or, if the
     * zip member was compressed, to `owned`, which the caller frees. */
    struct spin_sound sound;
    void *owned;
    char note[160]; /* the reason why the sound was not imported; "" if there is none */
};

/* Reads the sound that `audio` describes; NULL: there is none. */
spin_status spin_sog_4d_sound(const struct spin_sog_4d *r, const spin_json *audio,
                              struct spin_sog_4d_sound *out);
