/* How cameras show the scene, from points that several of them see: log value = log colour of the point + log gain of
 * the camera + log falloff of its lens (math/exposure.h). */
#pragma once

#include "spin.h"

/* A point as a camera shows it. */
struct spin_look_sample {
    uint32_t point; /* those of a point stand together */
    int camera, lens;
    float r2;       /* of the pixel, spin_lens_r2() */
    float value[3]; /* r g b, above 0 */
};

/* exposure [n_cameras + n_lenses][6] = log gain r g b with mean 0, and 0 0 0, of each camera; c1 r g b, c2 r g b of each
 * lens. Least squares that few outliers do not bend. What no sample tells stays 0. */
spin_status spin_look_fit(const struct spin_look_sample *sample, size_t n, int n_cameras,
                          int n_lenses, float *exposure);
