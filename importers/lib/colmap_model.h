/* Reads sparse models of COLMAP, binary or text: cameras, images and points.
 *
 * Binary files are little-endian and packed. If a model has both binary and text files, the binary
 * files are read, as in 3DGS. A pose maps a point p of the world to R(q) p + t in OpenCV's camera
 * axes, where q is the quaternion and t the translation of an image. Only pinhole cameras can be
 * rendered: images of a model with nonzero distortion must be undistorted first. */
#pragma once

#include "importers/lib/model.h"

struct spin_colmap_lens {
    int id;
    struct spin_camera camera; /* intrinsics; the pose is not set */
};

struct spin_colmap_image {
    const char *name;
    double q[4], t[3];
    int lens_id;
    size_t place; /* index of the image in the file */
    struct spin_camera camera;
};

/* All points of a model, from points3D.bin or points3D.txt. The caller frees both arrays. */
struct spin_colmap_points {
    double (*xyz)[3];
    unsigned char (*rgb)[3];
    size_t n, capacity;
};
/* Reads a file of points; it is binary if its name ends with ".bin". */
spin_status spin_colmap_read_points(const char *path, struct spin_colmap_points *out);

/* A sparse model: pinhole cameras with their poses. The caller sets `base` and `centre`, zeroes the
 * rest, and frees `lens` and `image`. */
struct spin_colmap {
    struct spin_model *base;
    bool centre;        /* move principal points to the image centre */
    const char *sparse; /* folder of the model's files */
    bool binary;
    struct spin_colmap_lens *lens;
    size_t n_lenses;
    struct spin_colmap_image *image; /* sorted by name */
    size_t n_images, capacity;
    double (*point)[3]; /* [n_points] a sample of the model's points: every point_step-th */
    size_t n_points;
    uint64_t point_step, n_seen;    /* n_seen: number of points read so far */
    struct spin_colmap_points *all; /* private: where all points are stored; NULL: only a sample */
};

/* Searches a folder for a model: first its subfolders sparse/0, sparse and sparse_, then the folder
 * itself, then colmap/sparse/0. Sets m->sparse to the folder of the model, or to NULL if there is
 * none, and m->binary to whether the model's files are binary. */
spin_status spin_colmap_find(struct spin_colmap *m, const char *folder);
/* Reads the model in m->sparse. Warns if all points are behind a camera. */
spin_status spin_colmap_read(struct spin_colmap *m);
