/* The views of a data set: which belong to which frame of the clip. */
#pragma once

#include "scene/bundle.h"

#define SPIN_VIEWS_MAX_OPTIONS 8

/* Find the importer that reads data set `path` (from NULL: detect) and read all views. The
 * importer's own options follow its name: "dynerf:time=unit,test=-1". used_from gets what opens it
 * again. */
spin_status spin_views_open(const char *path, const char *from, struct spin_views *out,
                            char *used_from, size_t n_used_from);

/* Override the split: cameras in the list are test, the others train. Every id must exist. */
spin_status spin_views_split(struct spin_views *views, const int *test_cameras, int n);

/* Scale every camera (image_scale 0.5: half the size, rounded). */
spin_status spin_views_scale(struct spin_views *views, double image_scale);

/* Data set row of each of the clip's frames. pair: "auto" or "", "number", "order". By number where
 * both have numbers, else by order when the whole source clip has as many frames as the data set;
 * anything else is an error that names the option that decides. dataset_frame_of [meta->n_frames].
 */
spin_status spin_views_pair(const struct spin_views *views, const struct spin_bundle_meta *meta,
                            const char *pair, int *dataset_frame_of);

/* 3DGS's spatial_lr_scale: 1.1 x the largest distance of a training camera from their mean, over
 * all frames. A camera counts once for every place where it stands. 0: all stand in one place. NAN:
 * out of memory. */
double spin_views_extent(const struct spin_views *views);

/* Set the near plane of all views by the points of one frame: SPIN_NEAR, or less where a typical
 * view shows points so near that it would cut into them, as in scenes of small units. Warns of a
 * view that still cuts off what is in its image. */
spin_status spin_views_set_near(struct spin_views *views, const float *points, size_t n,
                                bool warns);

/* See that the image is there, has a header that can be read, and the shape of its camera. Errors
 * name both. */
spin_status spin_view_check_image(const struct spin_view *view);
/* The same of one image of every camera, the first that is there. Cameras without one, and images
 * that only a library which is not installed could read, are left to who needs them. warns: of
 * those that are smaller than their cameras. */
spin_status spin_views_check_cameras(const struct spin_views *views, bool warns);

/* Whether an image of this size can be that of the view: the shape of its camera. */
spin_status spin_view_check_size(const struct spin_view *view, int width, int height);

/* Pixels of the largest picture, at least 1. */
size_t spin_views_pixels(const struct spin_views *views);
/* The first view of a row of the data set, by which views are sorted, or where it would be. */
const struct spin_view *spin_views_row(const struct spin_views *views, int row);
