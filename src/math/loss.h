/* Functions of losses and metrics: the derivative of L1, the SSIM of one pixel with its derivatives
 * (docs/method.md 5), and PSNR (docs/method.md 9). */
#pragma once

#include <stddef.h>
#include <stdint.h>

#include "math/portable.h"

#define SPIN_SSIM_HALF 5 /* the window is 11 x 11 pixels, Gaussian with sigma 1.5, zero-padded */
#define SPIN_SSIM_C1 1e-4f
#define SPIN_SSIM_C2 9e-4f

/* The weights of the window along one axis at distance k = 0..5 from the centre: exp(-k^2 / 4.5),
 * normalised so that all 11 weights (k = -5..5) sum to 1. */
#define SPIN_SSIM_WINDOW                                                                           \
    {                                                                                              \
        0.26601172486f, 0.21300553771f, 0.10936068951f, 0.03600077213f, 0.00759875814f,            \
            0.00102838008f                                                                         \
    }

/* Transmittance of a pixel of an input image: the share of the background that is visible through
 * the pixel when backgrounds are replaced. matte: 1 + 254 alpha of the pixel, or 0 if its alpha is
 * unknown (device.h). A pixel of unknown alpha has a transmittance of 0 and so keeps its own
 * background. */
SPIN_FN float spin_matte_transmittance(uint8_t matte)
{
    return matte ? (float)(255 - matte) / 254.0f : 0;
}

/* Derivatives of the SSIM map at a pixel with respect to the windowed means of x, x^2 and x y. */
struct spin_ssim_slope {
    float d_mu, d_xx, d_xy;
};

/* SSIM at a pixel of images x and y. mu_x, mu_y: windowed means of x and y; mean_squares: windowed
 * mean of x^2 + y^2, since only the sum of the two variances is needed; mean_xy: windowed mean of x
 * y. The sum of the variances is clamped to at least zero: rounding can make it negative, and for
 * flat images far outside 0..1 the denominator could become zero. */
SPIN_FN float spin_ssim(float mu_x, float mu_y, float mean_squares, float mean_xy,
                        struct spin_ssim_slope *slope)
{
    float squares = mu_x * mu_x + mu_y * mu_y;
    float a1 = 2 * mu_x * mu_y + SPIN_SSIM_C1;
    float a2 = 2 * (mean_xy - mu_x * mu_y) + SPIN_SSIM_C2;
    float b1 = squares + SPIN_SSIM_C1;
    float b2 = spin_maxf(mean_squares - squares, 0) + SPIN_SSIM_C2;
    float i1 = 1 / b1, i2 = 1 / b2;
    float s = a1 * a2 * i1 * i2;

    slope->d_mu = 2 * mu_y * (a2 - a1) * i1 * i2 - 2 * mu_x * s * (i1 - i2);
    slope->d_xx = -s * i2;
    slope->d_xy = 2 * a1 * i1 * i2;
    return s;
}

/* Derivative of |v|; 0 at 0. */
SPIN_FN float spin_sign(float v) { return (float)(v > 0) - (float)(v < 0); }

/* PSNR in decibels from the mean squared error of images in 0..1; infinity for equal images. */
SPIN_FN double spin_psnr(double mse) { return -10 * log10(mse); }

/* Sum of the squared differences of n values. */
SPIN_FN double spin_squares(const float *image, const float *truth, size_t n)
{
    double sum = 0;

    for (size_t i = 0; i < n; i++) {
        float d = image[i] - truth[i];
        sum += (double)d * d;
    }
    return sum;
}
