/* Frames of videos, decoded by FFmpeg, with a C interface. As for images, the code that calls
 * FFmpeg is in a shared object of its own (spin-video.so), which is loaded on first use. A build
 * without FFmpeg does not contain this object; reading a video then fails with a message.
 *
 * A frame of a video is an image with the path "cam00.mp4#12", where 12 is its index from 0 in
 * display order. spin_image_size() and spin_image_read() accept such paths.
 *
 * Decoding can only start at a key frame, so that reading a random frame may decode all frames
 * between two key frames. Extracting all frames of a clip to disk first would take 15 GB and more.
 * Instead, the decoder keeps its position between calls, and passes all frames that it decodes to
 * the caller, which caches as many as fit in memory. If memory suffices for all frames of a video,
 * the video is decoded about once. */
#pragma once

#include "io/file.h"

/* Parse "cam00.mp4#12" to the length of the file name and the index. Accepts .mp4, .mov, .m4v, .mkv
 * and .webm. Also accepts .avi, so that reading such a frame fails with a message: the decoder does
 * not support AVI, whose frames have no timestamps. */
bool spin_video_path(const char *path, size_t *n_file, int64_t *frame);
/* Whether the name has the extension of a video. */
bool spin_video_is_name(const char *name);

/* Load the shim now. Errors state what to install. */
spin_status spin_video_start(void);
/* Load the shim like spin_video_start(), and set *shim to its table of functions. */
struct spin_video_shim;
spin_status spin_video_shim(const struct spin_video_shim **shim);

/* Read the size and the number of frames of a video from its packets, without decoding them.
 * digest: NULL, or receives the digest of the whole file, which is cached until the file changes.
 */
spin_status spin_video_info(const char *file, int *width, int *height, int64_t *n_frames,
                            struct spin_digest *digest);

/* Sets *times to the time of each of *n frames in seconds, counted from the first frame. The caller
 * frees *times. */
spin_status spin_video_times(const char *file, double **times, int64_t *n);

/* Functions that receive the frames that are decoded before the requested frame. */
struct spin_video_passer {
    void *context;
    /* Whether to convert this frame and pass it to receive_frame(). */
    bool (*is_wanted)(void *context, int64_t frame);
    /* Receives a frame as interleaved 8-bit RGB [height][width][3], valid only during this call. */
    void (*receive_frame)(void *context, int64_t frame, int width, int height, const uint8_t *rgb);
};

/* Decode a frame to interleaved 8-bit RGB, allocated with malloc. passer may be NULL. Thread-safe;
 * calls are serialised. */
spin_status spin_video_read(const char *file, int64_t frame, const struct spin_video_passer *passer,
                            int *width, int *height, uint8_t **rgb);

/* ---- Writing, frame by frame; the file appears under its name only when complete ---- */

struct spin_video_out;

/* Start a video. The path must end in ".mp4" or ".webm". quality: 0 (best) to 51 (worst). sync: see
 * struct spin_out. sound: NULL, or a track that is encoded as AAC or Opus, and that begins and ends
 * with the video; its data must stay valid until the video is complete. *codec receives the name of
 * the codec in use, static. The caller must finally call either spin_video_commit(), which
 * completes the file, or spin_video_abandon(), which removes it; each of these frees *out. */
spin_status spin_video_create(const char *path, bool force, bool sync, int width, int height,
                              double fps, int quality, const struct spin_sound *sound,
                              struct spin_video_out **out, const char **codec);
/* Add a frame, given as planar floats [3][height][width], which are clamped to 0..1. */
spin_status spin_video_put(struct spin_video_out *out, const float *image);
spin_status spin_video_commit(struct spin_video_out *out);
void spin_video_abandon(struct spin_video_out *out);
