/* PSNR and SSIM of a player's pictures over views (method.md section 8). */
#ifndef SPIN_CORE_MEASURE_H
#define SPIN_CORE_MEASURE_H

#include "core/player.h"

struct spin_measure {
    struct spin_player *player;
    const struct spin_clip *clip;
    struct spin_pixels *pixels;
    const struct spin_pair *pairs; /* sorted by frame */
    size_t n_pairs;
    const float *background;
    const size_t *live_counts;   /* live player: splats of each frame, else NULL */
    const char *images;          /* folder for "truth | picture" PNGs, or NULL */
    struct spin_player *source;  /* "truth | source | picture" then; or NULL */
    const char *what;            /* for the progress line */
    struct spin_eval_view *view; /* [n_pairs] out, or NULL */
    double seconds;              /* out: decoding and drawing, all views */
};

/* Means over the views. */
spin_status spin_measure_run(struct spin_measure *m, struct spin_quality *mean);

/* Pictures side by side into one PNG; every picture is [3][h][w]. */
spin_status spin_write_beside(const char *path, int width, int height, const float *const *picture,
                              int n);

#endif
