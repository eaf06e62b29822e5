/* Where to look: the part of a view in which something moves fastest, and the worst views. */
#pragma once

#include "eval/metrics.h"

struct spin_crop {
    size_t pair;              /* index into the pairs */
    int x, y, side_x, side_y; /* pixels of the picture */
    double score;
};

/* The `most` best windows of fast motion, best first, at most one of a camera in two frames that
 * follow each other. Fast is what shows in a frame and neither in the one before nor in the one
 * after, so a clip of two frames has no fast windows. *n may be 0. */
spin_status spin_motion_crops_fast(const struct spin_clip *clip, struct spin_image_cache *pixels,
                                   const struct spin_pair *pairs, size_t n_pairs, size_t most,
                                   struct spin_crop *out, size_t *n);

/* The `most` views with the lowest PSNR, one a camera as long as there are cameras. */
size_t spin_motion_crops_worst(const struct spin_eval_view *view, size_t n_views, size_t most,
                               size_t *out);
