/* The interface between video.c and its shared object: one table of functions, looked up by
 * name. */
#pragma once

#include <stdint.h>

#define SPIN_VIDEO_SHIM_ABI 4
#define SPIN_VIDEO_SHIM_SYMBOL "spin_video_shim_table"

enum spin_video_result {
    SPIN_VIDEO_OK,
    SPIN_VIDEO_END,        /* no more frames */
    SPIN_VIDEO_UNREADABLE, /* unknown format, damaged, truncated; or cannot be written */
    SPIN_VIDEO_TOO_LARGE,
    SPIN_VIDEO_NO_MEMORY
};

/* A frame, listed in display order. */
struct spin_video_entry {
    int64_t pts, dts; /* in the stream's time base */
    int key;          /* key frame: decoding can start here */
};

struct spin_video_index {
    int width, height;
    int64_t n;
    struct spin_video_entry *entry; /* [n], sorted by pts; allocated with malloc */
};

struct spin_video_writer;

/* format: "mp4" or "webm". quality: 0 (best) to 51 (worst), on the scale of x264. */
struct spin_video_encoder {
    /* *codec receives the name of the codec in use, static. */
    enum spin_video_result (*open)(const char *path, const char *format, int width, int height,
                                   double fps, int quality, struct spin_video_writer **out,
                                   const char **codec);
    /* Encode one more frame, interleaved 8-bit RGB [height][width][3]. */
    enum spin_video_result (*put)(struct spin_video_writer *writer, const uint8_t *rgb);
    /* Write everything that is still buffered. */
    enum spin_video_result (*end)(struct spin_video_writer *writer);
    void (*close)(struct spin_video_writer *writer);
};

struct spin_video_stream;

struct spin_video_shim {
    int abi;
    const char *version; /* name and version of libavcodec */
    /* Why this thread's last call failed. */
    const char *(*why)(void);
    /* List the frames, from packets only. Refuses frames above max_pixels. */
    enum spin_video_result (*index)(const char *path, int64_t max_pixels,
                                    struct spin_video_index *out);
    enum spin_video_result (*open)(const char *path, const struct spin_video_index *index,
                                   struct spin_video_stream **out);
    /* Seek to a key frame: next() then returns it, possibly after some earlier frames in display
     * order, which may be damaged. */
    enum spin_video_result (*seek)(struct spin_video_stream *stream, int64_t key);
    /* Decode one more frame; *frame receives its index. */
    enum spin_video_result (*next)(struct spin_video_stream *stream, int64_t *frame);
    /* Convert the frame that next() decoded to interleaved 8-bit RGB [height][width][3]. */
    enum spin_video_result (*rgb)(struct spin_video_stream *stream, uint8_t *out);
    void (*close)(struct spin_video_stream *stream);
    const struct spin_video_encoder *encoder;
};

extern const struct spin_video_shim spin_video_shim_table;
extern const struct spin_video_encoder spin_video_encoder_table;
/* Set this thread's why() to `what`, followed by FFmpeg's text for `error` unless that is 0.
 * Returns `result`, or SPIN_VIDEO_NO_MEMORY if the error is a lack of memory. */
enum spin_video_result spin_video_fail(enum spin_video_result result, int error, const char *what);
