/* Masks of the dynamic pixels of a view.
 *
 * A mean over whole images, which are mostly static background, hides how a method handles fast
 * motion. Evaluation therefore reports dynamic pixels separately. The masks are the foreground
 * masks of the data set, or are computed from its images: a pixel is dynamic if it differs from the
 * median over time of the camera's images. An object that does not move for more than half of the
 * clip is part of the median and counts as static, even in the foreground. */
#pragma once

#include "spin.h"
#include "scene/clip.h"

struct spin_dynamic_mask {
    const struct spin_views *views;
    struct spin_image_cache *pixels;
    enum spin_dynamic_from from; /* MASKS, IMAGES or OFF */
    bool alpha;                  /* the mask is the images' alpha; `from` is ignored */
    struct spin_median *median;  /* [n_medians] medians of the cameras used so far */
    size_t n_medians;
    float *image;   /* scratch for one image */
    uint8_t *mask;  /* [h][w] 0 or 1; mask of the last view */
    size_t room;    /* capacity of image and mask in pixels */
    uint8_t **kept; /* [views] computed masks, one bit per pixel; NULL: masks are not stored */
};

/* Opens masks of dynamic pixels for the views of these pairs. from: AUTO selects MASKS if all views
 * have a foreground mask; otherwise IMAGES if at least one camera does not move and has three
 * frames or more; otherwise OFF. MASKS or IMAGES is an error if not available. */
spin_status spin_dynamic_mask_open(const struct spin_views *views, struct spin_image_cache *pixels,
                                   enum spin_dynamic_from from, const struct spin_pair *pairs,
                                   size_t n_pairs, struct spin_dynamic_mask *out);
/* Returns whether the image files of all these views have alpha. */
bool spin_views_have_alpha(const struct spin_views *views, const struct spin_pair *pairs, size_t n);
/* Opens masks of the subject for the views of these pairs: the foreground masks if all views have
 * one; otherwise the alpha of the images if all images have alpha; otherwise an error. */
spin_status spin_subject_mask_open(const struct spin_views *views, struct spin_image_cache *pixels,
                                   const struct spin_pair *pairs, size_t n_pairs,
                                   struct spin_dynamic_mask *out);
void spin_dynamic_mask_close(struct spin_dynamic_mask *m);
/* Makes *m store computed masks, one bit per pixel, for views that are requested repeatedly. */
spin_status spin_dynamic_mask_keep(struct spin_dynamic_mask *m);

/* Selects at most SPIN_MOVING_ROWS views of a camera, evenly spaced over the clip, for its median.
 * Returns their number; 0 if the camera moves. */
enum { SPIN_MOVING_ROWS = 25 };
size_t spin_moving_views(const struct spin_views *views, int camera_id,
                         size_t chosen[SPIN_MOVING_ROWS]);

/* Sets m->mask to the mask of a view, at the size of its camera. truth: the view's image; NULL:
 * load it if needed. *n: number of pixels in the mask; 0 for a camera without a median. */
spin_status spin_dynamic_mask_find(struct spin_dynamic_mask *m, size_t view, const float *truth,
                                   size_t *n);
/* Packs the first n pixels of m->mask into (n + 7) / 8 bytes, lowest bit first. */
void spin_dynamic_mask_bits(const struct spin_dynamic_mask *m, size_t n, uint8_t *bits);

/* Computes the mask from an image; exported for tests. A pixel is dynamic if truth [3][h][w]
 * differs from the median [h][w][3]; specks are removed, and the mask is dilated by one pixel.
 * scratch [h][w]. */
void spin_dynamic_mask_rule(int width, int height, const float *truth, const uint8_t *median,
                            uint8_t *scratch, uint8_t *mask);
