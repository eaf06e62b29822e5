/* Data sets of a few cameras whose frames are folders of numbered pictures, or films. */
#pragma once

#include "importers/lib/file_sequence.h"
#include "importers/lib/views_check.h"

struct spin_rig_camera {
    const char *name;           /* cameras come in the order of their names as text */
    const char *where;          /* folder of pictures, or film */
    const char *masks;          /* folder of masks called as the pictures are; NULL: none */
    struct spin_camera camera;  /* of the frames' size */
    struct spin_camera *moving; /* one for each frame; NULL: it stands still */
    struct spin_file_sequence frames;
};

/* By name; two of one name are refused. `path` is for messages. */
spin_status spin_rig_sort(const char *path, struct spin_rig_camera *c, size_t n);

/* The frames of a camera: the pictures of a folder by number, or what a film has. Errors of a film
 * name the pictures `instead` that may be there in its place. */
spin_status spin_rig_pictures(struct spin_model *m, struct spin_rig_camera *c, const char *folder);
spin_status spin_rig_film(struct spin_model *m, struct spin_rig_camera *c, const char *file,
                          const char *instead);

/* Adds the views of all cameras, which have the same frame numbers, up to the fewest that one has.
 * A camera gets the size of its first picture, one that moves that of each. camera_id is the place.
 * Options: `time`, and `hold`, each how many-th is held out, 8 unless it is said; 0: none. */
spin_status spin_rig_views(struct spin_model *m, struct spin_rig_camera *c, size_t n,
                           struct spin_views *out);

/* Notes how times and frames a second stand: fps is a number, or a text such as "30000/1001"; NULL:
 * not known. */
void spin_rig_note(struct spin_model *m, const spin_json *fps, struct spin_views *out);

#define SPIN_RIG_OPTIONS                                                                           \
    {"time", "RULE",                                                                               \
     "time of frame i of n: unit for i/(n-1), count for i/n, row for i, a number N for i/N",       \
     "unit"},                                                                                      \
    {                                                                                              \
        "hold", "N", "hold out each N-th camera, the first included; 0: none", "8"                 \
    }
