/* Measures photometric differences between the training cameras, in colour and in the falloff of
 * brightness towards the corners: fits the gain of each camera and the falloff of each lens to the
 * colours of points that are visible in several cameras. The model of a measured colour value is:
 * log value = log colour of the point + log gain of the camera + log falloff of the camera's lens
 * at the pixel (math/exposure.h). */
#pragma once

#include "spin.h"
#include "train/photos.h"

/* A sample: the colour of a point in one camera. */
struct spin_photometric_sample {
    uint32_t point; /* index of the point; samples of a point are adjacent */
    int camera, lens;
    /* Half of the scene, 0 or 1, that contains the point. To test a fit, the samples of one half
     * are predicted by a fit to the other half. */
    int half;
    /* Squared distance of the pixel from the image centre, see spin_lens_r2(). */
    float r2;
    float value[3]; /* colour r g b, each above 0 */
};

/* Whether a fitted result is accepted, or why it is rejected. */
enum spin_photometric_why {
    SPIN_PHOTOMETRIC_SEEN, /* accepted */
    SPIN_PHOTOMETRIC_FEW,  /* rejected: too few points are visible in several cameras */
    /* Rejected: in all images, a point has about the same distance from the centre, so the fit
     * cannot separate falloff from colour. */
    SPIN_PHOTOMETRIC_SAME_RADII,
    SPIN_PHOTOMETRIC_ODD, /* rejected: no real lens has a falloff like the fitted one */
    /* Rejected: a fit to one half of the scene does not predict the samples of the other half. */
    SPIN_PHOTOMETRIC_NOT_HELD_OUT,
};

struct spin_photometric_result {
    /* Largest deviation of a camera, see spin_photometric_fit_cameras(). */
    double spread;
    /* `falloff` is SPIN_PHOTOMETRIC_SEEN if the falloff of at least one lens is accepted. */
    enum spin_photometric_why gains, falloff;
};

/* Fits exposure [n_cameras + n_lenses][6] to the samples; outliers have low weights. The row of a
 * camera is its log gain for r g b, with mean 0 over the cameras, then 0 0 0. The row of a lens is
 * c1 for r g b, then c2 for r g b, where the falloff is 1 + c1 r^2 + c2 r^4. Rows of cameras and
 * lenses without samples are 0. If falloff is rejected, the rows of lenses are 0, and the gains are
 * fitted without falloff; if gains are rejected as well, all rows are 0. corner [n_lenses] is r^2
 * at the image corners of each lens. */
spin_status spin_photometric_choose(const struct spin_photometric_sample *sample, size_t n,
                                    int n_cameras, int n_lenses, const double *corner,
                                    float *exposure, struct spin_photometric_result *result);

/* Compares the colours of the source's points in the images of those training cameras in which the
 * points are visible. Sets result->spread to the largest absolute deviation of any camera in any
 * colour channel, 0..1. The deviation of a camera is the median, over its visible points, of the
 * difference between the point's colour in this camera and the point's mean colour in all cameras.
 * result->spread is -1 if too few points are visible in at least three cameras. Also fits a gain
 * for each camera and a falloff for each lens, stores them in plan->exposure and plan->lenses, and
 * sets result->gains and result->falloff. Gains and falloffs that are rejected are 0. */
spin_status spin_photometric_fit_cameras(struct spin_plan *plan, struct spin_photos *photos,
                                         struct spin_photometric_result *result);
