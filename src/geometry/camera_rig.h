/* The geometry of the cameras of a data set: their positions, the point at which they look, their
 * near plane, and the cameras at the edge of the rig. */
#pragma once

#include "spin.h"

/* Sets `out` to the centre of a camera, -R^T t. */
void spin_camera_centre(const struct spin_camera *camera, double out[3]);

/* Sets `pivot` to the point nearest, in the least-squares sense, to the optical axes of all cameras
 * of data-set frame `row` (-1: of all frames), and *median to the median distance of these cameras
 * from the pivot. Returns false and sets nothing if the axes are nearly parallel or if the point is
 * behind most of the cameras. */
bool spin_camera_pivot(const struct spin_views *views, int row, double pivot[3], double *median);

/* ---- Near plane ------------------------------------------------------------------------------ */

/* Sets the near plane of all views from the n points [n][3] of one frame. Its distance is
 * SPIN_NEAR, or a quarter of the depth of the foreground in the median view if that is less, as in
 * scenes whose coordinates are small numbers. If `warns` is true, a warning is printed if the near
 * plane of a view still cuts off more than 1 % of the points inside its image. */
spin_status spin_views_set_near(struct spin_views *views, const float *points, size_t n,
                                bool warns);

/* ---- Outer cameras --------------------------------------------------------------------------- */

/* The apex is the point that all cameras look at; a camera is at the edge of the rig if its
 * direction from the apex is outside the convex cone of the directions of the training cameras. A
 * convex hull of the positions would not help: on a dome, every camera is an extreme point of the
 * hull. */

enum { SPIN_CONE_PLANES = 4096 };

struct spin_camera_cone {
    double apex[3]; /* the point that the cameras look at */
    /* Whether a training camera is in front of plane k. The planes pass through the apex, and their
     * normals are spread evenly over the sphere. */
    bool taken[SPIN_CONE_PLANES];
};

/* Measures the cone of all training cameras in all frames. Fails with SPIN_E_UNSUPPORTED if the
 * cameras do not look at a common point. */
spin_status spin_camera_cone_open(const struct spin_views *views, struct spin_camera_cone *out);
/* Returns whether the camera is outside the cone by more than 3 degrees. */
bool spin_camera_cone_excludes(const struct spin_camera_cone *cone,
                               const struct spin_camera *camera);

/* Turns the views of the n outermost training cameras into test views. Repeats n times: of the
 * training cameras that are left, holds out the one that is farthest outside the cone of the
 * others. A moving camera counts at its mean position. Fails with SPIN_E_USAGE if fewer than two
 * training cameras would remain or if no camera is outside the cone of the others, and with
 * SPIN_E_UNSUPPORTED like spin_camera_cone_open(). */
spin_status spin_outer_cameras_hold(struct spin_views *views, int n);
