/* Pairs the frames of synchronised videos by time. */
#pragma once

#include "importers/lib/camera_offsets.h"
#include "importers/lib/file_sequence.h"

struct spin_rig_video {
    const char *camera; /* name of the camera, by which its offset is found */
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

/* Lists the frames of n videos, which start at the same time unless `offsets` say otherwise. If all
 * have the same constant rate, the frame number is the index of a frame. Otherwise, with a warning
 * that states the rates, the clip has the lowest of the rates, and each frame number gets the frame
 * of the video that is nearest in time; none, if that is more than half a frame away. */
spin_status spin_video_rows(struct spin_model *m, struct spin_rig_video *film, size_t n,
                            struct spin_offsets *offsets);
