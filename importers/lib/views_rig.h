/* Data sets of a camera rig, with a folder of numbered images or a video for each camera. */
#pragma once

#include "importers/lib/file_sequence.h"
#include "importers/lib/views_check.h"

struct spin_rig_camera {
    const char *name;           /* cameras are sorted by this text */
    const char *where;          /* path of the folder of images, or of the video */
    const char *masks;          /* folder of masks named like the images; NULL: none */
    struct spin_camera camera;  /* the camera in all frames, unless `moving` is set */
    struct spin_camera *moving; /* [frames] the camera in each frame; NULL: it is static */
    struct spin_file_sequence frames;
};

/* Sorts the cameras by name and refuses duplicate names. `path` is the data set, for messages. */
spin_status spin_rig_sort(const char *path, struct spin_rig_camera *c, size_t n);

/* List the frames of a camera: spin_rig_pictures() the images of a folder, in the order of their
 * numbers, spin_rig_film() the frames of a video. If the video does not exist or videos are not
 * supported, the message names `instead`, the folder for images extracted from the video. */
spin_status spin_rig_pictures(struct spin_model *m, struct spin_rig_camera *c, const char *folder);
spin_status spin_rig_film(struct spin_model *m, struct spin_rig_camera *c, const char *file,
                          const char *instead);

/* Adds the views of all cameras, each with the camera's index in `c` as camera_id. All cameras must
 * have the same frame numbers, but some may end earlier than others: the data set then ends with
 * the last frame of the camera that has the fewest frames. A static camera is scaled to the size of
 * its first image, a moving camera in each frame to the size of this frame's image. Option `time`
 * is that of spin_views_time(), with the default value "unit". Option `hold` N holds out the
 * cameras 0, N, 2 N, ...; 0 holds out none. The default is 8, or 0 if there is only one camera. */
spin_status spin_rig_views(struct spin_model *m, struct spin_rig_camera *c, size_t n,
                           struct spin_views *out);

/* Adds a note for the user that states the rule of times and the frame rate. `fps` is the frame
 * rate as a number, or as a text such as "30000/1001"; NULL if it is unknown. */
void spin_rig_note(struct spin_model *m, const spin_json *fps, struct spin_views *out);

#define SPIN_RIG_OPTIONS                                                                           \
    {"time", "RULE",                                                                               \
     "time of frame i of n: unit for i/(n-1), count for i/n, row for i, a number N for i/N",       \
     "unit"},                                                                                      \
    {                                                                                              \
        "hold", "N", "hold out every N-th camera, including the first; 0: none", "8"               \
    }
