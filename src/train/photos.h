/* The images that a run trains on and is measured with: decoded once and cached as far as memory
 * allows, with masks of dynamic pixels. Not thread-safe. */
#pragma once

#include "eval/dynamic_mask.h"
#include "render/image_store.h"
#include "train/plan.h"

struct spin_photos {
    struct spin_image_cache cache;
    struct spin_dynamic_mask dynamic; /* dynamic pixels, if the plan weights them */
    uint8_t *image;                   /* scratch [max pixels][3], then a mask of one bit a pixel */
    uint64_t *imprint;                /* [views] digests of training images */
};

/* Zero it first; close it also after a failure. */
spin_status spin_photos_open(struct spin_photos *photos, const struct spin_plan *plan);
void spin_photos_close(struct spin_photos *photos);
/* Checks every image that the run will need without decoding it, so that a missing or truncated
 * image is found now and not hours later. Computes the digests of training images. */
spin_status spin_photos_look(struct spin_photos *photos, const struct spin_plan *plan);
/* Digest of the images, masks and cameras that a frame is trained on, which decides whether earlier
 * work can be reused. frame -1: digest of all frames. */
uint64_t spin_photos_imprint(const struct spin_photos *photos, const struct spin_plan *plan,
                             int frame);
/* Reserves device memory for n images and their masks. */
spin_status spin_photos_open_store(const struct spin_plan *plan, struct spin_device *device,
                                   size_t n, struct spin_image_store *store);
/* Copies the image of a view, with its mask, into a store as image `number`. */
spin_status spin_photos_put(struct spin_photos *photos, const struct spin_plan *plan, size_t view,
                            struct spin_image_store *store, uint32_t number);
