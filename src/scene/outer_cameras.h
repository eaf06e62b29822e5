/* Finds the cameras at the edge of a rig. The apex is the point that all cameras look at; a camera
 * is at the edge if its direction from the apex is outside the convex cone of the directions of the
 * training cameras. A convex hull of the positions would not help: on a dome, every camera is an
 * extreme point of the hull. */
#pragma once

#include "spin.h"

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
