/* Finds the initial points of a data set, from which a training on it can start. */
#pragma once

#include "spin.h"

/* Sets *path, which the caller frees, to the file of points in the data set `folder`, or to NULL if
 * there is none. If several frames of the data set have points, *path is a pattern with "%d" for
 * the number of the frame, and *per_frame is true. */
spin_status spin_data_points(const char *folder, char **path, bool *per_frame);

/* Returns whether the folder contains PLY files, all of which have names that data sets use for
 * points. */
bool spin_holds_only_points(const char *folder);
