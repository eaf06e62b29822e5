/* Chooses the views of each iteration and loads their images. */
#pragma once

#include "train/photos.h"
#include "train/step.h"

struct spin_sampler {
    const struct spin_plan *plan;
    struct spin_photos *photos;
    /* [n_train] indices of the plan's training pairs, in the order of this epoch; then scratch of
     * [2 n_train]. */
    uint32_t *sequence;
    int64_t epoch; /* epoch of the current sequence; -1 if there is none yet */
    uint64_t seed;
    /* Images on the device, found by their view. Holds as many as fit, but at least a batch. */
    struct spin_image_store images;
    struct spin_train_item *items;  /* [batch] images of this iteration */
    const struct spin_pair **pairs; /* [batch] frame and view of each item */
};

/* Opens a sampler for the plan's device. The sampler of a single frame loads all its images now,
 * since frames are then trained in parallel and spin_photos is not thread-safe. Zero the sampler
 * first; close it also after a failure. */
spin_status spin_sampler_open(struct spin_sampler *sampler, const struct spin_plan *plan,
                              struct spin_photos *photos);
void spin_sampler_close(struct spin_sampler *sampler);
/* Chooses the views of an iteration, numbered from 0, and loads those of their images that this
 * rank renders. The choice depends only on the seed and the iteration. If the batch size does not
 * divide the number of pairs, the pairs that remain at the end of an epoch are not used in it. */
spin_status spin_sampler_batch(struct spin_sampler *sampler, int64_t iteration);
