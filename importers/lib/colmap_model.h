/* A COLMAP sparse model, sparse/0/{cameras,images,points3D}.{bin,txt}: pinhole cameras with their poses.
 *
 * Binary files are little-endian and packed; of text and binary the binary is taken, as the methods do. A
 * pose is w2c in OpenCV's axes already: R(q) p + t. A model with distortion that is not zero is refused. */
#ifndef SPIN_IMPORTERS_LIB_COLMAP_MODEL_H
#define SPIN_IMPORTERS_LIB_COLMAP_MODEL_H

#include "spin.h"

struct colmap_lens {
    int id;
    struct spin_camera camera; /* without a pose */
};

struct colmap_image {
    char *name;
    double q[4], t[3];
    int lens_id;
    size_t place; /* in the file */
    struct spin_camera camera;
};

struct colmap_model {
    char *sparse; /* where the files are */
    bool binary;
    bool centre; /* principal points are put in the middle */
    struct colmap_lens *lens;
    size_t n_lenses;
    struct colmap_image *image;
    size_t n_images, capacity;
    double (*point)[3]; /* every point_step-th */
    size_t n_points;
    uint64_t point_step, n_seen;
};

/* Of a folder with sparse/0 or sparse in it; *m is zero before. Images are
 * sorted by name. centre: principal points are put in the middle. Warns when all points are behind a
 * camera. To be freed, also after a failure. */
spin_status spin_colmap_model_read(const char *folder, bool centre, struct colmap_model *m);
void spin_colmap_model_free(struct colmap_model *m);

#endif
