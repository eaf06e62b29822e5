/* Photometric fit to points that several cameras see: log value = log colour of the point + log
 * gain of the camera + log falloff of its lens (math/exposure.h). */
#pragma once

#include "spin.h"

/* The colour of a point in one camera. */
struct spin_look_sample {
    uint32_t point; /* samples of a point are adjacent */
    int camera, lens;
    int half;       /* half of the scene, 0 or 1; held out in turn */
    float r2;       /* spin_lens_r2() of the pixel */
    float value[3]; /* r g b, above 0 */
};

/* Whether a result is accepted, or why not. */
enum spin_look_why {
    SPIN_LOOK_SEEN,         /* accepted */
    SPIN_LOOK_FEW,          /* too few usable points */
    SPIN_LOOK_SAME_RADII,   /* each point has the same distance from the centre in all images */
    SPIN_LOOK_ODD,          /* no real lens behaves like the fit */
    SPIN_LOOK_NOT_HELD_OUT, /* a fit to one half of the scene does not predict the other */
};

struct spin_look {
    double spread;                     /* largest deviation of a camera, camera_colours.h */
    enum spin_look_why gains, falloff; /* falloff: accepted for at least one lens, or why not */
};

/* Fits exposure [n_cameras + n_lenses][6]: for each camera log gain r g b, with mean 0 over
 * cameras, and 0 0 0; for each lens c1 r g b, c2 r g b. Robust against a few outliers. Values
 * without samples are 0. If only the falloff is rejected it is 0; if gains and falloff are rejected
 * all values are 0. corner [n_lenses]: r^2 at the corners of the images. */
spin_status spin_look_choose(const struct spin_look_sample *sample, size_t n, int n_cameras,
                             int n_lenses, const double *corner, float *exposure,
                             struct spin_look *look);
