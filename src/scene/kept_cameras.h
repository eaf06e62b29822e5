/* The cameras that a bundle keeps of its data set, or of the cameras.json of the run: one view per
 * camera, without an image, all of data-set frame 0 and in the coordinates of the bundle. */
#pragma once

#include "spin.h"
#include "io/json.h"

/* Copies the cameras of data-set frame `row`, at most the first 256, to *out, which is freed
 * before. */
spin_status spin_kept_cameras_choose(const struct spin_views *views, int row,
                                     struct spin_views *out);
/* Copies the cameras of the cameras.json that descendants of 3DGS write beside their splats, at
 * most the first 256 different ones, to *out. The file is searched in the folder `run`, or beside
 * the file `run`, and above folders such as point_cloud/iteration_30000. *path receives its path,
 * which the caller frees; NULL: there is no such file, or it has another format, and *out is empty.
 */
spin_status spin_kept_cameras_find(const char *run, struct spin_views *out, char **path);

/* Creates the value of "cameras" of meta.json, and reads it. */
spin_json *spin_kept_cameras_json(const struct spin_views *kept);
spin_status spin_kept_cameras_read(const spin_json *list, struct spin_views *out);
