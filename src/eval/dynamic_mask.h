/* Masks of the dynamic pixels of a view.
 *
 * A mean over a static background hides how a method handles fast motion, so evaluation reports
 * these pixels separately. They come from the data set's foreground masks, or from its images: a
 * pixel is dynamic if it differs from the median of its camera over time. Anything that does not
 * move for more than half of the clip is part of the median and counts as static, foreground or
 * not. */
#pragma once

#include "spin.h"
#include "scene/clip.h"

struct spin_dynamic_mask {
    const struct spin_views *views;
    struct spin_image_cache *pixels;
    enum spin_dynamic_from from; /* MASKS, IMAGES or OFF */
    bool alpha;                  /* instead of `from`: the mask is where the images' alpha is
                                  * opaque */
    struct spin_median *median;  /* [n_medians] medians of the cameras used so far */
    size_t n_medians;
    float *image;   /* scratch for one image */
    uint8_t *mask;  /* [h][w] 0 or 1, of the last view */
    size_t room;    /* capacity of image and mask, in pixels */
    uint8_t **kept; /* [views] masks computed so far, one bit per pixel; NULL: masks are not kept */
};

/* AUTO becomes MASKS if all of these views have one; else IMAGES if at least one camera does not
 * move and has three frames or more; else OFF. Requesting a source that is not available is an
 * error. */
spin_status spin_dynamic_mask_open(const struct spin_views *views, struct spin_image_cache *pixels,
                                   enum spin_dynamic_from from, const struct spin_pair *pairs,
                                   size_t n_pairs, struct spin_dynamic_mask *out);
/* Mask of the subject: foreground masks if all of these views have one; else the alpha of all their
 * images; else an error. */
spin_status spin_subject_mask_open(const struct spin_views *views, struct spin_image_cache *pixels,
                                   const struct spin_pair *pairs, size_t n_pairs,
                                   struct spin_dynamic_mask *out);
void spin_dynamic_mask_close(struct spin_dynamic_mask *m);
/* Keep computed masks for views that are requested repeatedly: one bit per pixel. */
spin_status spin_dynamic_mask_keep(struct spin_dynamic_mask *m);

/* Selects at most SPIN_MOVING_ROWS views for the median of a camera; returns their number, 0 if the
 * camera moves. */
enum { SPIN_MOVING_ROWS = 25 };
size_t spin_moving_views(const struct spin_views *views, int camera_id,
                         size_t chosen[SPIN_MOVING_ROWS]);

/* Sets m->mask, at the size of the view's camera. truth is the view's image (NULL: it is loaded if
 * needed). *n = number of dynamic pixels; a camera without a median has none. */
spin_status spin_dynamic_mask_find(struct spin_dynamic_mask *m, size_t view, const float *truth,
                                   size_t *n);
/* The first n pixels of m->mask as bits, lowest first: (n + 7) / 8 bytes. */
void spin_dynamic_mask_bits(const struct spin_dynamic_mask *m, size_t n, uint8_t *bits);

/* The rule itself, for tests: pixels of truth [3][h][w] that differ from the median [h][w][3],
 * without specks, dilated by one pixel. scratch [h][w]. */
void spin_dynamic_mask_rule(int width, int height, const float *truth, const uint8_t *median,
                            uint8_t *scratch, uint8_t *mask);
