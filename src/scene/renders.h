/* A data set that is drawn instead of read: the frames of a clip, seen by cameras around what
 * moves. Its path is that of a bundle, and the name of its importer is "renders". */
#pragma once

#include "spin.h"

extern const struct spin_importer spin_renders;

/* Returns whether the data set `path` is drawn: if `from` names this importer or, with `from` NULL,
 * if the path is a bundle. */
bool spin_renders_reads(const char *path, const char *from);

/* Parses the path of an image of this data set: the path of the bundle, which the caller frees, the
 * index of the frame, and the camera. */
spin_status spin_renders_parse(const char *path, char **bundle, int *frame,
                               struct spin_camera *camera);
