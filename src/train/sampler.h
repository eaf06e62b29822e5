/* Chooses the views of each iteration and loads their images. */
#pragma once

#include "train/photos.h"
#include "train/step.h"

struct spin_sampler {
    const struct spin_plan *plan;
    struct spin_photos *photos;
    /* [n_train] pairs in the order of this epoch, then [2 n_train] scratch. */
    uint32_t *sequence;
    int64_t epoch; /* epoch of the sequence; -1: none yet */
    uint64_t seed;
    struct spin_image_store images; /* found by view; as many as fit, at least a batch */
    struct spin_train_item *items;  /* [batch] views of this iteration */
    const struct spin_pair **pairs; /* [batch] their frames and views */
};

/* Opens a sampler for the plan's device. For a single frame it loads all images now, since
 * spin_photos is not thread-safe. Zero it first; close it also after a failure. */
spin_status spin_sampler_open(struct spin_sampler *sampler, const struct spin_plan *plan,
                              struct spin_photos *photos);
void spin_sampler_close(struct spin_sampler *sampler);
/* Prepares the batch of an iteration (from 0), which depends only on the seed and the iteration.
 * The incomplete last batch of an epoch is dropped. */
spin_status spin_sampler_batch(struct spin_sampler *sampler, int64_t iteration);
