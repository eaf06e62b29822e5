/* Texts that identify the inputs and options of a piece of work. Earlier work is reused only if
 * these texts are equal. */
#pragma once

#include "train/photos.h"

enum { SPIN_FRAME_KEY = 40 }; /* bytes of a key with its terminating null */

struct spin_refined {
    char key[SPIN_FRAME_KEY]; /* inputs and options */
    bool from_input;          /* the input contains the frame; else the frame cache does */
};

/* Key of a single refined frame: options, images, lenses, and the attributes it starts from. */
spin_status spin_frame_key(struct spin_plan *plan, const struct spin_photos *photos, int frame,
                           char key[SPIN_FRAME_KEY]);
/* Fingerprint of a run: options, frames, the keys of refined frames [frames] or NULL, images, and
 * the names, sizes and CRCs of the input's arrays in their order. The caller frees it. */
spin_status spin_fingerprint(const struct spin_plan *plan, const struct spin_refined *refined,
                             const struct spin_photos *photos, const struct spin_device *device,
                             char **out);
