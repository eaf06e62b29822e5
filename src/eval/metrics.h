/* Compares rendered images with the ground truth, over views (docs/method.md section 9). */
#pragma once

#include "eval/lpips.h"
#include "eval/dynamic_mask.h"
#include "render/player.h"

/* Means over views; values that were not measured are NaN. */
struct spin_quality {
    bool valid; /* false: nothing was measured */
    double psnr, ssim, psnr_channel_mean;
    /* after a photometric fit: one gain and offset per channel, fitted to the camera's ground
     * truth */
    double psnr_colour_fitted;
    /* inside and outside the dynamic regions; NaN with fewer than 16 such pixels */
    double psnr_dynamic, psnr_static;
    double dynamic; /* share of dynamic pixels */
    /* rendered over one minus the background: lower where splats leave holes */
    double psnr_opposite;
    double lpips[SPIN_N_LPIPS];
};

struct spin_eval_view {
    int frame, camera;     /* the source's frame number, camera_id */
    struct spin_quality q; /* of this view */
};

struct spin_eval_report {
    struct spin_quality mean;
    struct spin_eval_view *view; /* [n_views] */
    size_t n_views;
    int n_frames;
    int n_bundle_frames;            /* all frames of the bundle, measured or not; storage counts all
                                     * of them */
    bool trained, refined;          /* which attributes were measured; neither: the source's */
    enum spin_dynamic_from dynamic; /* where the dynamic regions came from; OFF: not measured */
    /* mask of the subject, if only the subject was measured: "masks" or "alpha"; NULL: whole
     * images */
    const char *subject;
    uint64_t left_out;     /* splats that cannot be rendered, over all frames */
    double seconds_decode; /* per frame: positions and field to splats */
    double seconds_draw;   /* per view of a decoded frame */
    struct spin_bundle_bytes storage, unpacked;
};

void spin_eval_report_free(struct spin_eval_report *report);
/* Means over the views of one frame, of one camera, of both or (NULL, NULL) of all. A value that
 * was measured in some views only is the mean over those. valid is false if there is no such
 * view. */
struct spin_quality spin_eval_mean(const struct spin_eval_report *report, const int *frame,
                                   const int *camera);

struct spin_metrics {
    struct spin_player *player;
    const struct spin_clip *clip;
    struct spin_image_cache *pixels;
    const struct spin_pair *pairs; /* sorted by frame */
    size_t n_pairs;
    const float *background;
    bool opposite; /* also render each view over one minus the background */
    /* field in training: number of splats of each frame; else NULL */
    const size_t *live_counts;
    struct spin_dynamic_mask *dynamic; /* separates dynamic regions, or NULL */
    /* measure only this mask and replace the rest by the background, or NULL */
    struct spin_dynamic_mask *subject;
    struct spin_lpips *lpips[SPIN_N_LPIPS]; /* or NULL */
    const char *images;                     /* folder for PNGs of ground truth | rendered, or
                                             * NULL */
    struct spin_player *source;             /* if set, the PNGs are ground truth | source |
                                             * rendered */
    const char *what;                       /* for the progress line */
    struct spin_eval_view *view;            /* [n_pairs] out, or NULL */
    double seconds_decode;                  /* out: all frames, field or file to splats */
    double seconds_draw;                    /* out: all views */
    int n_decoded;                          /* out: frames */
};

/* Means over the views. The frames are distributed over the ranks (io/ranks.h); view, times and
 * means are those of all ranks. */
spin_status spin_metrics_run(struct spin_metrics *m, struct spin_quality *mean);

/* The rank that measures a frame. */
int spin_metrics_rank(int frame);

/* Accumulates qualities; NaN counts as not measured. Initialise to zero. */
struct spin_quality_sum {
    struct spin_quality sum;
    size_t n, n_dynamic, n_still, n_share, n_opposite, n_lpips[SPIN_N_LPIPS];
};
void spin_quality_add(struct spin_quality_sum *sum, const struct spin_quality *q);
struct spin_quality spin_quality_mean(const struct spin_quality_sum *sum);

/* Writes images [3][h][w] side by side into one PNG. */
spin_status spin_write_beside(const char *path, int width, int height, const float *const *picture,
                              int n);
