/* Masks of the dynamic pixels of a view.
 *
 * Images consist mostly of static background, so a mean over whole images hides the errors of fast
 * motion; evaluation therefore also measures dynamic pixels separately. The masks are the
 * foreground masks of the data set, or are computed from its images: a pixel is dynamic if it
 * differs from the median of the camera's images over time. An object that stays in place for more
 * than half of the clip becomes part of the median, so its pixels count as static. */
#pragma once

#include "spin.h"
#include "scene/clip.h"

struct spin_dynamic_mask {
    const struct spin_views *views;
    struct spin_image_cache *pixels;
    enum spin_dynamic_from from; /* origin of the masks: MASKS, IMAGES or OFF */
    bool alpha;                  /* true: masks are the alpha of the image files */
    struct spin_median *median;  /* [n_medians] medians of the cameras computed so far */
    size_t n_medians;
    float *image;   /* scratch for one image */
    uint8_t *mask;  /* [h][w] mask of the last view, 0 or 1 */
    size_t room;    /* capacity of image and mask in pixels */
    uint8_t **kept; /* [views] stored masks, one bit per pixel; NULL: masks are not stored */
};

/* Opens masks of dynamic pixels for the views of these pairs. If `from` is AUTO, it is replaced by
 * MASKS if all views have foreground masks, otherwise by IMAGES if at least one camera is static
 * and has at least three frames, otherwise by OFF. It is an error if `from` is MASKS or IMAGES and
 * the data set does not meet the condition for it. */
spin_status spin_dynamic_mask_open(const struct spin_views *views, struct spin_image_cache *pixels,
                                   enum spin_dynamic_from from, const struct spin_pair *pairs,
                                   size_t n_pairs, struct spin_dynamic_mask *out);
/* True if the image files of all these views have an alpha channel. */
bool spin_views_have_alpha(const struct spin_views *views, const struct spin_pair *pairs, size_t n);
/* Opens masks of the subject for the views of these pairs: the foreground masks if all views have
 * foreground masks, otherwise the alpha of the image files if all of them have alpha.
 * SPIN_E_NOT_FOUND if neither is the case. */
spin_status spin_subject_mask_open(const struct spin_views *views, struct spin_image_cache *pixels,
                                   const struct spin_pair *pairs, size_t n_pairs,
                                   struct spin_dynamic_mask *out);
void spin_dynamic_mask_close(struct spin_dynamic_mask *m);
/* Enables the storage of masks, one bit per pixel, for callers that request views repeatedly. */
spin_status spin_dynamic_mask_keep(struct spin_dynamic_mask *m);

/* Selects the views of a camera for its median: at most SPIN_MOVING_ROWS, evenly spaced over the
 * clip. Returns the number of views; 0 if the camera moves. */
enum { SPIN_MOVING_ROWS = 25 };
size_t spin_moving_views(const struct spin_views *views, int camera_id,
                         size_t chosen[SPIN_MOVING_ROWS]);

/* Sets m->mask to the mask of a view, in the size of its image. truth: image of the view; NULL:
 * load it if necessary. *n: number of pixels of value 1 in the mask; 0 if the camera has no median.
 */
spin_status spin_dynamic_mask_find(struct spin_dynamic_mask *m, size_t view, const float *truth,
                                   size_t *n);
/* Packs the first n pixels of m->mask into (n + 7) / 8 bytes, lowest bit first. */
void spin_dynamic_mask_bits(const struct spin_dynamic_mask *m, size_t n, uint8_t *bits);

/* Computes a mask [h][w] from an image; exported for tests. A pixel is dynamic if the image truth
 * [3][h][w] differs from median [h][w][3]; specks are then removed, and the mask is dilated by one
 * pixel. scratch is [h][w]. */
void spin_dynamic_mask_rule(int width, int height, const float *truth, const uint8_t *median,
                            uint8_t *scratch, uint8_t *mask);
