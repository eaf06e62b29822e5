/* Pairs the frames of synchronised videos by time. */
#pragma once

#include "importers/lib/camera_offsets.h"
#include "importers/lib/file_sequence.h"

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
