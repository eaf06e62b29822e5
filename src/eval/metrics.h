/* How close drawn pictures come to the photographs, over views (docs/method.md section 9). */
#pragma once

#include "eval/lpips.h"
#include "eval/dynamic_mask.h"
#include "render/player.h"

/* Means over views; what was not measured is NaN. */
struct spin_quality {
    bool valid; /* else nothing of it was measured */
    double psnr, ssim, psnr_channel_mean;
    double psnr_colour_fitted; /* after one gain and offset a channel were fitted to the camera's
                                  photographs */
    double psnr_dynamic,
        psnr_static;      /* in and outside the dynamic regions, of views that have both */
    double dynamic;       /* share of the pixels */
    double psnr_opposite; /* drawn over one minus the background: lower where splats leave holes */
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
    int n_bundle_frames;            /* storage is of these, whichever were measured */
    bool trained, refined;          /* what was measured; neither: the source */
    enum spin_dynamic_from dynamic; /* where the dynamic regions came from; OFF: nowhere */
    const char *subject; /* what was measured alone: by "masks" or "alpha"; NULL: whole pictures */
    uint64_t left_out;   /* splats that cannot be drawn, over all frames */
    double seconds_decode; /* one frame: positions and network to splats */
    double seconds_draw;   /* one view of a decoded frame */
    struct spin_bundle_bytes storage, unpacked;
};

void spin_eval_report_free(struct spin_eval_report *report);
/* Means over the views of one frame, of one camera, of both or (NULL, NULL) of all. What was
 * measured in some views only is the mean over these. valid is false when there is no such view. */
struct spin_quality spin_eval_mean(const struct spin_eval_report *report, const int *frame,
                                   const int *camera);

struct spin_metrics {
    struct spin_player *player;
    const struct spin_clip *clip;
    struct spin_image_cache *pixels;
    const struct spin_pair *pairs; /* sorted by frame */
    size_t n_pairs;
    const float *background;
    bool opposite;                     /* draw each view over one minus the background as well */
    const size_t *live_counts;         /* network in training: splats of each frame; else NULL */
    struct spin_dynamic_mask *dynamic; /* moving regions apart, or NULL */
    struct spin_dynamic_mask
        *subject; /* what is measured alone, the rest becomes background; or NULL */
    struct spin_lpips *lpips[SPIN_N_LPIPS]; /* or NULL */
    const char *images;                     /* folder for "truth | picture" PNGs, or NULL */
    struct spin_player *source;             /* "truth | source | picture" then; or NULL */
    const char *what;                       /* for the progress line */
    struct spin_eval_view *view;            /* [n_pairs] out, or NULL */
    double seconds_decode;                  /* out: all frames, network or file to splats */
    double seconds_draw;                    /* out: all views */
    int n_decoded;                          /* out: frames */
};

/* Means over the views. Ranks (io/ranks.h) share the frames; view, times and means are of all. */
spin_status spin_metrics_run(struct spin_metrics *m, struct spin_quality *mean);

/* Who measures a frame. */
int spin_metrics_rank(int frame);

/* Means of qualities; NaN counts as not measured. Zero it to begin. */
struct spin_quality_sum {
    struct spin_quality sum;
    size_t n, n_dynamic, n_still, n_share, n_opposite, n_lpips[SPIN_N_LPIPS];
};
void spin_quality_add(struct spin_quality_sum *sum, const struct spin_quality *q);
struct spin_quality spin_quality_mean(const struct spin_quality_sum *sum);

/* Pictures side by side into one PNG; every picture is [3][h][w]. */
spin_status spin_write_beside(const char *path, int width, int height, const float *const *picture,
                              int n);
