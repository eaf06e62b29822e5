/* The interface between image.c and its shared objects: one table of functions, looked up by name.
 * Plain C types only; no C++ exception crosses this boundary. */
#pragma once

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#define SPIN_IMAGE_SHIM_ABI 4
#define SPIN_IMAGE_SHIM_SYMBOL "spin_image_shim_table"

enum spin_image_result {
    SPIN_IMAGE_OK,
    SPIN_IMAGE_UNREADABLE, /* the file has an unknown format, is damaged or is truncated */
    SPIN_IMAGE_TOO_LARGE,
    SPIN_IMAGE_NO_MEMORY
};

/* An image to write. Values must be 0..1 if the file stores integers; if it stores floats, any
 * value is allowed. */
struct spin_image_out {
    const char *format; /* "png" or "openexr" */
    int width, height, n_channels;
    /* [n_channels] the names of the channels: "R", "G", "B", then "A" if there is alpha, then other
     * channels, which are written as 32-bit floats. */
    const char *const *names;
    int n_colours; /* how many of the channels are R, G, B or A: 3 or 4 */
    int bits;      /* bits per value in the file, for R, G, B and A; PNG: 8 or 16; EXR: 16 or 32 */
    bool linear;   /* the colours are linear; if false, they are sRGB */
    /* Frames per second as a fraction, which EXR stores; fps[0] = 0: unknown. */
    int fps[2];
    /* [h][w][n_channels]; alpha is straight for PNG, premultiplied for EXR. */
    const float *pixels;
};

/* The functions of a shared object. format: "jpeg" or "png", the only formats that image_plain.c
 * accepts; "": OpenImageIO detects the format. A function that fails writes the reason to `why`, of
 * n_why bytes. Results are allocated with malloc. */
struct spin_image_shim {
    int abi;
    const char *version; /* names and versions of the underlying libraries */
    enum spin_image_result (*size)(const char *path, const char *format, int *width, int *height,
                                   int *channels, char *why, size_t n_why);
    /* Refuses images of more than max_pixels before it allocates memory. Alpha is composited over
     * background, 0..1. */
    enum spin_image_result (*read)(const char *path, const char *format, int64_t max_pixels,
                                   const float background[3], int *width, int *height,
                                   uint8_t **rgb, char *why, size_t n_why);
    /* Encode 8-bit RGB as a PNG file. */
    enum spin_image_result (*encode_png)(int width, int height, const uint8_t *rgb,
                                         unsigned char **bytes, size_t *n_bytes, char *why,
                                         size_t n_why);
    /* Encode a PNG or EXR file. */
    enum spin_image_result (*encode)(const struct spin_image_out *image, unsigned char **bytes,
                                     size_t *n_bytes, char *why, size_t n_why);
};

extern const struct spin_image_shim spin_image_shim_table;

#ifdef __cplusplus
}
#endif
