/* Decodes the images of a data set's views on request, and caches them. */
#pragma once

#include "spin.h"

/* A cache of 8-bit images. Decoded images are cached until they fill `budget` bytes; further images
 * are decoded on every request. Images are resized to the size of their camera by a box filter. An
 * image with another aspect ratio than its camera is an error. */
struct spin_image_cache {
    const struct spin_views *views;
    uint8_t **rgb;       /* [views->n], decoded image of each view; NULL: not cached */
    size_t held, budget; /* size of the cached images, and its maximum, in bytes */
    float background[3]; /* colour behind transparent pixels, 0..1 */
};
/* Opens a cache of at most `budget` bytes. A background of NULL means black. */
spin_status spin_image_cache_open(const struct spin_views *views, size_t budget,
                                  const float background[3], struct spin_image_cache *out);
void spin_image_cache_close(struct spin_image_cache *pixels);
/* Reads the image of a view as planar floats 0..1, [3][h][w]. If the image is a frame of a video,
 * the frames that must be decoded before it are cached too if the budget allows. */
spin_status spin_image_cache_get(struct spin_image_cache *pixels, size_t view, float *out);
/* Reads the image of a view as interleaved bytes, [h][w][3]. */
spin_status spin_image_cache_get_rgb8(struct spin_image_cache *pixels, size_t view, uint8_t *out);

/* Converts interleaved 8-bit RGB to planar floats 0..1. */
void spin_image_floats(const uint8_t *rgb, size_t n_pixels, float *out);
