/* Data sets of a camera rig, with a folder of numbered images or a video for each camera. */
#pragma once

#include "importers/lib/file_sequence.h"
#include "importers/lib/views_check.h"

struct spin_rig_camera {
    const char *name;           /* cameras are sorted by name as text */
    const char *where;          /* folder of images, or video */
    const char *masks;          /* folder of masks named like the images; NULL: none */
    struct spin_camera camera;  /* of the frames' size */
    struct spin_camera *moving; /* one for each frame; NULL: the camera is static */
    struct spin_file_sequence frames;
};

/* Sorts by name; duplicate names are refused. `path` is for messages. */
spin_status spin_rig_sort(const char *path, struct spin_rig_camera *c, size_t n);

/* Lists the frames of a camera: the images of a folder, in the order of their numbers, or the
 * frames of a video. Errors about a video suggest the folder `instead`, for images extracted from
 * it. */
spin_status spin_rig_pictures(struct spin_model *m, struct spin_rig_camera *c, const char *folder);
spin_status spin_rig_film(struct spin_model *m, struct spin_rig_camera *c, const char *file,
                          const char *instead);

/* Adds the views of all cameras. All must have the same frame numbers, except that frames at the
 * end may be missing: the views end with the camera that has the fewest frames. A static camera is
 * scaled to the size of its first image, a moving one to that of each image. camera_id is the index
 * in `c`. Options: `time`, and `hold` N to hold out each N-th camera (default 8; 0: none). */
spin_status spin_rig_views(struct spin_model *m, struct spin_rig_camera *c, size_t n,
                           struct spin_views *out);

/* Notes the rule of times and the frame rate: fps is a number, or a text such as "30000/1001"; NULL
 * if unknown. */
void spin_rig_note(struct spin_model *m, const spin_json *fps, struct spin_views *out);

#define SPIN_RIG_OPTIONS                                                                           \
    {"time", "RULE",                                                                               \
     "time of frame i of n: unit for i/(n-1), count for i/n, row for i, a number N for i/N",       \
     "unit"},                                                                                      \
    {                                                                                              \
        "hold", "N", "hold out every N-th camera, including the first; 0: none", "8"               \
    }
