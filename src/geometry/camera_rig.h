/* The positions of the cameras of a data set, and the point at which they look. */
#pragma once

#include "spin.h"

/* Sets `out` to the centre of a camera, -R^T t. */
void spin_camera_centre(const struct spin_camera *camera, double out[3]);

/* Sets `pivot` to the point nearest, in the least-squares sense, to the optical axes of all cameras
 * of data-set frame `row` (-1: of all frames), and *median to the median distance of these cameras
 * from the pivot. Returns false and sets nothing if the axes are nearly parallel or if the point is
 * behind most of the cameras. */
bool spin_camera_pivot(const struct spin_views *views, int row, double pivot[3], double *median);
