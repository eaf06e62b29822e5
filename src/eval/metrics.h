/* Compares rendered images with the ground truth (docs/method.md section 9). */
#pragma once

#include "spin.h"
#include "eval/dynamic_mask.h"
#include "eval/lpips.h"
#include "eval/matte.h"
#include "render/player.h"

/* The measures of a view, or their means over views. NaN: not measured. */
struct spin_quality {
    bool valid; /* false: nothing was measured */
    /* psnr: PSNR of the mean squared error over all channels. psnr_channel_mean: mean of the PSNRs
     * of the three channels. */
    double psnr, ssim, psnr_channel_mean;
    double psnr_colour_fitted; /* PSNR after the photometric fit (see below) */
    /* PSNR inside and outside the dynamic regions; NaN if a region has fewer than 16 pixels. */
    double psnr_dynamic, psnr_static;
    double dynamic; /* share of dynamic pixels, 0..1 */
    /* PSNR of the image rendered over the opposite background, that is, 1 minus each channel. Lower
     * than psnr if the background is visible through holes between splats. */
    double psnr_opposite;
    double lpips[SPIN_N_LPIPS];
};

struct spin_eval_view {
    /* Number of the frame in the source; camera_id of the view. */
    int frame, camera;
    struct spin_quality q;
};

struct spin_eval_report {
    struct spin_quality mean;
    struct spin_eval_view *view; /* [n_views] */
    size_t n_views;
    int n_frames;        /* number of measured frames */
    int n_bundle_frames; /* number of all frames of the bundle, to which `storage` refers */
    /* trained: the retrained attributes were measured; refined: the refined ones; both false: those
     * of the source. */
    bool trained, refined;
    enum spin_dynamic_from dynamic; /* origin of the masks of dynamic regions; OFF: not measured */
    /* True: psnr_opposite was measured with mattes, that is, with the opposite background only at
     * pixels of known alpha. */
    bool alpha_known;
    /* "masks" or "alpha": only the subject in this mask was measured; NULL: whole images. */
    const char *subject;
    /* Number of splats in all frames that were not rendered since they have non-finite values. */
    uint64_t left_out;
    double seconds_decode;                      /* mean time to decode a frame to splats */
    double seconds_draw;                        /* mean time to render a view of a decoded frame */
    struct spin_bundle_bytes storage, unpacked; /* sizes of the bundle, packed and unpacked */
    /* [n_flicker] flicker of static cameras; NULL: not measured. */
    struct spin_flicker_sums *flicker;
    size_t n_flicker;
};

void spin_eval_report_free(struct spin_eval_report *report);
/* Returns the means over the views of a frame (NULL: all frames) and of a camera (NULL: all
 * cameras). Each measure is averaged over the views in which it was measured. valid is false if
 * there are no views. */
struct spin_quality spin_eval_mean(const struct spin_eval_report *report, const int *frame,
                                   const int *camera);

struct spin_metrics {
    struct spin_player *player;
    const struct spin_clip *clip;
    struct spin_image_cache *pixels;
    const struct spin_pair *pairs; /* sorted by frame */
    size_t n_pairs;
    const float *background; /* [3] */
    bool opposite;           /* true: measure psnr_opposite as well */
    /* Used if `opposite` is true: at pixels of known alpha, the ground truth is composited over the
     * opposite background; other pixels keep the background. NULL: the ground truth is not changed.
     */
    struct spin_mattes *mattes;
    /* [clip->n_frames] number of splats of each frame, for a player of a training in progress;
     * otherwise NULL. */
    const size_t *live_counts;
    struct spin_dynamic_mask *dynamic; /* masks of dynamic regions; NULL: not measured */
    /* Masks of the subject: only the subject is measured, and all other pixels are replaced by the
     * background. NULL: whole images are measured. */
    struct spin_dynamic_mask *subject;
    struct spin_lpips *lpips[SPIN_N_LPIPS]; /* NULL: not measured */
    /* Folder for PNGs with ground truth and rendered image side by side; NULL: write none. */
    const char *images;
    /* If not NULL, the PNGs also show the source, between ground truth and rendered image. */
    struct spin_player *source;
    const char *what; /* text of the progress line */

    /* Results of spin_metrics_run(). */
    struct spin_eval_view *view; /* [n_pairs] receives the measures of each pair; or NULL */
    double seconds_decode;       /* total time to decode frames to splats */
    double seconds_draw;         /* total time to render views */
    int n_decoded;               /* number of decoded frames */
};

/* Measures all pairs and sets *mean to the means over all views. The frames are distributed over
 * the ranks (io/ranks.h), and all ranks receive all results. */
spin_status spin_metrics_run(struct spin_metrics *m, struct spin_quality *mean);

/* Returns the rank that measures a frame. */
int spin_metrics_rank(int frame);

/* Sums of the measures of views, without NaN values. Initialise to zero. */
struct spin_quality_sum {
    struct spin_quality sum;
    size_t n, n_dynamic, n_still, n_share, n_opposite, n_lpips[SPIN_N_LPIPS];
};
void spin_quality_add(struct spin_quality_sum *sum, const struct spin_quality *q);
struct spin_quality spin_quality_mean(const struct spin_quality_sum *sum);

/* Writes a PNG with n images [3][h][w] side by side. */
spin_status spin_write_beside(const char *path, int width, int height, const float *const *picture,
                              int n);

/* ---- Photometric fit ------------------------------------------------------------------------- */

/* Fits a gain and an offset per camera and channel that minimise the error of rendered images. The
 * difference of the PSNR before and after the fit shows how much of the error is due to the unknown
 * colour calibration of a held-out camera. */

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
