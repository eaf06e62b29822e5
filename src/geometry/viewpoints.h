/* Places cameras around the subject of a clip that has no cameras of its own. The subject is the
 * part that moves or, in a static clip, the densest part. In a room the cameras stay inside the
 * walls, and no wall blocks their view. Placement is invariant to the scale of the scene, and
 * rotates with the scene. */
#pragma once

#include "geometry/voxels.h"

struct spin_viewpoints_options {
    int n_cameras, n_test; /* numbers of training and of held-out cameras to place; may be 0 */
    int width, height;     /* pixels */
    double fovy_deg;       /* vertical field of view */
    double up[3];          /* {0}: -y, as in most captures */
    uint64_t seed;
    bool detail; /* see struct spin_subject */
};

struct spin_viewpoint {
    struct spin_camera camera;
    bool test;
};

struct spin_viewpoints {
    struct spin_viewpoint *camera; /* [n] cameras, the held-out ones last */
    int n;
    double (*sample)[3]; /* [n_sample] positions of random splats of the subject, at any time */
    int n_sample;
    double centre[3], radius; /* the ball around the subject */
    bool moves;               /* the subject is the part that moves, not the densest part */
    double reach; /* radius of the ball around `centre` that contains 90 % of the scene */
    double up[3]; /* unit vector */
    bool room;    /* walls surround the subject, so the cameras are inside them */
    /* A position in front of the subject and slightly above it, from which a camera can circle
     * around the axis `up` through the centre. free_circle: no wall blocks the view from any point
     * of this circle. */
    double front[3];
    bool free_circle;
    double distance; /* largest distance of a camera from the centre */
    /* Shares of the sampled splats of the subject (few_moving) and of the whole scene (few_static)
     * that are inside the images of fewer than three training cameras. */
    double few_moving, few_static;
};

/* Places the cameras. After success, out->n may be less than n_cameras + n_test. Fails with
 * SPIN_E_UNSUPPORTED if the clip has no opacities, or if fewer than 8 training cameras (or fewer
 * than n_cameras, if that is less than 8) have a free view. */
spin_status spin_viewpoints_open(const struct spin_viewpoints_options *o, int n_frames,
                                 spin_voxel_read_fn read, void *context,
                                 struct spin_viewpoints *out);
void spin_viewpoints_close(struct spin_viewpoints *p);

/* Sets the pose of a camera at `eye` that looks at `target`. */
void spin_viewpoints_set_pose(const double eye[3], const double target[3], const double up[3],
                              struct spin_camera *camera);

/* ---- The subject ----------------------------------------------------------------------------- */

/* The subject of a clip is the part that moves or, in a static clip, the densest part. That is the
 * part with the most opaque area or, if `detail` is set, with the most small splats: in a room, a
 * person instead of a wall. The subject is described by its splats and by a ball around most of
 * them. */
struct spin_subject {
    double centre[3], radius;
    double reach; /* radius of the ball around `centre` that contains 90 % of the opaque area */
    double span;  /* only splats within this distance of `centre` belong to the subject */
    bool moves;
    size_t *splat; /* [n] splats of the subject, as indices into spin_voxels.splat */
    /* [n] weights of these splats. If the subject moves: their opacity, reduced where they are
     * occluded or seem to flicker; with `detail`, their opacity; otherwise their opaque area. */
    double *weight;
    size_t n;
};

spin_status spin_subject_find(const struct spin_voxels *v, bool detail, uint64_t seed,
                              struct spin_subject *out);
void spin_subject_free(struct spin_subject *s);

/* Samples an item by its weight: returns the first i whose running sum sums[i] exceeds `share`, 0
 * to 1, of the total. A uniform random share gives item i with the probability weight[i] /
 * total. */
size_t spin_subject_draw(const double *sums, size_t n, double share);
