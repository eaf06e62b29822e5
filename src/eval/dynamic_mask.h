/* Which pixels of a view show something that moves.
 *
 * A mean over a static background hides what fast motion does to a method, so evaluation looks at
 * these pixels apart. They come from the data set's foreground masks, or from its images: a pixel
 * moves when it differs from the median of its camera over time. What stands still for more than
 * half of the clip is part of the median and counts as still, foreground or not. */
#pragma once

#include "spin.h"
#include "scene/clip.h"

struct spin_dynamic_mask {
    const struct spin_views *views;
    struct spin_image_cache *pixels;
    enum spin_dynamic_from from; /* MASKS, IMAGES or OFF */
    bool alpha;                  /* instead: what the images' alpha shows */
    struct spin_median *median;  /* [n_medians] of the cameras met so far */
    size_t n_medians;
    float *image;   /* scratch of one picture */
    uint8_t *mask;  /* [h][w] 0 or 1, of the view last asked for */
    size_t room;    /* pixels there is room for */
    uint8_t **kept; /* [views] masks met so far, a bit a pixel; NULL: none are kept */
};

/* AUTO becomes MASKS when all of these views have one, else IMAGES when some camera stands still
 * and has three frames or more, else OFF. Asking for what is not there is an error. */
spin_status spin_dynamic_mask_open(const struct spin_views *views, struct spin_image_cache *pixels,
                                   enum spin_dynamic_from from, const struct spin_pair *pairs,
                                   size_t n_pairs, struct spin_dynamic_mask *out);
/* The subject: by masks where all of these views have one, else by the alpha of all their images;
 * else an error. */
spin_status spin_subject_mask_open(const struct spin_views *views, struct spin_image_cache *pixels,
                                   const struct spin_pair *pairs, size_t n_pairs,
                                   struct spin_dynamic_mask *out);
void spin_dynamic_mask_close(struct spin_dynamic_mask *m);
/* Keep what is found, for views that are asked for again and again: a bit a pixel. */
spin_status spin_dynamic_mask_keep(struct spin_dynamic_mask *m);

/* Views, at most SPIN_MOVING_ROWS, that the median of a camera is taken of; how many. */
enum { SPIN_MOVING_ROWS = 25 };
size_t spin_moving_views(const struct spin_views *views, int camera_id,
                         size_t chosen[SPIN_MOVING_ROWS]);

/* Sets m->mask, at the size of the view's camera; truth is the view's picture (NULL: it is loaded
 * when it is needed). *n: moving pixels. A camera without a median has none. */
spin_status spin_dynamic_mask_find(struct spin_dynamic_mask *m, size_t view, const float *truth,
                                   size_t *n);
/* The first n pixels of m->mask as bits, lowest first: (n + 7) / 8 bytes. */
void spin_dynamic_mask_bits(const struct spin_dynamic_mask *m, size_t n, uint8_t *bits);

/* The rule itself, for tests: changed pixels of truth [3][h][w] against the median [h][w][3], less
 * specks, grown by one. scratch [h][w]. */
void spin_dynamic_mask_rule(int width, int height, const float *truth, const uint8_t *median,
                            uint8_t *scratch, uint8_t *mask);
