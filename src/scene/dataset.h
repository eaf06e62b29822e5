/* The views of a data set: which belong to which frame of the clip, and their pixels. */
#ifndef SPIN_SCENE_DATASET_H
#define SPIN_SCENE_DATASET_H

#include "scene/bundle.h"

#define SPIN_VIEWS_MAX_OPTIONS 8

/* Find the importer that reads data set `path` (from NULL: detect) and read all views. The importer's
 * own options follow its name: "dynerf:time=unit,test=-1". used_from gets what opens it again. */
spin_status spin_views_open(const char *path, const char *from, struct spin_views *out,
                            char *used_from, size_t n_used_from);

/* Override the split: cameras in the list are test, the others train. Every id must exist. */
spin_status spin_views_split(struct spin_views *views, const int *test_cameras, int n);

/* Scale every camera (image_scale 0.5: half the size, rounded). */
spin_status spin_views_scale(struct spin_views *views, double image_scale);

/* Data set row of each of the clip's frames. pair: "auto", "number", "order". By number where both
 * have numbers, else by order when the whole source clip has as many frames as the data set; anything
 * else is an error that names the option that decides. dataset_frame_of [meta->n_frames]. */
spin_status spin_views_pair(const struct spin_views *views, const struct spin_bundle_meta *meta,
                            const char *pair, int *dataset_frame_of);

/* 3DGS's spatial_lr_scale: 1.1 x the largest distance of a training camera from their mean, over all
 * frames. A camera counts once for every place where it stands. 0: all stand in one place. NAN: out of
 * memory. */
double spin_views_extent(const struct spin_views *views);

/* See that the image is there, has a header that can be read, and the shape of its camera. Errors name
 * both. */
spin_status spin_view_check_image(const struct spin_view *view);
/* The same of one image of every camera, the first that is there. Cameras without one, and images that
 * only a library which is not installed could read, are left to who needs them. */
spin_status spin_views_check_cameras(const struct spin_views *views);

/* Pixels on demand: decoded once, kept as 8-bit while `budget` bytes last, decoded anew after that.
 * Images are box-filtered to the camera's size where they differ by a whole factor or more; an aspect
 * ratio that does not fit is an error. */
struct spin_image_cache {
    const struct spin_views *views;
    uint8_t **rgb; /* [views->n] */
    size_t held, budget;
    float background[3]; /* seen through transparent pixels */
};
/* Whether an image of this size can be that of the view: the shape of its camera. */
spin_status spin_view_check_size(const struct spin_view *view, int width, int height);
/* background NULL: black. */
spin_status spin_image_cache_open(const struct spin_views *views, size_t budget,
                                  const float background[3], struct spin_image_cache *out);
void spin_image_cache_close(struct spin_image_cache *pixels);
/* Interleaved 8-bit RGB, box-filtered where the sizes differ, to planar [3][height][width] 0..1. */
spin_status spin_image_fit(const uint8_t *rgb, int from_width, int from_height, int width,
                           int height, float *out);

/* Planar [3][h][w] float 0..1 of one view. Where images are frames of a video, those that are decoded on
 * the way are kept as well, while there is room. */
spin_status spin_image_cache_get(struct spin_image_cache *pixels, size_t view, float *out);
/* The same as bytes: interleaved [h][w][3]. */
spin_status spin_image_cache_get_rgb8(struct spin_image_cache *pixels, size_t view, uint8_t *out);
/* The floats of bytes: what get makes of what get_rgb8 gives. */
void spin_image_floats(const uint8_t *rgb, size_t n_pixels, float *out);

#endif
