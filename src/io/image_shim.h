/* What image.c and the shared objects behind it agree on: one table of functions, found by name.
 * Plain C types only; nothing thrown on the far side crosses over. */
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
    SPIN_IMAGE_UNREADABLE, /* no such format, damaged, cut short */
    SPIN_IMAGE_TOO_LARGE,
    SPIN_IMAGE_NO_MEMORY
};

/* A picture to write: values 0..1, or as they are where bits is of floats. */
struct spin_image_out {
    const char *format; /* "png" or "openexr" */
    int width, height, n_channels;
    const char *const *names; /* [n_channels] R, G, B, then A, then others, which are written as
                                 floats of 32 bits */
    int n_colours;            /* channels before the others */
    int bits;                 /* PNG: 8, 16; EXR: 16, 32 */
    bool linear;              /* light, else values for the screen */
    const float
        *pixels; /* [h][w][n_channels]; PNG: colours are not multiplied by alpha, EXR: they are */
};

/* format: "jpeg" or "png", which are all that image_plain.c is asked for; "" to let OpenImageIO
 * guess. Every call fills why (n_why bytes) when it fails. Blocks are malloc'ed. */
struct spin_image_shim {
    int abi;
    const char *version; /* of the library */
    enum spin_image_result (*size)(const char *path, const char *format, int *width, int *height,
                                   int *channels, char *why, size_t n_why);
    /* Refuses more than max_pixels before reserving. Alpha goes over the background, 0..1. */
    enum spin_image_result (*read)(const char *path, const char *format, int64_t max_pixels,
                                   const float background[3], int *width, int *height,
                                   uint8_t **rgb, char *why, size_t n_why);
    /* The bytes of a PNG file. */
    enum spin_image_result (*encode_png)(int width, int height, const uint8_t *rgb,
                                         unsigned char **bytes, size_t *n_bytes, char *why,
                                         size_t n_why);
    /* The bytes of a PNG or EXR file. */
    enum spin_image_result (*encode)(const struct spin_image_out *image, unsigned char **bytes,
                                     size_t *n_bytes, char *why, size_t n_why);
};

extern const struct spin_image_shim spin_image_shim_table;

#ifdef __cplusplus
}
#endif
