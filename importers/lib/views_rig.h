/* Data sets of a camera rig, with a folder of numbered images or a video for each camera. */
#pragma once

#include "importers/lib/camera_offsets.h"
#include "importers/lib/file_sequence.h"
#include "importers/lib/views_check.h"

struct spin_rig_camera {
    const char *name;           /* cameras are sorted by this text */
    const char *where;          /* path of the folder of images, or of the video */
    bool film;                  /* `where` is a video; spin_rig_views() lists its frames */
    const char *masks;          /* folder of masks named like the images; NULL: none */
    struct spin_camera camera;  /* the camera in all frames, unless `moving` is set */
    struct spin_camera *moving; /* [frames] the camera in each frame; NULL: it is static */
    struct spin_file_sequence frames;
};

/* Sorts the cameras by name and refuses duplicate names. `path` is the data set, for messages. */
spin_status spin_rig_sort(const char *path, struct spin_rig_camera *c, size_t n);

/* Lists the images of a camera's folder in the order of their numbers. */
spin_status spin_rig_pictures(struct spin_model *m, struct spin_rig_camera *c, const char *folder);
/* Uses the frames of a video as the frames of a camera. The video must have the camera's image
 * size. If the video does not exist or videos are not supported, the message names `instead`, the
 * folder for images extracted from the video. */
spin_status spin_rig_film(struct spin_rig_camera *c, const char *file, const char *instead);

/* Adds the views of all cameras, each with the camera's index in `c` as camera_id. Videos are
 * paired as in spin_video_rows(), and folders of images by their frame numbers, after the offsets
 * of spin_offsets_read() were added. The data set ends with the last frame of the camera that ends
 * first. Up to this frame, fewer than half of all images may be missing; a warning counts them. A
 * static camera is scaled to the size of its first image, a moving camera in each frame to the size
 * of this frame's image. Option `time` is that of spin_views_time(), with the default value "unit".
 * Option `hold` N holds out the cameras 0, N, 2 N, ...; 0 holds out none. The default is 8, or 0 if
 * there is only one camera. */
spin_status spin_rig_views(struct spin_model *m, struct spin_rig_camera *c, size_t n,
                           struct spin_views *out);

/* Adds a note for the user that states the rule of times and the frame rate. `fps` is the frame
 * rate as a number, or as a text such as "30000/1001"; NULL if it is unknown. */
void spin_rig_note(struct spin_model *m, const spin_json *fps, struct spin_views *out);

#define SPIN_RIG_OPTIONS                                                                           \
    {"time", "RULE",                                                                               \
     "time of frame i of n: unit for i/(n-1), count for i/n, row for i, a number N for i/N",       \
     "unit"},                                                                                      \
        SPIN_OFFSETS_OPTION,                                                                       \
    {                                                                                              \
        "hold", "N", "hold out every N-th camera, including the first; 0: none", "8"               \
    }
