/* Which views an iteration trains on, and their images. */
#pragma once

#include "train/photos.h"
#include "train/step.h"

struct spin_sampler {
    const struct spin_plan *plan;
    struct spin_photos *photos;
    uint32_t *sequence; /* [n_train] pairs in the order of the present epoch; [2 n_train] more to
                           make it */
    int64_t epoch;      /* that sequence belongs to; -1: none */
    uint64_t seed;
    struct spin_image_store images; /* of the pairs, by their view: as many as fit, or a batch */
    struct spin_train_item *items;  /* [batch] of the iteration */
    const struct spin_pair **pairs; /* [batch] the same as frame and view */
};

/* For images on the plan's device; of a frame by itself all are there from now on, as photos are
 * not for two threads at a time. Zero it first; close it also after a failure. */
spin_status spin_sampler_open(struct spin_sampler *sampler, const struct spin_plan *plan,
                              struct spin_photos *photos);
void spin_sampler_close(struct spin_sampler *sampler);
/* The batch of an iteration (from 0), a function of seed and iteration. An epoch's last incomplete
 * batch is dropped. */
spin_status spin_sampler_batch(struct spin_sampler *sampler, int64_t iteration);
