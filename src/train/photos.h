/* The images that a run learns from and is measured on: decoded once and kept as far as memory
 * goes, with masks of the pixels that count differently. Not for two threads at a time. */
#pragma once

#include "eval/dynamic_mask.h"
#include "render/image_store.h"
#include "train/plan.h"

struct spin_photos {
    struct spin_image_cache cache;
    struct spin_dynamic_mask
        dynamic;       /* pixels that count differently, where the plan is weighted */
    uint8_t *image;    /* scratch [max pixels][3]; then a mask, a bit a pixel */
    uint64_t *imprint; /* [views] what those that are learned from are told by */
};

/* Zero it first; close it also after a failure. */
spin_status spin_photos_open(struct spin_photos *photos, const struct spin_plan *plan);
void spin_photos_close(struct spin_photos *photos);
/* Look at every image that the run will need, without decoding it, and take the imprints of those
 * that it learns from. So a run does not end hours later at an image that is missing or cut short.
 */
spin_status spin_photos_look(struct spin_photos *photos, const struct spin_plan *plan);
/* What a frame is learned from, as a number: images, masks and cameras. It tells whether kept work
 * was made from the same. frame -1: all frames. */
uint64_t spin_photos_imprint(const struct spin_photos *photos, const struct spin_plan *plan,
                             int frame);
/* Room for n of the images on a device, with the weights of their pixels. */
spin_status spin_photos_open_store(const struct spin_plan *plan, struct spin_device *device,
                                   size_t n, struct spin_image_store *store);
/* Image `number` of a store = that of a view, with its mask. */
spin_status spin_photos_put(struct spin_photos *photos, const struct spin_plan *plan, size_t view,
                            struct spin_image_store *store, uint32_t number);
