/* The photometric fit: fits a gain and an offset per camera and channel that minimise the error of
 * rendered images. The difference of the PSNR before and after the fit shows how much of the error
 * is due to the unknown colour calibration of a held-out camera. */
#pragma once

#include "spin.h"

/* Sums over the n pixels of a view, for each channel, of values in 0..1. x: sum of the values of
 * the rendered image; y: sum of the values of the ground truth; xx, xy, yy: sums of the products of
 * these values. */
struct spin_colour_sums {
    int camera;
    double n;
    struct {
        double x, y, xx, xy, yy;
    } of[3];
};

/* Computes the sums of a view from the rendered image and the ground truth, both [3][plane]. Values
 * of the rendered image are clamped to 0..1. */
void spin_colour_sums(int camera, size_t plane, const float *image, const float *truth,
                      struct spin_colour_sums *out);
/* Fits all views of each camera together, and sets psnr [n_views] to the PSNR of each view after
 * the fit. Fitted images are not clamped. */
void spin_colour_fit(const struct spin_colour_sums *view, size_t n_views, double *psnr);
