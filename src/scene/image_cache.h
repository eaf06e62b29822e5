/* Decodes the images of a data set's views on request, and caches them. */
#pragma once

#include "scene/read_ahead.h"

/* A cache of 8-bit images. Decoded images are cached until they fill `budget` bytes; further images
 * are decoded on every request. Images are resized to the size of their camera by a box filter. An
 * image whose aspect ratio differs from that of its camera is an error. */
struct spin_image_cache {
    const struct spin_views *views;
    uint8_t **rgb;                 /* [views->n], decoded image of each view; NULL: not cached */
    size_t held;                   /* bytes of the cached images */
    size_t reserved;               /* bytes reserved for images that are decoded ahead */
    size_t budget;                 /* maximum of held + reserved */
    float background[3];           /* colour behind transparent pixels, 0..1 */
    struct spin_read_ahead *ahead; /* NULL: images are decoded when they are requested */
};
/* Opens a cache of at most `budget` bytes. A background of NULL means black. */
spin_status spin_image_cache_open(const struct spin_views *views, size_t budget,
                                  const float background[3], struct spin_image_cache *out);
void spin_image_cache_close(struct spin_image_cache *pixels);
/* Decodes announced images in background threads from now on. A fraction of the budget is reserved
 * for the images of these threads; if this fraction is too small for one image, no thread is
 * started. The struct must not be moved afterwards. */
spin_status spin_image_cache_read_ahead(struct spin_image_cache *pixels);
/* Returns the maximum number of views to announce; 0 without background threads. */
size_t spin_image_cache_ahead(const struct spin_image_cache *pixels);
/* Announces that the image of a view will be requested soon, after those announced before. Video
 * frames, and images rendered from the clip (--data renders), are decoded only on request. */
void spin_image_cache_announce(struct spin_image_cache *pixels, size_t view);
/* Reads the image of a view as planar floats 0..1, [3][h][w]. If the image is a frame of a video,
 * the frames that must be decoded before it are cached too if the budget allows. */
spin_status spin_image_cache_get(struct spin_image_cache *pixels, size_t view, float *out);
/* Reads the image of a view as interleaved bytes, [h][w][3]. */
spin_status spin_image_cache_get_rgb8(struct spin_image_cache *pixels, size_t view, uint8_t *out);

/* Converts interleaved 8-bit RGB to planar floats 0..1. */
void spin_image_floats(const uint8_t *rgb, size_t n_pixels, float *out);
