/* The checks that all readers of data sets use: poses, intrinsics, image sizes, names, option
 * values. Error messages do not name the file and its entry: the calling reader adds both. */
#pragma once

#include "io/image.h"
#include "io/json.h"

/* Checks that all values of a row-major matrix [3][4] are finite and that its first three columns
 * are a rotation. `what` names the matrix in messages. */
spin_status spin_views_check_pose(const double m[12], const char *what);

/* Reads a matrix [n][n] from the JSON value `m`; `key` names the matrix in messages. The last row
 * of a 4 x 4 matrix may be missing; if it exists, it must be 0 0 0 1. */
spin_status spin_views_matrix(const spin_json *m, const char *key, size_t n, double *out);

/* Parses the file folder/name, whose root must be a JSON object, and calls read(context, root,
 * out). Error messages name the file. If `found` is not NULL, the file is optional: *found is set
 * to whether it exists, and `read` is not called if it does not. */
spin_status spin_views_read_json(const char *folder, const char *name,
                                 spin_status (*read)(void *context, const spin_json *root,
                                                     struct spin_views *out),
                                 void *context, struct spin_views *out, bool *found);

/* Inverts the pose c2w = [R | t]: w2c is [R^T | -R^T t]. */
void spin_views_invert(const double c2w[12], double w2c[12]);

spin_status spin_views_check_size(double width, double height);
/* Calls spin_views_check_size() and stores the size in the camera. */
spin_status spin_views_size(double width, double height, struct spin_camera *out);

spin_status spin_views_check_intrinsics(const struct spin_camera *c);

/* Sets the focal lengths and the principal point of a camera from the matrix k, which must be [fx 0
 * cx; 0 fy cy; 0 0 1]; `key` names the matrix in messages. The camera's size must already be set,
 * since the principal point is checked against it. */
spin_status spin_views_intrinsics(const double k[9], const char *key, struct spin_camera *out);

/* Sets *out to the time of frame i = `row` of n = `n_rows` frames. Option `time`, whose default is
 * `fallback`, selects the rule: "unit" for i/(n-1), "count" for i/n, "row" for i, or a number N for
 * i/N.
 */
spin_status spin_views_time(const struct spin_plugin_values *values, const char *fallback,
                            size_t row, size_t n_rows, double *out);

/* Scales a camera to the size of the image at `path`, which must have the camera's aspect ratio. */
spin_status spin_views_fit_image(struct spin_camera *c, const char *path);

/* Whether a path is relative and has no component "..", so that it stays below the folder that it
 * is relative to. */
bool spin_views_is_safe_name(const char *name);

/* spin_views_check_most() checks that less than half of the image files of the views from index
 * `first` on are missing. spin_views_drop_missing() removes the views without an image and warns
 * with their number. Frames that have no image at all are left out, with views->lacks_frames set.
 */
spin_status spin_views_check_most(const struct spin_views *views, size_t first);
spin_status spin_views_drop_missing(struct spin_views *views, size_t first);

/* Returns the last number in a name, ignoring the extension, or -1 if the name contains no number.
 * The number identifies a camera or a folder of frames. io/numbered.h reads the frame numbers of
 * files. */
int spin_views_number(const char *path);

/* Sets the frame numbers of the views from index `first` on from the names of their images, camera
 * by camera. If the frame numbers in the names of a camera are ambiguous, no view gets a number.
 * This is no error, since the importer already knows the frames of the views, and the numbers only
 * serve to pair the views with the frames of a clip. */
spin_status spin_views_set_numbers(struct spin_views *views, size_t first);

/* Returns N for a folder name frame<N>, as in 3DGStream, and -1 for other names. */
int spin_frame_number(const char *name);

/* Parses a number. Returns whether the text consists of one finite number and nothing else. */
bool spin_views_is_number(const char *text, double *out);

/* Sorts a list of n numbers, removes duplicates and returns the new length of the list. */
size_t spin_views_unique(int *list, size_t n);

/* Returns the index of a value in a list sorted by spin_views_unique(), or -1 if it is missing. */
int spin_views_index_of(const int *list, size_t n, int value);
