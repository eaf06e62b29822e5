/* Start times of the cameras of a rig, relative to the start of the clip. */
#pragma once

#include "importers/lib/model.h"

struct spin_offset {
    const char *camera;
    double value;    /* delay from the start of the clip to the start of the camera */
    bool in_seconds; /* `value` is in seconds; otherwise in frames */
    bool used;
};

struct spin_offsets {
    struct spin_offset *list; /* [n] */
    size_t n;
};

/* Reads option `offsets`: a list such as "cam01=5;cam02=-0.2s", or the name of a file in the folder
 * of the data set, m->path. Without the option, reads offsets.txt if the data set contains it. Each
 * line of a file is a camera and its offset, such as "cam01 5". */
spin_status spin_offsets_read(struct spin_model *m, struct spin_offsets *out);

/* Returns the offset of a camera, or NULL if none is given. `camera` is the name of the camera's
 * folder or file. An entry of the list applies to the camera if its name equals `camera`, ignoring
 * the extension, or contains the same number. */
const struct spin_offset *spin_offsets_of(struct spin_offsets *offsets, const char *camera);

/* To be called after spin_offsets_of() for all cameras. Fails if an offset was not used, since the
 * list then names a camera that does not exist. */
spin_status spin_offsets_check(const struct spin_offsets *offsets);

#define SPIN_OFFSETS_OPTION                                                                        \
    {                                                                                              \
        "offsets", "LIST|FILE",                                                                    \
            "start delays of cameras in frames or seconds, such as 'cam01=5;cam02=0.2s', or a "    \
            "file with a camera and its delay per line",                                           \
            "offsets.txt"                                                                          \
    }
