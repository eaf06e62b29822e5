/* Finds the frames of a camera rig whose cameras are in a sparse model of COLMAP. */
#pragma once

#include "importers/lib/colmap_model.h"
#include "importers/lib/views_rig.h"

struct spin_colmap_rig {
    struct spin_rig_camera *camera; /* [n], sorted by name, with their frames */
    size_t n; /* number of cameras; 0 if the images of the model do not form a rig */
};

/* Finds a rig in the data set `path`, whose images are in the folder `images`. Either the name of
 * each image of the model consists of a camera and a frame number. Or the model contains one image
 * per camera; the frames of a camera are in a folder or a video with the name or the number of its
 * image, or in `images` itself. */
spin_status spin_colmap_find_rig(const struct spin_colmap *m, const char *path, const char *images,
                                 struct spin_colmap_rig *out);

/* Sets *out to the path of the model's image `name` in `folder`. If that file does not exist, a
 * file with another or an additional extension is accepted. If there is no such file either, *out
 * is the path folder/name. */
spin_status spin_colmap_picture(struct spin_model *m, const char *folder, const char *name,
                                const char **out);

/* Returns whether a folder with this name, such as images_2, masks or sparse, cannot contain the
 * images of a single camera or frame. */
bool spin_colmap_is_other(const char *name);
