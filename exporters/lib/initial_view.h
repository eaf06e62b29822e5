/* Where a viewer starts: from the centre and extent of the splats and, if there is a data set, its
 * first view. */
#pragma once

#include <math.h>
#include <stdlib.h>

#include "base/mem.h"

struct spin_initial_view {
    double eye[3], target[3], up[3]; /* world */
    double fovy_deg, aspect;
    double reach[2]; /* nearest and farthest distance from the target that avoids walls */
    double z_near;   /* as in struct spin_camera, but never 0 */
};

/* The median position, and half the largest extent along an axis that holds 90 % of the splats. */
spin_status spin_initial_view_middle(const struct spin_splats *s, double middle[3], double *size);

/* The same of the first frame that has splats, for a clip that begins with empty frames; call it
 * before the first frame. size 0: the first frame has splats, or none has. */
spin_status spin_initial_view_later_middle(const struct spin_export_job *job, double middle[3],
                                           double *size);

/* Centre of a camera: -R^T t. */
void spin_initial_view_eye(const struct spin_camera *camera, double eye[3]);

/* The least-squares point nearest to the optical axes of all cameras of this row (all rows: -1),
 * and the median distance of these cameras from it. Returns false and sets nothing if the axes are
 * nearly parallel or the point is behind most of the cameras. */
bool spin_initial_view_pivot(const struct spin_views *views, int row, double pivot[3],
                             double *median);

/* The view to start from: of this row (-1: any), if possible a held-out one (or a training view, if
 * test is false). NULL: no view. */
const struct spin_view *spin_initial_view_view(const struct spin_views *views, int row, bool test);

/* Focal length in pixels of an image with this many rows. */
double spin_initial_view_focal(const struct spin_initial_view *view, int height);

/* Whether an image [3][n] shows nothing but the background (NULL: black). */
bool spin_initial_view_is_blank(const float *image, size_t n, const float background[3]);

/* Starts at a camera of the data set, aimed at the point on its axis nearest to the centre of the
 * scene; without views in front of the scene. By default up is that of a camera with y down. */
void spin_initial_view_first(const struct spin_views *views, int row, bool test,
                             const double middle[3], double size, struct spin_initial_view *out);
