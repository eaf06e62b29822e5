/* Measures the flicker of the renders of a clip (docs/method.md section 9).
 *
 * PSNR and SSIM compare single images, so they do not distinguish an error that is the same in all
 * frames from an error that differs from frame to frame, which is visible as flicker. Flicker is
 * the mean absolute difference between successive renders from a static camera, over the pixels
 * that are static in the images of the data set. Since these images also flicker, because of sensor
 * noise and lamps, the same mean is computed for them. */
#pragma once

#include "eval/metrics.h"

/* Sums over the pixels, channels and frames of one camera. With R(t) the render and I(t) the image
 * of frame t, a sample is one channel of one pixel in two successive frames. Differences are in
 * units of 1/255. */
struct spin_flicker_sums {
    int camera;            /* camera_id */
    size_t n_static;       /* number of samples whose pixel is static in both frames */
    size_t n_dynamic;      /* number of all other samples */
    double render, images; /* sums over static samples of |R(t+1) - R(t)| and |I(t+1) - I(t)| */
    double dynamic_error;  /* sum over dynamic samples of |(R(t+1) - R(t)) - (I(t+1) - I(t))| */
};

/* Means of these sums over the samples of n cameras, in units of 1/255; NaN if there are no
 * samples. */
struct spin_flicker {
    double render, images, dynamic_error;
};
struct spin_flicker spin_flicker_mean(const struct spin_flicker_sums *sums, size_t n);

/* One pixel row of the images of a camera, in all frames, as an image whose vertical axis is time:
 * static content appears as vertical lines, flicker as horizontal lines. */
struct spin_flicker_strip {
    int camera, row; /* camera_id, and row of its images */
    int width, n_frames;
    float *images, *render; /* [3][n_frames][width] */
};
void spin_flicker_strip_free(struct spin_flicker_strip *strip);

/* Measures all static cameras among m->pairs, and renders all their views for this. Uses only the
 * members player, clip, pixels, pairs, n_pairs, background and dynamic of *m. Sets *sums [*n],
 * which the caller frees, to the sums of the static cameras, in the order of their first views. The
 * cameras are distributed over the ranks, and all ranks receive all sums. strip: NULL, or receives,
 * on rank 0 only, the row with the most dynamic pixels of the first static camera.
 * SPIN_E_UNSUPPORTED if no camera is static in two successive frames. */
spin_status spin_flicker_run(const struct spin_metrics *m, struct spin_flicker_sums **sums,
                             size_t *n, struct spin_flicker_strip *strip);
