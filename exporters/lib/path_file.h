/* A camera path from a file: nerfstudio's JSON, or a plain list of matrices. */
#pragma once

#include "base/err.h"

struct spin_path_pose {
    double w2c[12];  /* as in struct spin_camera */
    double fovy_deg; /* vertical field of view, 0..180; 0: unspecified */
};

struct spin_path_file {
    struct spin_path_pose *pose; /* [n] */
    size_t n;                    /* number of poses, at least 1 */
    int width, height;           /* size of the images in pixels; 0: unspecified */
    double fps;                  /* frames per second; 0: unspecified */
};

/* Reads a camera path. A JSON object is a path of nerfstudio's viewer; its matrices map to the
 * world from a camera with the axes x right, y up, z back. A JSON list, or a text with one matrix
 * per line, contains matrices of 3 x 4 or 4 x 4 numbers in row-major order, which map to the world
 * from a camera with the axes x right, y down, z forward. SPIN_E_MALFORMED: a matrix is invalid;
 * the message contains its number. */
spin_status spin_path_file_open(const char *path, struct spin_path_file *out);
void spin_path_file_close(struct spin_path_file *file);
