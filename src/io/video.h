/* Frames of videos through FFmpeg, behind a C face. As with images, what calls FFmpeg is a shared
 * object of its own (spin-video.so), loaded on first use; a build without FFmpeg lacks it, and says
 * so when a video is to be read.
 *
 * A frame of a video is an image with the path "cam00.mp4#12": its twelfth from the first, counted
 * from 0 in the order in which they are shown. spin_image_size() and spin_image_read() take such
 * paths.
 *
 * In what order frames are asked for: decoding begins at a key frame, so a frame at random costs up
 * to as many as lie between two of those. Extracting a whole clip to disk first would be 15 GB and
 * more, which nobody asked for; instead the decoder stays where it is, and every frame that it
 * passes is offered to the caller, who keeps it while there is memory: so a video that fits is
 * decoded about once in all, and one that does not costs at most a key frame's distance each time.
 */
#pragma once

#include "io/file.h"

/* "cam00.mp4#12": length of the file's name and the number. Only .mp4, .mov, .m4v, .mkv and .webm;
 * .avi, whose frames have no times, is known by name to be refused by name. */
bool spin_video_path(const char *path, size_t *n_file, int64_t *frame);
/* Whether the name ends like a video's. */
bool spin_video_is_name(const char *name);

/* Load the shim now. Errors say what to install. */
spin_status spin_video_start(void);
/* The same; *shim is its table. */
struct spin_video_shim;
spin_status spin_video_shim(const struct spin_video_shim **shim);

/* Size and number of frames of a video file: its packets are counted, nothing is decoded. imprint,
 * or NULL: of the whole file; read once, and remembered while the file stays as it is. */
spin_status spin_video_info(const char *file, int *width, int *height, int64_t *n_frames,
                            struct spin_imprint *imprint);

/* Who is offered frames on the way to the one asked for. */
struct spin_video_passer {
    void *context;
    bool (*wants)(void *context, int64_t frame);
    /* Interleaved 8-bit RGB [height][width][3], borrowed. */
    void (*take)(void *context, int64_t frame, int width, int height, const uint8_t *rgb);
};

/* Decode a frame to interleaved 8-bit RGB, allocated with malloc. passer may be NULL. One thread at
 * a time goes in; others wait. */
spin_status spin_video_read(const char *file, int64_t frame, const struct spin_video_passer *passer,
                            int *width, int *height, uint8_t **rgb);

/* ---- Writing, frame by frame; the file appears under its name only when whole -------------------
 */

struct spin_video_out;

/* path ends in .mp4 or .webm. quality: 0 (best) to 51 (least). sync: as of struct spin_out. codec:
 * what was taken, static. Either commit or abandon must follow; both free it. */
spin_status spin_video_create(const char *path, bool force, bool sync, int width, int height,
                              double fps, int quality, struct spin_video_out **out,
                              const char **codec);
/* Planar [3][height][width] float, clamped to 0..1. */
spin_status spin_video_put(struct spin_video_out *out, const float *image);
spin_status spin_video_commit(struct spin_video_out *out);
void spin_video_abandon(struct spin_video_out *out);
