/* Selects the images of a report: crops with the fastest motion, and the worst views. */
#pragma once

#include "eval/metrics.h"

struct spin_crop {
    size_t pair;              /* index into the list of pairs */
    int x, y, side_x, side_y; /* top left corner and size, pixels */
    double score;
};

/* Finds at most `most` crops with the fastest motion, fastest first. Motion is fast if an object is
 * visible at a place in one frame, but neither in the previous nor in the next frame; a clip of two
 * frames therefore has no such crops. Two crops of one camera are at least two frames apart. *n:
 * number of crops found, may be 0. */
spin_status spin_motion_crops_fast(const struct spin_clip *clip, struct spin_image_cache *pixels,
                                   const struct spin_pair *pairs, size_t n_pairs, size_t most,
                                   struct spin_crop *out, size_t *n);

/* Finds at most `most` views with the lowest PSNR: first one view per camera, then further views of
 * any camera. Returns their number. */
size_t spin_motion_crops_worst(const struct spin_eval_view *view, size_t n_views, size_t most,
                               size_t *out);
