/* Photometric fit to points that are visible to several cameras. The model of a measured value is:
 * log value = log colour of the point + log gain of the camera + log falloff of the camera's lens
 * (math/exposure.h). */
#pragma once

#include "spin.h"

/* The colour of a point in one camera. */
struct spin_photometric_sample {
    uint32_t point; /* samples of a point are adjacent */
    int camera, lens;
    /* Half of the scene that contains the point, 0 or 1. Each half is held out from one fit, which
     * must predict it. */
    int half;
    /* Squared distance of the pixel from the image centre, see spin_lens_r2(). */
    float r2;
    float value[3]; /* colour r g b, each above 0 */
};

/* Whether a result is accepted, or why not. */
enum spin_photometric_why {
    SPIN_PHOTOMETRIC_SEEN,       /* accepted */
    SPIN_PHOTOMETRIC_FEW,        /* rejected: too few points can be compared */
    SPIN_PHOTOMETRIC_SAME_RADII, /* rejected: each point has about the same distance from the centre
                             in all images */
    SPIN_PHOTOMETRIC_ODD,        /* rejected: no real lens has a falloff like the fitted one */
    SPIN_PHOTOMETRIC_NOT_HELD_OUT, /* rejected: a fit to one half of the scene does not predict the
                               other half */
};

struct spin_photometric_result {
    /* Largest deviation of a camera from the others, see spin_photometric_fit_cameras(). */
    double spread;
    enum spin_photometric_why gains,
        falloff; /* falloff: SPIN_PHOTOMETRIC_SEEN if that of at least one lens is accepted */
};

/* Fits exposure [n_cameras + n_lenses][6], robustly against a few outliers. The row of a camera is
 * its log gain for r g b, with mean 0 over the cameras, then 0 0 0. The row of a lens is c1 for r g
 * b, then c2 for r g b. Cameras and lenses without samples have zeros. A rejected falloff is
 * replaced by zeros, and the gains are then fitted without falloff; if gains and falloff are both
 * rejected, all values are 0. corner [n_lenses] is r^2 at the corners of each lens's images. */
spin_status spin_photometric_choose(const struct spin_photometric_sample *sample, size_t n,
                                    int n_cameras, int n_lenses, const double *corner,
                                    float *exposure, struct spin_photometric_result *result);
