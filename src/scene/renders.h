/* A data set whose images are rendered from the splats of a clip instead of read from files. The
 * cameras are placed around the subject of the clip (geometry/viewpoints.h). The path of the data
 * set is that of the bundle, and the name of its importer is "renders". */
#pragma once

#include "spin.h"

extern const struct spin_importer spin_renders;

/* Returns whether the images of the data set `path` are rendered: if `from` names this importer or,
 * if `from` is NULL, if the path is a bundle. */
bool spin_renders_reads(const char *path, const char *from);

/* Parses the path of an image of this data set, and sets *bundle to the path of the bundle, which
 * the caller frees, *frame to the index of the frame, and *camera. */
spin_status spin_renders_parse(const char *path, char **bundle, int *frame,
                               struct spin_camera *camera);
