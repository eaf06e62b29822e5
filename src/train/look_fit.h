/* How cameras show the scene, from points that several of them see: log value = log colour of the
 * point + log gain of the camera + log falloff of its lens (math/exposure.h). */
#pragma once

#include "spin.h"

/* A point as a camera shows it. */
struct spin_look_sample {
    uint32_t point; /* those of a point stand together */
    int camera, lens;
    int half;       /* of the scene, 0 or 1: regions of both lie side by side */
    float r2;       /* of the pixel, spin_lens_r2() */
    float value[3]; /* r g b, above 0 */
};

/* Why something is taken for real, or is not. */
enum spin_look_why {
    SPIN_LOOK_SEEN,
    SPIN_LOOK_FEW,          /* too few points tell anything */
    SPIN_LOOK_SAME_RADII,   /* each point is as far from the middle of one picture as of another */
    SPIN_LOOK_ODD,          /* no lens does what the fit says */
    SPIN_LOOK_NOT_HELD_OUT, /* one half of the scene does not show what the other tells */
};

struct spin_look {
    double spread;                     /* of the cameras' colours, camera_colours.h */
    enum spin_look_why gains, falloff; /* falloff: of at least one lens */
};

/* exposure [n_cameras + n_lenses][6] = log gain r g b with mean 0, and 0 0 0, of each camera; c1 r
 * g b, c2 r g b of each lens. Least squares that few outliers do not bend. What no sample tells
 * stays 0, and so does what is not to be believed: a falloff alone, or gains and falloff. corner
 * [n_lenses]: r^2 at the corners of the pictures. */
spin_status spin_look_choose(const struct spin_look_sample *sample, size_t n, int n_cameras,
                             int n_lenses, const double *corner, float *exposure,
                             struct spin_look *look);
