/* Selects what a report shows: the crops with the fastest motion, and the worst views. */
#pragma once

#include "eval/metrics.h"

struct spin_crop {
    size_t pair;              /* index into the pairs */
    int x, y, side_x, side_y; /* pixels */
    double score;
};

/* The `most` best crops of fast motion, best first; the same camera is not used in the same or
 * adjacent frames twice. Fast means visible in a frame but neither in the previous nor in the next
 * one, so a clip of two frames has no such crops. *n may be 0. */
spin_status spin_motion_crops_fast(const struct spin_clip *clip, struct spin_image_cache *pixels,
                                   const struct spin_pair *pairs, size_t n_pairs, size_t most,
                                   struct spin_crop *out, size_t *n);

/* The `most` views with the lowest PSNR, of different cameras as long as there are any. Returns
 * their number. */
size_t spin_motion_crops_worst(const struct spin_eval_view *view, size_t n_views, size_t most,
                               size_t *out);
