/* Reads sparse models of COLMAP, binary or text: cameras, images and points; and finds the frames
 * of a camera rig whose cameras are in such a model.
 *
 * Binary files are little-endian and packed. If a model has both binary and text files, the binary
 * files are read, as in 3DGS. A pose maps a point p of the world to R(q) p + t in OpenCV's camera
 * axes, where q is the quaternion and t the translation of an image. Only pinhole cameras can be
 * rendered: images of a model with nonzero distortion must be undistorted first. */
#pragma once

#include "importers/lib/model.h"
#include "importers/lib/views_rig.h"

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

/* ---- Rigs ------------------------------------------------------------------------------------ */

struct spin_colmap_rig {
    struct spin_rig_camera *camera; /* [n], sorted by name, with their frames */
    size_t n; /* number of cameras; 0 if the images of the model do not form a rig */
};

/* Finds a rig in the data set `path`, whose images are in the folder `images`. There are two kinds
 * of rigs. In the first, the model contains all frames of all cameras, and the names of its images
 * consist of a camera name and a frame number. In the second, the model contains one image per
 * camera; the frames of the camera are in `images` itself, or in a folder or video that is named
 * after the image or its number. */
spin_status spin_colmap_find_rig(const struct spin_colmap *m, const char *path, const char *images,
                                 struct spin_colmap_rig *out);

/* Sets *out to the path of the model's image `name` in `folder`. If that file does not exist, a
 * file is accepted whose name has a different extension, or one extension more. If there is no such
 * file either, *out is the path folder/name. */
spin_status spin_colmap_picture(struct spin_model *m, const char *folder, const char *name,
                                const char **out);

/* Returns true if a folder of this name, such as images_2, masks or sparse, does not hold the
 * images of one camera or of one frame, but has another purpose. */
bool spin_colmap_is_other(const char *name);
