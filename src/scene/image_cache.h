/* The pixels of a data set's views, decoded on demand. */
#pragma once

#include "spin.h"

/* Each image is decoded once and kept as 8-bit pixels until these fill `budget` bytes; others are
 * decoded on every request. Images whose size is not the camera's are box-filtered to it; a
 * different aspect ratio is an error. */
struct spin_image_cache {
    const struct spin_views *views;
    uint8_t **rgb; /* [views->n] */
    size_t held, budget;
    float background[3]; /* behind transparent pixels */
};
/* background: NULL means black. */
spin_status spin_image_cache_open(const struct spin_views *views, size_t budget,
                                  const float background[3], struct spin_image_cache *out);
void spin_image_cache_close(struct spin_image_cache *pixels);
/* Reads a view as planar [3][h][w] floats 0..1. If images are frames of a video, frames that are
 * decoded on the way are kept as well, within the budget. */
spin_status spin_image_cache_get(struct spin_image_cache *pixels, size_t view, float *out);
/* The same as interleaved bytes [h][w][3]. */
spin_status spin_image_cache_get_rgb8(struct spin_image_cache *pixels, size_t view, uint8_t *out);

/* Converts interleaved 8-bit RGB to planar floats 0..1. */
void spin_image_floats(const uint8_t *rgb, size_t n_pixels, float *out);
