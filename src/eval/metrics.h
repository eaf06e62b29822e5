/* Compares rendered images with the ground truth (docs/method.md, section 9). */
#pragma once

#include "eval/lpips.h"
#include "eval/dynamic_mask.h"
#include "eval/matte.h"
#include "render/player.h"

/* The measures of a view, or their means over views. NaN: not measured. */
struct spin_quality {
    bool valid; /* false: nothing was measured */
    /* psnr: from the mean squared error over all channels; psnr_channel_mean: mean of the PSNR of
     * the three channels. */
    double psnr, ssim, psnr_channel_mean;
    double psnr_colour_fitted; /* PSNR after the photometric fit (eval/colour_fit.h) */
    /* PSNR inside and outside the dynamic regions; NaN for fewer than 16 pixels. */
    double psnr_dynamic, psnr_static;
    double dynamic; /* share of dynamic pixels, 0..1 */
    /* PSNR of an image rendered over one minus the background; lower if splats leave holes. */
    double psnr_opposite;
    double lpips[SPIN_N_LPIPS];
};

struct spin_eval_view {
    /* `frame` is the number of the frame in the source, `camera` the camera_id of the view */
    int frame, camera;
    struct spin_quality q;
};

struct spin_eval_report {
    struct spin_quality mean;
    struct spin_eval_view *view; /* [n_views] */
    size_t n_views;
    int n_frames;        /* number of measured frames */
    int n_bundle_frames; /* number of all frames of the bundle, as in storage */
    /* whether retrained or refined attributes were measured; both false: those of the source */
    bool trained, refined;
    enum spin_dynamic_from dynamic; /* origin of the dynamic regions; OFF: not measured */
    bool alpha_known;               /* psnr_opposite compares only pixels of known alpha */
    const char *subject;   /* "masks" or "alpha": only this mask was measured; NULL: whole images */
    uint64_t left_out;     /* number of splats that cannot be rendered, over all frames */
    double seconds_decode; /* mean time to decode a frame to splats */
    double seconds_draw;   /* mean time to render a view of a decoded frame */
    struct spin_bundle_bytes storage, unpacked; /* size of the bundle: packed, unpacked */
    struct spin_flicker_sums *flicker;          /* [n_flicker] static cameras; NULL: not measured */
    size_t n_flicker;
};

void spin_eval_report_free(struct spin_eval_report *report);
/* Means over the views of a frame (NULL: all frames) and a camera (NULL: all cameras). A measure
 * that only some of the views have is the mean over these views. valid is false if there are no
 * views. */
struct spin_quality spin_eval_mean(const struct spin_eval_report *report, const int *frame,
                                   const int *camera);

struct spin_metrics {
    struct spin_player *player;
    const struct spin_clip *clip;
    struct spin_image_cache *pixels;
    const struct spin_pair *pairs; /* sorted by frame */
    size_t n_pairs;
    const float *background; /* [3] */
    bool opposite;           /* true: psnr_opposite is measured too */
    /* With `opposite`, and if there are mattes: only pixels of known alpha change, and the ground
     * truth is composited over the opposite background. */
    struct spin_mattes *mattes;
    /* [clip->n_frames] during training: number of splats of each frame; NULL: not in training. */
    const size_t *live_counts;
    struct spin_dynamic_mask *dynamic; /* dynamic regions; NULL: not measured */
    /* Measure only this mask, with the background everywhere else; NULL: measure whole images. */
    struct spin_dynamic_mask *subject;
    struct spin_lpips *lpips[SPIN_N_LPIPS]; /* NULL: not measured */
    /* Folder for PNGs that show ground truth and rendered image side by side; NULL: none are
     * written. */
    const char *images;
    struct spin_player *source; /* not NULL: the PNGs show the source between these two images */
    const char *what;           /* text of the progress line */

    /* Results. */
    struct spin_eval_view *view; /* [n_pairs], or NULL */
    double seconds_decode;       /* total time to decode frames to splats */
    double seconds_draw;         /* total time to render views */
    int n_decoded;               /* number of decoded frames */
};

/* Measures all pairs and sets *mean to the means over the views. The frames are distributed over
 * the ranks (io/ranks.h); every rank receives the results of all ranks. */
spin_status spin_metrics_run(struct spin_metrics *m, struct spin_quality *mean);

/* The rank that measures a frame. */
int spin_metrics_rank(int frame);

/* Accumulates the measures of views; a NaN is not counted. Initialise to zero. */
struct spin_quality_sum {
    struct spin_quality sum;
    size_t n, n_dynamic, n_still, n_share, n_opposite, n_lpips[SPIN_N_LPIPS];
};
void spin_quality_add(struct spin_quality_sum *sum, const struct spin_quality *q);
struct spin_quality spin_quality_mean(const struct spin_quality_sum *sum);

/* Writes n images [3][h][w] side by side into one PNG. */
spin_status spin_write_beside(const char *path, int width, int height, const float *const *picture,
                              int n);
