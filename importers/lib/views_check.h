/* Checks that the readers of data sets share: poses, intrinsics, image sizes, names, option values.
 * Errors do not name the file and the entry; the calling reader adds them. */
#pragma once

#include "io/image.h"
#include "io/json.h"

/* Checks that the left 3 x 3 of a row-major [3][4] is a rotation and that all values are finite. */
spin_status spin_views_check_pose(const double m[12], const char *what);

/* Reads a matrix [n][n] from its JSON value; `key` names it in errors. A 4 x 4 matrix may omit its
 * last row, 0 0 0 1. */
spin_status spin_views_matrix(const spin_json *m, const char *key, size_t n, double *out);

/* Reads folder/name, which must be a JSON object, with `read`; errors name the file. If `found` is
 * not NULL, the file is optional and *found is whether it exists. */
spin_status spin_views_read_json(const char *folder, const char *name,
                                 spin_status (*read)(void *context, const spin_json *root,
                                                     struct spin_views *out),
                                 void *context, struct spin_views *out, bool *found);

/* Inverts the pose [R | t]: w2c is [R^T | -R^T t]. */
void spin_views_invert(const double c2w[12], double w2c[12]);

spin_status spin_views_check_size(double width, double height);
/* Calls spin_views_check_size() and stores the size in the camera. */
spin_status spin_views_size(double width, double height, struct spin_camera *out);

spin_status spin_views_check_intrinsics(const struct spin_camera *c);

/* Reads focal lengths and principal point from a matrix `key`, [fx 0 cx; 0 fy cy; 0 0 1]; the
 * camera's size must be set. */
spin_status spin_views_intrinsics(const double k[9], const char *key, struct spin_camera *out);

/* The time of row i of n by option `time` (default: `fallback`): unit for i/(n-1), count for i/n,
 * row for i, or a number N for i/N. */
spin_status spin_views_time(const struct spin_plugin_values *values, const char *fallback,
                            size_t row, size_t n_rows, double *out);

spin_status spin_views_fit_image(struct spin_camera *c, const char *path);

/* Whether a path is relative and stays below its folder. */
bool spin_views_is_safe_name(const char *name);

/* Checks that the images of all views from `first` on can be read. */
spin_status spin_views_check_images(const struct spin_views *views, size_t first);

/* The frame number, which is the last number in the file's name; -1 without one. */
int spin_views_number(const char *path);

/* The number in a folder name frame<digits>, as in 3DGStream; -1 for other names. */
int spin_frame_number(const char *name);

/* Parses a whole text as a finite number. */
bool spin_views_is_number(const char *text, double *out);

/* Sorts, drops duplicates and returns the new length. */
size_t spin_views_unique(int *list, size_t n);

/* Index of a value in a list sorted by spin_views_unique(), or -1. */
int spin_views_place(const int *list, size_t n, int value);
