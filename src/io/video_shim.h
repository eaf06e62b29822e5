/* The interface between video.c and its shared object: one table of functions, looked up by
 * name. */
#pragma once

#include <stddef.h>
#include <stdint.h>

#define SPIN_VIDEO_SHIM_ABI 6
#define SPIN_VIDEO_SHIM_SYMBOL "spin_video_shim_table"

enum spin_video_result {
    SPIN_VIDEO_OK,
    SPIN_VIDEO_END, /* the stream has no more frames */
    /* The input has an unknown format, is damaged or is truncated; or the output cannot be
     * written. */
    SPIN_VIDEO_UNREADABLE,
    SPIN_VIDEO_TOO_LARGE,
    SPIN_VIDEO_NO_MEMORY
};

/* One frame in the index of a video. */
struct spin_video_entry {
    int64_t pts, dts; /* presentation and decoding time, in units of the stream's time base */
    int key;          /* 1: a key frame, at which decoding can start; 0: any other frame */
};

struct spin_video_index {
    int width, height; /* size of the frames as players show them */
    /* How a stored pixel (x, y) is mapped to the frame as players show it: x and y are exchanged if
     * `swaps`; then x is mirrored if mirrors_x, and y if mirrors_y. */
    int swaps, mirrors_x, mirrors_y;
    double unit; /* seconds per unit of pts */
    int64_t n;
    struct spin_video_entry *entry; /* [n], sorted by pts; allocated with malloc */
};

struct spin_video_writer;

/* A sound file in memory, which must stay valid until the writer is closed. */
struct spin_video_sound {
    const uint8_t *data;
    size_t size;
    /* Time of the video, in seconds, at which the sound starts. If start is negative, the first
     * -start seconds of the sound are cut off. */
    double start;
    double gain; /* factor of the amplitude */
};

/* The functions that write a video. format: "mp4" or "webm". quality: 0 (best) to 51 (worst), on
 * the scale of x264. */
struct spin_video_encoder {
    /* sound: NULL for a video without sound. *codec receives the name of the video codec in use,
     * static. */
    enum spin_video_result (*open)(const char *path, const char *format, int width, int height,
                                   double fps, int quality, const struct spin_video_sound *sound,
                                   struct spin_video_writer **out, const char **codec);
    /* Encode one more frame, given as interleaved 8-bit RGB [height][width][3]. */
    enum spin_video_result (*put)(struct spin_video_writer *writer, const uint8_t *rgb);
    /* Write everything that is still buffered, and complete the file. */
    enum spin_video_result (*end)(struct spin_video_writer *writer);
    void (*close)(struct spin_video_writer *writer);
};

struct spin_video_stream;

struct spin_video_shim {
    int abi;
    const char *version; /* name and version of libavcodec */
    /* Returns the reason why this thread's last call failed. */
    const char *(*why)(void);
    /* List the frames by reading the packets, without decoding them. Refuses videos with more than
     * max_pixels pixels per frame. */
    enum spin_video_result (*index)(const char *path, int64_t max_pixels,
                                    struct spin_video_index *out);
    enum spin_video_result (*open)(const char *path, const struct spin_video_index *index,
                                   struct spin_video_stream **out);
    /* Seek to the key frame with index `key`. The following calls of next() return this frame,
     * possibly preceded by frames that are displayed earlier and may be damaged. */
    enum spin_video_result (*seek)(struct spin_video_stream *stream, int64_t key);
    /* Decode one more frame; *frame receives its index. */
    enum spin_video_result (*next)(struct spin_video_stream *stream, int64_t *frame);
    /* Write the frame that next() decoded to `out`, as interleaved 8-bit RGB [height][width][3]. */
    enum spin_video_result (*rgb)(struct spin_video_stream *stream, uint8_t *out);
    void (*close)(struct spin_video_stream *stream);
    const struct spin_video_encoder *encoder;
};

extern const struct spin_video_shim spin_video_shim_table;
extern const struct spin_video_encoder spin_video_encoder_table;
/* Make why() return `what` on this thread, followed by FFmpeg's text for `error` unless that is 0.
 * Returns `result`, or SPIN_VIDEO_NO_MEMORY if the error is a lack of memory. */
enum spin_video_result spin_video_fail(enum spin_video_result result, int error, const char *what);

/* ---- Between the parts of the encoder ---- */

struct AVFormatContext;
struct spin_video_track;

/* Prepare to decode the sound and to encode it as a second stream of `file`, as AAC or Opus
 * according to the format. Call this before the header of the file is written. Returns 0 or an
 * error of FFmpeg, as the next two functions do. */
int spin_video_track_open(struct AVFormatContext *file, const char *format,
                          const struct spin_video_sound *sound, struct spin_video_track **out);
/* Write the samples up to this time of the video, with silence where there is no sound. */
int spin_video_track_write(struct spin_video_track *track, double seconds);
/* Write the last samples of a video of this duration. */
int spin_video_track_end(struct spin_video_track *track, double seconds);
void spin_video_track_close(struct spin_video_track *track);
