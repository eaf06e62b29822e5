/* Data sets of a camera rig, with a folder of numbered images or a video for each camera. */
#pragma once

#include "importers/lib/file_sequence.h"
#include "importers/lib/model.h"
#include "importers/lib/views_check.h"

/* ---- Start times of cameras ------------------------------------------------------------------ */

/* They are relative to the start of the clip. */

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

/* ---- Videos ---------------------------------------------------------------------------------- */

/* The frames of synchronised videos are paired by time. */

struct spin_rig_video {
    const char *camera; /* name of the camera, for spin_offsets_of() */
    const char *file;
    struct spin_file_sequence
        frames; /* set by the function: paths such as "cam00.mp4#7", with frame numbers */

    /* private */
    double *time; /* [n] times of the frames, in seconds from the first frame */
    size_t n;
    double rate;   /* frames per second, 0 for a single frame */
    double offset; /* seconds by which the video starts later than the clip */
    bool regular;  /* frame k is at k / rate */
};

/* Lists the frames of n videos, which start at the same time except for `offsets`. If all videos
 * have the same constant rate and offsets of whole frames, the frame number is the index of a frame
 * plus the offset. Otherwise the clip gets the lowest of the rates, and each frame number is
 * assigned, from every video, the frame that is nearest in time, or no frame if the nearest is more
 * than half a frame interval away; a warning states the rates. */
spin_status spin_video_rows(struct spin_model *m, struct spin_rig_video *film, size_t n,
                            struct spin_offsets *offsets);

/* ---- The rig --------------------------------------------------------------------------------- */

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
