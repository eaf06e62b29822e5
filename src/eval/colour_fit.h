/* The photometric fit: the error that remains in a camera's images after fitting one gain and one
 * offset per channel to the ground truth. It shows how much of the error is the unknown colour
 * calibration of a camera that was not trained on. */
#pragma once

#include "spin.h"

/* Sums over the pixels of a view, of the values x of the rendered image and y of the ground truth,
 * 0..1. */
struct spin_colour_sums {
    int camera;
    double n;
    struct {
        double x, y, xx, xy, yy;
    } of[3];
};

/* image (rendered), truth (captured): [3][plane]; image is clamped to 0..1. */
void spin_colour_sums(int camera, size_t plane, const float *image, const float *truth,
                      struct spin_colour_sums *out);
/* The PSNR of each view [n_views] after fitting all views of its camera together. Fitted images are
 * not clamped. */
void spin_colour_fit(const struct spin_colour_sums *view, size_t n_views, double *psnr);
