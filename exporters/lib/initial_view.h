/* Where the scene is first looked at: the middle and the reach of its splats, and the first view of
 * the data set when there is one. */
#pragma once

#include <math.h>
#include <stdlib.h>

#include "base/mem.h"

struct spin_initial_view {
    double eye[3], target[3], up[3]; /* world */
    double fovy_deg, aspect;
    double
        reach[2]; /* how near to and how far from the target one may go, without walls in between */
    double z_near; /* as in struct spin_camera, but never 0 */
};

/* The median place, and half of the extent that holds 90 % of the splats along the longest axis. */
spin_status spin_initial_view_middle(const struct spin_splats *s, double middle[3], double *size);

/* Before the first frame, for a clip that begins with frames without splats: the same of the first
 * frame that has some. size 0: the clip begins with splats, or has none. */
spin_status spin_initial_view_later_middle(const struct spin_export_job *job, double middle[3],
                                           double *size);

/* Centre of a camera: -R^T t. */
void spin_initial_view_eye(const struct spin_camera *camera, double eye[3]);

/* The place nearest to the axes of all cameras of this row (all rows: -1), least squares, and the
 * median distance of these cameras from it. False, and nothing is set: the axes are about parallel,
 * or it lies behind most of them. */
bool spin_initial_view_pivot(const struct spin_views *views, int row, double pivot[3],
                             double *median);

/* The view to begin with: a held-out one of this row before others, or a training view. */
const struct spin_view *spin_initial_view_view(const struct spin_views *views, int row, bool test);

/* Focal length of a picture of this many rows, pixels. */
double spin_initial_view_focal(const struct spin_initial_view *view, int height);

/* Whether a picture of n pixels, [3][n], shows nothing but the background (NULL: black). */
bool spin_initial_view_is_blank(const float *image, size_t n, const float background[3]);

/* From the data set's camera, around the place on its axis that is nearest to the middle of the
 * scene; else from the front. The default up is that of a camera's world, y down. */
void spin_initial_view_first(const struct spin_views *views, int row, bool test,
                             const double middle[3], double size, struct spin_initial_view *out);
