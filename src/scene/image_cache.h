/* The pixels of a data set's views. */
#pragma once

#include "spin.h"

/* Pixels on demand: decoded once, kept as 8-bit while `budget` bytes last, decoded anew after that.
 * Images are box-filtered to the camera's size where they differ by a whole factor or more; an
 * aspect ratio that does not fit is an error. */
struct spin_image_cache {
    const struct spin_views *views;
    uint8_t **rgb; /* [views->n] */
    size_t held, budget;
    float background[3]; /* seen through transparent pixels */
};
/* background NULL: black. */
spin_status spin_image_cache_open(const struct spin_views *views, size_t budget,
                                  const float background[3], struct spin_image_cache *out);
void spin_image_cache_close(struct spin_image_cache *pixels);
/* Planar [3][h][w] float 0..1 of one view. Where images are frames of a video, those that are
 * decoded on the way are kept as well, while there is room. */
spin_status spin_image_cache_get(struct spin_image_cache *pixels, size_t view, float *out);
/* The same as bytes: interleaved [h][w][3]. */
spin_status spin_image_cache_get_rgb8(struct spin_image_cache *pixels, size_t view, uint8_t *out);

/* Interleaved 8-bit RGB as planar floats 0..1. */
void spin_image_floats(const uint8_t *rgb, size_t n_pixels, float *out);
