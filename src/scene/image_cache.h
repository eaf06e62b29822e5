/* The images of a data set's views, decoded on request. */
#pragma once

#include "spin.h"

/* A cache of 8-bit images. Images are cached after decoding until they fill `budget` bytes; further
 * images are decoded on every request. Images are resized to the size of their camera by a box
 * filter; a different aspect ratio is an error. */
struct spin_image_cache {
    const struct spin_views *views;
    uint8_t **rgb;       /* [views->n]; NULL: not cached */
    size_t held, budget; /* used and maximum size, bytes */
    float background[3]; /* colour behind transparent pixels, 0..1 */
};
/* background: NULL means black. */
spin_status spin_image_cache_open(const struct spin_views *views, size_t budget,
                                  const float background[3], struct spin_image_cache *out);
void spin_image_cache_close(struct spin_image_cache *pixels);
/* Reads the image of a view as planar floats 0..1, [3][h][w]. If the image is a frame of a video,
 * frames that must be decoded before it are cached as well, within the budget. */
spin_status spin_image_cache_get(struct spin_image_cache *pixels, size_t view, float *out);
/* Reads the image of a view as interleaved bytes, [h][w][3]. */
spin_status spin_image_cache_get_rgb8(struct spin_image_cache *pixels, size_t view, uint8_t *out);

/* Converts interleaved 8-bit RGB to planar floats 0..1. */
void spin_image_floats(const uint8_t *rgb, size_t n_pixels, float *out);
