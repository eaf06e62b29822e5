/* The view that a viewer shows first, from the centre and extent of the splats and, if there is a
 * data set, from its first view. */
#pragma once

#include <math.h>
#include <stdlib.h>

#include "base/mem.h"

struct spin_initial_view {
    double eye[3], target[3], up[3]; /* world */
    double fovy_deg, aspect;
    double
        reach[2];  /* range of distances from the target in which the camera does not enter walls */
    double z_near; /* as in struct spin_camera, but never 0 */
};

/* The median position; and half the largest side of the bounding box from the 5th to the 95th
 * percentile of each coordinate. */
spin_status spin_initial_view_middle(const struct spin_splats *s, double middle[3], double *size);

/* For a clip that begins with empty frames: the same for the first frame that has splats. Sets
 * *size to 0 if the first frame has splats, or no frame has any. Call it before the first frame. */
spin_status spin_initial_view_later_middle(const struct spin_export_job *job, double middle[3],
                                           double *size);

/* Centre of a camera: -R^T t. */
void spin_initial_view_eye(const struct spin_camera *camera, double eye[3]);

/* Sets pivot to the point nearest to the optical axes, in the least-squares sense, of all cameras
 * of this data-set frame (-1: of all frames), and median to the median distance of these cameras
 * from the pivot. Returns false and sets nothing if the axes are nearly parallel or the point is
 * behind most of the cameras. */
bool spin_initial_view_pivot(const struct spin_views *views, int row, double pivot[3],
                             double *median);

/* The first view of this data-set frame (-1: of any), preferably a held-out view (test) or a
 * training view (!test). NULL: no view. */
const struct spin_view *spin_initial_view_view(const struct spin_views *views, int row, bool test);

/* Focal length in pixels of an image with this many rows. */
double spin_initial_view_focal(const struct spin_initial_view *view, int height);

/* Whether an image [3][n] shows nothing but the background (NULL: black). */
bool spin_initial_view_is_blank(const float *image, size_t n, const float background[3]);

/* Sets the view to a camera of the data set, with the point on its axis nearest to the centre of
 * the scene as the target. Without views, the camera is in front of the scene, with y down. */
void spin_initial_view_first(const struct spin_views *views, int row, bool test,
                             const double middle[3], double size, struct spin_initial_view *out);
