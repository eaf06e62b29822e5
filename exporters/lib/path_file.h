/* A camera's path from a file: what nerfstudio's viewer saves, or a plain list of matrices. */
#pragma once

#include "base/err.h"

struct spin_path_pose {
    double w2c[12];  /* as in struct spin_camera */
    double fovy_deg; /* vertical field of view, 0..180; 0: not said */
};

struct spin_path_file {
    struct spin_path_pose *pose; /* [n] */
    size_t n;                    /* 1 at least */
    int width, height;           /* pixels; 0: not said */
    double fps;                  /* 0: not said */
};

/* An object is nerfstudio's, whose matrices lead from cameras with x right, y up, z back to the
 * world. A list, or a text with a matrix a line, has matrices of 3 x 4 or 4 x 4 numbers, row by
 * row, from cameras with x right, y down, z ahead to the world. SPIN_E_MALFORMED names the matrix.
 */
spin_status spin_path_file_open(const char *path, struct spin_path_file *out);
void spin_path_file_close(struct spin_path_file *file);
