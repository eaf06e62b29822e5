/* Measures how steady the renders of a clip are in time (docs/method.md, section 9).
 *
 * PSNR and SSIM compare single images, so they cannot tell a splat that is slightly wrong in every
 * frame from one that is wrong in a different way in each frame, which a viewer sees as flicker.
 * Flicker is the mean absolute difference between successive renders from a static camera where
 * the images of the data set are static. These images flicker too, from sensor noise and from
 * lamps, so the same mean is computed for them. */
#pragma once

#include "eval/metrics.h"

/* Sums over the pixels and channels of one camera. Differences are in 1/255 of full range. */
struct spin_flicker_sums {
    int camera;            /* camera_id */
    size_t n_static;       /* number of static samples: pixels times channels times frame pairs */
    size_t n_dynamic;      /* number of dynamic samples */
    double render, images; /* static samples: |R(t+1) - R(t)| and |I(t+1) - I(t)| */
    double dynamic_error;  /* dynamic samples: |(R(t+1) - R(t)) - (I(t+1) - I(t))| */
};

/* Means of these sums, in 1/255; NaN if there are no samples. */
struct spin_flicker {
    double render, images, dynamic_error;
};
struct spin_flicker spin_flicker_mean(const struct spin_flicker_sums *sums, size_t n);

/* One image row of one camera in every frame, as an image whose vertical axis is time: static
 * content makes vertical lines, flicker makes horizontal ones. */
struct spin_flicker_strip {
    int camera, row; /* camera_id, row of its images */
    int width, n_frames;
    float *images, *render; /* [3][n_frames][width] */
};
void spin_flicker_strip_free(struct spin_flicker_strip *strip);

/* Measures all static cameras among m->pairs. Reads m->player, clip, pixels, pairs, background and
 * dynamic, and renders every view once more. *sums [*n], in the order of the first views, must be
 * freed by the caller; the ranks share the cameras, and all of them receive the sums. strip: if not
 * NULL, receives the row with the most dynamic pixels of the first static camera (rank 0 only).
 * SPIN_E_UNSUPPORTED if no camera is static in two successive frames. */
spin_status spin_flicker_run(const struct spin_metrics *m, struct spin_flicker_sums **sums,
                             size_t *n, struct spin_flicker_strip *strip);
