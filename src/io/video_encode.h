/* A video file, written frame by frame through FFmpeg, behind a C face; the shared object is that of
 * io/video.h. The file appears under its name only when whole. */
#ifndef SPIN_IO_VIDEO_ENCODE_H
#define SPIN_IO_VIDEO_ENCODE_H

#include "spin.h"

struct spin_video_out;

/* path ends in .mp4 or .webm. quality: 0 (best) to 51 (least). sync: as of struct spin_out. codec: what was taken, static. Either
 * commit or abandon must follow; both free it. */
spin_status spin_video_create(const char *path, bool force, bool sync, int width, int height,
                              double fps, int quality, struct spin_video_out **out,
                              const char **codec);
/* Planar [3][height][width] float, clamped to 0..1. */
spin_status spin_video_put(struct spin_video_out *out, const float *image);
spin_status spin_video_commit(struct spin_video_out *out);
void spin_video_abandon(struct spin_video_out *out);

#endif
