/* What is left of the error of a camera's pictures when one gain and one offset a channel are
 * fitted to its photographs afterwards. It tells how much of the error is the colour of a camera
 * that nothing was learned of. */
#pragma once

#include "spin.h"

/* Sums over the pixels of a view, of the values x of the picture and y of the photograph, from 0
 * to 1. */
struct spin_colour_sums {
    int camera;
    double n;
    struct {
        double x, y, xx, xy, yy;
    } of[3];
};

/* image, photo: [3][plane]; image is clamped to 0..1. */
void spin_colour_sums(int camera, size_t plane, const float *image, const float *photo,
                      struct spin_colour_sums *out);
/* The PSNR of each view [n_views], after the fit to all views of its camera. Fitted pictures are
 * not clamped. */
void spin_colour_fit(const struct spin_colour_sums *view, size_t n_views, double *psnr);
