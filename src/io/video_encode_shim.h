/* What video_encode.c and the shared object behind it (the one of video_shim.h) agree on. */
#ifndef SPIN_IO_VIDEO_ENCODE_SHIM_H
#define SPIN_IO_VIDEO_ENCODE_SHIM_H

#include <stddef.h>
#include <stdint.h>

#define SPIN_VIDEO_ENCODE_ABI 2
#define SPIN_VIDEO_ENCODE_SYMBOL "spin_video_encode_table"

struct spin_video_writer;

/* format: "mp4" or "webm". quality: 0 (best) to 51 (least), as x264 counts. Calls return 0, or -1. */
struct spin_video_encode_shim {
    int abi;
    /* Why the last call of this thread failed. */
    const char *(*why)(void);
    /* codec: what was taken, static. */
    int (*open)(const char *path, const char *format, int width, int height, double fps,
                int quality, struct spin_video_writer **out, const char **codec);
    /* One frame more, interleaved 8-bit RGB [height][width][3]. */
    int (*put)(struct spin_video_writer *writer, const uint8_t *rgb);
    /* Write what is still to come. */
    int (*end)(struct spin_video_writer *writer);
    void (*close)(struct spin_video_writer *writer);
};

extern const struct spin_video_encode_shim spin_video_encode_table;

#endif
