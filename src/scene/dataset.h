/* Reads the views of a data set, and pairs the rows of the data set with frames of a clip. */
#pragma once

#include "scene/bundle.h"

#define SPIN_VIEWS_MAX_OPTIONS 8

/* Reads all views of the data set `path`. `from` is the name of the importer, followed by its
 * options, such as "dynerf:time=unit,test=-1"; if it is NULL or the name is empty, the importer is
 * detected. If used_from is not NULL, used_from[n_used_from] receives the argument `from` that
 * reads the same views again. */
spin_status spin_views_open(const char *path, const char *from, struct spin_views *out,
                            char *used_from, size_t n_used_from);

/* Replaces the split of the data set: the views of the n listed cameras become test views, all
 * others training views. Fails with SPIN_E_USAGE if a camera id does not exist. */
spin_status spin_views_split(struct spin_views *views, const int *test_cameras, int n);

/* Sets *n to the number of distinct positions of all training cameras, or of all cameras if all are
 * test cameras. */
spin_status spin_views_count_positions(const struct spin_views *views, size_t *n);

/* Scales the image sizes of all cameras by image_scale, which is above 0 and at most 16: with 0.5,
 * width and height are halved and rounded. */
spin_status spin_views_scale(struct spin_views *views, double image_scale);

/* Moves all cameras by -shift, as all positions of the clip were moved (see struct
 * spin_sequence_info). */
void spin_views_shift(struct spin_views *views, const double shift[3]);

/* Finds the row of the data set for each frame of the clip, and stores these rows in
 * dataset_frame_of [meta->n_frames]. If every row has one view, each from a different camera, and
 * the source clip has one frame, all views become views of row 0, unless `pair` is "number".
 *
 * `pair` is "number", "order" or "auto"; "" means "auto". "auto" pairs by number if both the clip
 * and the data set have frame numbers. Otherwise it pairs by order if the source clip has as many
 * frames as the data set; if not, it fails, and the message suggests --pair. */
spin_status spin_views_pair(struct spin_views *views, const struct spin_bundle_meta *meta,
                            const char *pair, int *dataset_frame_of);

/* Warns if every row has one view, each from a different camera. To be called when views are paired
 * with a clip of several frames: the images may be those of a rig, taken at the same time. */
spin_status spin_views_warn_single(const struct spin_views *views);

/* Returns the extent of the cameras, spatial_lr_scale of 3DGS: 1.1 times the largest distance of a
 * training camera, in any frame, from the mean position of the training cameras. A moving camera
 * contributes each of its positions to this mean. Returns 0 if there is only one position, and NAN
 * if memory runs out. */
double spin_views_extent(const struct spin_views *views);

/* Checks that the view's image exists, that its header can be read, and that it has the aspect
 * ratio of the camera. Error messages contain the camera id and the path. */
spin_status spin_view_check_image(const struct spin_view *view);
/* Checks one image of each camera like spin_view_check_image(): the first image that exists. A
 * camera is accepted if none of its images exists, or if its image needs a library that is not
 * installed. If `warns` is true, a warning is printed if images are smaller than their cameras. */
spin_status spin_views_check_cameras(const struct spin_views *views, bool warns);

/* Checks that an image of this size has the aspect ratio of the view's camera. */
spin_status spin_view_check_size(const struct spin_view *view, int width, int height);

/* Returns the number of pixels of the largest image, at least 1. */
size_t spin_views_pixels(const struct spin_views *views);
/* Returns the first view of a row of the data set. If the row has no views, returns the first view
 * of the next row that has any, or the end of the list. Views are sorted by row. */
const struct spin_view *spin_views_row(const struct spin_views *views, int row);

/* ---- Path of a data set ---------------------------------------------------------------------- */

/* The path is found even if the bundle was moved, alone or together with the data set. */

/* Stores two paths of the data set `data` in *meta: one relative to `folder`, the folder of the
 * bundle, and the absolute one. Data set and folder must exist. */
spin_status spin_bundle_set_data_path(struct spin_bundle_meta *meta, const char *folder,
                                      const char *data);
/* Sets *out to the absolute path of the data set, which need not exist, or to NULL if the bundle
 * has no data set. The caller frees *out. */
spin_status spin_bundle_data_path(const struct spin_bundle *bundle, char **out);
