/* Reads the views of a data set, and pairs the rows of the data set with frames of a clip. */
#pragma once

#include "scene/bundle.h"

#define SPIN_VIEWS_MAX_OPTIONS 8

/* Reads all views of the data set `path`. from: the importer, with options after its name, such as
 * "dynerf:time=unit,test=-1"; NULL: detect the importer. used_from[n_used_from], or NULL, receives
 * the argument `from` that reads the same views again. */
spin_status spin_views_open(const char *path, const char *from, struct spin_views *out,
                            char *used_from, size_t n_used_from);

/* Replaces the split: the views of the n listed cameras are test views, all others are training
 * views. SPIN_E_USAGE if a camera id does not exist. */
spin_status spin_views_split(struct spin_views *views, const int *test_cameras, int n);

/* Scales the images of all cameras. image_scale: above 0 and at most 16; 0.5: half the width and
 * height, rounded. */
spin_status spin_views_scale(struct spin_views *views, double image_scale);

/* Finds the row of the data set for each frame of the clip. pair: "number", "order", or "auto" or
 * "". "auto" pairs by number if clip and data set have frame numbers, otherwise by order if the
 * source clip has as many frames as the data set; otherwise the error message suggests --pair.
 * dataset_frame_of [meta->n_frames] receives the rows. */
spin_status spin_views_pair(const struct spin_views *views, const struct spin_bundle_meta *meta,
                            const char *pair, int *dataset_frame_of);

/* spatial_lr_scale of 3DGS: 1.1 times the largest distance of a training camera from the mean of
 * the training cameras, over all frames. A moving camera counts once for each position. 0 if there
 * is only one position; NAN if memory ran out. */
double spin_views_extent(const struct spin_views *views);

/* Sets the near plane of all views from the n points [n][3] of one frame. It is SPIN_NEAR, or less
 * if SPIN_NEAR would cut off the foreground of a typical view, as in scenes with small units.
 * warns: print a warning if the near plane of a view still cuts off points inside its image. */
spin_status spin_views_set_near(struct spin_views *views, const float *points, size_t n,
                                bool warns);

/* Checks that the view's image exists, that its header can be read, and that it has the aspect
 * ratio of the camera. Error messages contain the camera id and the path. */
spin_status spin_view_check_image(const struct spin_view *view);
/* Checks one image of every camera, the first that exists. Cameras without an existing image are
 * accepted, and so are images that need a library which is not installed. warns: print a warning if
 * images are smaller than their cameras. */
spin_status spin_views_check_cameras(const struct spin_views *views, bool warns);

/* Checks that an image of this size has the aspect ratio of the view's camera. */
spin_status spin_view_check_size(const struct spin_view *view, int width, int height);

/* Number of pixels of the largest image, at least 1. */
size_t spin_views_pixels(const struct spin_views *views);
/* The first view of a row of the data set; if the row has no views, the first view of a later row,
 * or the end of the list. Views are sorted by row. */
const struct spin_view *spin_views_row(const struct spin_views *views, int row);
