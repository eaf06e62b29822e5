/* The training and test images of a run, with masks of dynamic pixels. Decoded images are cached as
 * far as memory allows. Not thread-safe. */
#pragma once

#include "eval/dynamic_mask.h"
#include "render/image_store.h"
#include "train/plan.h"

struct spin_photos {
    struct spin_image_cache cache;
    /* Masks of dynamic pixels; used only if these have another weight (spin_plan_is_weighted()). */
    struct spin_dynamic_mask dynamic;
    /* Scratch: an image [max pixels][3], followed by a mask of one bit per pixel. */
    uint8_t *image;
    uint64_t *digest; /* [views] digest of each training image */
};

/* Zero it first; close it also after a failure. */
spin_status spin_photos_open(struct spin_photos *photos, const struct spin_plan *plan);
void spin_photos_close(struct spin_photos *photos);
/* Checks every image that the run will need, without decoding it, so that a missing or truncated
 * image is reported before the training starts. Computes the digests of the training images. */
spin_status spin_photos_check_images(struct spin_photos *photos, const struct spin_plan *plan);
/* Returns a digest of the images, masks and cameras that a frame is trained on or, with frame -1,
 * of those of all frames. Results of an earlier run are reused only if it had the same digest. */
uint64_t spin_photos_digest(const struct spin_photos *photos, const struct spin_plan *plan,
                            int frame);
/* Reserves device memory for n images and their masks. */
spin_status spin_photos_open_store(const struct spin_plan *plan, struct spin_device *device,
                                   size_t n, struct spin_image_store *store);
/* Copies the image of a view, with its mask, into a store as image `number`. */
spin_status spin_photos_put(struct spin_photos *photos, const struct spin_plan *plan, size_t view,
                            struct spin_image_store *store, uint32_t number);
