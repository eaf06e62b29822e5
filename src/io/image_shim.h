/* The interface between image.c and its shared objects: one table of functions, looked up by name.
 * Plain C types only; no C++ exception crosses this boundary. */
#pragma once

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#define SPIN_IMAGE_SHIM_ABI 3
#define SPIN_IMAGE_SHIM_SYMBOL "spin_image_shim_table"

enum spin_image_result {
    SPIN_IMAGE_OK,
    SPIN_IMAGE_UNREADABLE, /* unknown format, damaged or truncated */
    SPIN_IMAGE_TOO_LARGE,
    SPIN_IMAGE_NO_MEMORY
};

/* An image to write: values 0..1 for integer formats, any values for float ones. */
struct spin_image_out {
    const char *format; /* "png" or "openexr" */
    int width, height, n_channels;
    /* [n_channels] R, G, B, then A, then others, which are written as 32-bit floats. */
    const char *const *names;
    int n_colours; /* number of channels R, G, B, A */
    int bits;      /* PNG: 8, 16; EXR: 16, 32 */
    bool linear;   /* linear colours instead of sRGB */
    /* [h][w][n_channels]; alpha is straight for PNG, premultiplied for EXR. */
    const float *pixels;
};

/* format: "jpeg" or "png", the only ones that image_plain.c accepts; "" to let OpenImageIO guess. A
 * call that fails fills why (n_why bytes). Results are allocated with malloc. */
struct spin_image_shim {
    int abi;
    const char *version; /* the underlying libraries */
    enum spin_image_result (*size)(const char *path, const char *format, int *width, int *height,
                                   int *channels, char *why, size_t n_why);
    /* Refuses images of more than max_pixels before it allocates memory. Alpha is composited over
     * background, 0..1. */
    enum spin_image_result (*read)(const char *path, const char *format, int64_t max_pixels,
                                   const float background[3], int *width, int *height,
                                   uint8_t **rgb, char *why, size_t n_why);
    /* Encode a PNG file. */
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
