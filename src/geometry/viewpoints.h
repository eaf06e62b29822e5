/* Places cameras around what a clip shows, for clips without cameras of their own: inside rooms,
 * around subjects, and never with a wall before the lens. What moves is the subject; without
 * motion, it is the densest part of the scene. The cameras do not depend on the unit of the scene,
 * and turn with it. */
#pragma once

#include "geometry/voxels.h"

struct spin_viewpoints_options {
    int n_cameras, n_test; /* cameras to place, and further ones that are held out; may be 0 */
    int width, height;     /* pixels */
    double fovy_deg;       /* vertical field of view */
    double up[3];          /* {0}: -y, as in most captures */
    uint64_t seed;
};

struct spin_viewpoint {
    struct spin_camera camera;
    bool test;
};

struct spin_viewpoints {
    struct spin_viewpoint *camera; /* [n], held-out ones last */
    int n;
    double centre[3], radius; /* the ball around the subject */
    double reach;             /* radius of the ball around `centre` with 90 % of the scene */
    double up[3];             /* unit vector */
    bool room;                /* walls surround the subject: the cameras stand inside */
    /* A place in front of the subject and slightly above. From there, a camera can circle around
     * the axis `up` through the centre; `free_circle`: without a wall before its lens anywhere. */
    double front[3];
    bool free_circle;
    double distance; /* largest distance of a camera from the centre */
    /* Share of what moves, or of the subject, and of the rest, that fewer than three of the
     * n_cameras have inside their image. */
    double few_moving, few_static;
};

/* Fails with SPIN_E_UNSUPPORTED if the clip has no opacities, or if fewer than n_cameras, or 8 of
 * them, have a free view: it sets out->n to the number of cameras that were placed. */
spin_status spin_viewpoints_open(const struct spin_viewpoints_options *o, int n_frames,
                                 spin_voxel_read_fn read, void *context,
                                 struct spin_viewpoints *out);
void spin_viewpoints_close(struct spin_viewpoints *p);

/* Sets a camera's pose to `eye`, looking at `target`. */
void spin_viewpoints_look(const double eye[3], const double target[3], const double up[3],
                          struct spin_camera *camera);
