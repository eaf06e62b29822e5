/* The cameras that a bundle keeps, so that it can be rendered without its data set. They are copied
 * from the data set or from the cameras.json of the imported run: one view per camera, without an
 * image, in data-set frame 0 and in the coordinates of the bundle. */
#pragma once

#include "spin.h"
#include "io/json.h"

/* Frees *out and copies the cameras of data-set frame `row` to it, at most the first 256. */
spin_status spin_kept_cameras_choose(const struct spin_views *views, int row,
                                     struct spin_views *out);
/* Reads cameras.json, which descendants of 3DGS write beside their splats, and copies the first 256
 * distinct cameras to *out. The file is expected in the folder of the run's output: the folder
 * `run`, or the folder of the file `run`, but outside of point_cloud/iteration_N/ if that is part
 * of the path. *path is set to the path of the file, which the caller frees. If there is no such
 * file or it has another format, *path is NULL and *out is empty. */
spin_status spin_kept_cameras_find(const char *run, struct spin_views *out, char **path);

/* spin_kept_cameras_json() creates the value of "cameras" in meta.json, spin_kept_cameras_read()
 * reads it. */
spin_json *spin_kept_cameras_json(const struct spin_views *kept);
spin_status spin_kept_cameras_read(const spin_json *list, struct spin_views *out);
