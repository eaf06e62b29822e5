/* Finds the frames of a camera rig whose cameras are in a sparse model of COLMAP. */
#pragma once

#include "importers/lib/colmap_model.h"
#include "importers/lib/views_rig.h"

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
