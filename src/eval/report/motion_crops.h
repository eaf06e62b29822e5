/* Selects the images of a report: crops with the fastest motion, and the views with the lowest
 * PSNR. */
#pragma once

#include "eval/metrics.h"

struct spin_crop {
    size_t pair;              /* index in the list of pairs */
    int x, y, side_x, side_y; /* top left corner and size, in pixels */
    double score;
};

/* Finds at most `most` crops with the fastest motion, fastest first, and sets *n to their number,
 * which may be 0. Motion is fast if an object covers pixels in one frame, but neither in the
 * previous nor in the next frame; a clip of two frames therefore has no such crops. Crops of the
 * same camera are at least two frames apart. */
spin_status spin_motion_crops_fast(const struct spin_clip *clip, struct spin_image_cache *pixels,
                                   const struct spin_pair *pairs, size_t n_pairs, size_t most,
                                   struct spin_crop *out, size_t *n);

/* Finds at most `most` views with the lowest PSNR, except views without one, sets out [most] to
 * their indices and returns their number: first the worst view of each camera, then further views
 * of any camera. */
size_t spin_motion_crops_worst(const struct spin_eval_view *view, size_t n_views, size_t most,
                               size_t *out);
