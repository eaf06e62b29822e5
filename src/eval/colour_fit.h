/* The photometric fit: fits a gain and an offset per camera and channel that bring rendered images
 * closest to the ground truth. Comparing the PSNR before and after shows how much of the error is
 * due to the unknown colour calibration of a held-out camera. */
#pragma once

#include "spin.h"

/* Sums over the pixels of a view. x: value in the rendered image, y: value in the ground truth,
 * both 0..1; xx: x squared, and so on. */
struct spin_colour_sums {
    int camera;
    double n;
    struct {
        double x, y, xx, xy, yy;
    } of[3];
};

/* Computes the sums of a view from the rendered image, which this function clamps to 0..1, and the
 * ground truth, both [3][plane]. */
void spin_colour_sums(int camera, size_t plane, const float *image, const float *truth,
                      struct spin_colour_sums *out);
/* Sets psnr [n_views] to the PSNR of each view after the fit, which is common to all views of a
 * camera. Fitted images are not clamped. */
void spin_colour_fit(const struct spin_colour_sums *view, size_t n_views, double *psnr);
