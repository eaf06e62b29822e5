/* Writes the cameras of exported images in the format of D-NeRF, so that the images are a data set
 * that other programs can train on:
 *
 *     transforms_train.json  transforms_test.json
 *         camera_angle_x, w, h                of the first image
 *         frames[]: file_path (without .png), time (0 to 1), w, h, fl_x, fl_y, cx, cy,
 *                   transform_matrix (c2w, OpenGL's axes)
 */
#pragma once

#include "io/json.h"
#include "io/output.h"

struct spin_transforms_file {
    spin_json *root[2]; /* of the training images, and of the held-out images */
};

/* Adds the image in the file `name`. time: 0 to 1. */
void spin_transforms_file_add(struct spin_transforms_file *t, const char *name, double time,
                              const struct spin_camera *camera, bool test);
/* Writes the files to the folder. A file without images is not written. */
spin_status spin_transforms_file_write(struct spin_transforms_file *t,
                                       struct spin_output_folder *folder, bool sync);
void spin_transforms_file_close(struct spin_transforms_file *t);
