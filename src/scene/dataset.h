/* The views of a data set, and which frame of the clip each of them belongs to. */
#pragma once

#include "scene/bundle.h"

#define SPIN_VIEWS_MAX_OPTIONS 8

/* Reads all views of data set `path` with importer `from` (NULL: detect it). Options of the
 * importer follow its name: "dynerf:time=unit,test=-1". used_from (may be NULL) receives a `from`
 * that opens the same views again. */
spin_status spin_views_open(const char *path, const char *from, struct spin_views *out,
                            char *used_from, size_t n_used_from);

/* Overrides the split: cameras in the list are test cameras, all others train. Every id must
 * exist. */
spin_status spin_views_split(struct spin_views *views, const int *test_cameras, int n);

/* Scales every camera (0.5: half the size, rounded). 0 < image_scale <= 16. */
spin_status spin_views_scale(struct spin_views *views, double image_scale);

/* Finds the data set row of each of the clip's frames. pair: "number", "order", or "auto" (also
 * ""): by number if both have numbers, else by order if the whole source clip has as many frames as
 * the data set; otherwise an error that names the deciding option. dataset_frame_of
 * [meta->n_frames]. */
spin_status spin_views_pair(const struct spin_views *views, const struct spin_bundle_meta *meta,
                            const char *pair, int *dataset_frame_of);

/* spatial_lr_scale of 3DGS: 1.1 x the largest distance of a training camera from their mean, over
 * all frames. A camera counts once for each of its positions. 0: all are at one position. NAN: out
 * of memory. */
double spin_views_extent(const struct spin_views *views);

/* Sets the near plane of all views from the points of one frame: SPIN_NEAR, or less if a typical
 * view contains points so near that SPIN_NEAR would cut them off, as in scenes with small units.
 * warns: warn if a view still cuts off points inside its image. */
spin_status spin_views_set_near(struct spin_views *views, const float *points, size_t n,
                                bool warns);

/* Checks that the image exists, that its header is readable, and that its aspect ratio is the
 * camera's. Errors name camera and image. */
spin_status spin_view_check_image(const struct spin_view *view);
/* The same for one image of every camera, the first that exists. Cameras without images are no
 * error here, nor are images that need a library which is not installed. warns: warn of images that
 * are smaller than their cameras. */
spin_status spin_views_check_cameras(const struct spin_views *views, bool warns);

/* Checks that an image of this size has the aspect ratio of the view's camera. */
spin_status spin_view_check_size(const struct spin_view *view, int width, int height);

/* Pixels of the largest image, at least 1. */
size_t spin_views_pixels(const struct spin_views *views);
/* The first view of a row of the data set, or its insertion point. Views are sorted by row. */
const struct spin_view *spin_views_row(const struct spin_views *views, int row);
