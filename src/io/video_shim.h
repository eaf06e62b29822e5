/* What video.c and the shared object behind it agree on: one table of functions, found by name. */
#pragma once

#include <stdint.h>

#define SPIN_VIDEO_SHIM_ABI 4
#define SPIN_VIDEO_SHIM_SYMBOL "spin_video_shim_table"

enum spin_video_result {
    SPIN_VIDEO_OK,
    SPIN_VIDEO_END,        /* no more frames */
    SPIN_VIDEO_UNREADABLE, /* no such format, damaged, cut short; or cannot be written */
    SPIN_VIDEO_TOO_LARGE,
    SPIN_VIDEO_NO_MEMORY
};

/* A frame in the order of showing. */
struct spin_video_entry {
    int64_t pts, dts; /* in the stream's unit */
    int key;          /* decoding can begin here */
};

struct spin_video_index {
    int width, height;
    int64_t n;
    struct spin_video_entry *entry; /* [n], sorted by pts; malloc'ed */
};

struct spin_video_writer;

/* format: "mp4" or "webm". quality: 0 (best) to 51 (least), as x264 counts. */
struct spin_video_encoder {
    /* codec: what was taken, static. */
    enum spin_video_result (*open)(const char *path, const char *format, int width, int height,
                                   double fps, int quality, struct spin_video_writer **out,
                                   const char **codec);
    /* One frame more, interleaved 8-bit RGB [height][width][3]. */
    enum spin_video_result (*put)(struct spin_video_writer *writer, const uint8_t *rgb);
    /* Write what is still to come. */
    enum spin_video_result (*end)(struct spin_video_writer *writer);
    void (*close)(struct spin_video_writer *writer);
};

struct spin_video_stream;

struct spin_video_shim {
    int abi;
    const char *version; /* of libavcodec */
    /* Why the last call of this thread failed. */
    const char *(*why)(void);
    /* List the frames, reading packets only. Refuses more than max_pixels a frame. */
    enum spin_video_result (*index)(const char *path, int64_t max_pixels,
                                    struct spin_video_index *out);
    enum spin_video_result (*open)(const char *path, const struct spin_video_index *index,
                                   struct spin_video_stream **out);
    /* Go to a key frame: next() then gives it, perhaps after some shown before it, which may be
     * damaged. */
    enum spin_video_result (*seek)(struct spin_video_stream *stream, int64_t key);
    /* Decode one more frame; its number. */
    enum spin_video_result (*next)(struct spin_video_stream *stream, int64_t *frame);
    /* The frame that next() gave as interleaved 8-bit RGB [height][width][3]. */
    enum spin_video_result (*rgb)(struct spin_video_stream *stream, uint8_t *out);
    void (*close)(struct spin_video_stream *stream);
    const struct spin_video_encoder *encoder;
};

extern const struct spin_video_shim spin_video_shim_table;
extern const struct spin_video_encoder spin_video_encoder_table;
/* Text, with FFmpeg's error number when it is not 0, becomes why() of this thread. The result, or
 * SPIN_VIDEO_NO_MEMORY where that is the error. */
enum spin_video_result spin_video_fail(enum spin_video_result result, int error, const char *what);
