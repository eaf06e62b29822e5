/* One training step of the network (docs/method.md sections 3 to 7). The loop around it - data, schedule of views,
 * evaluation, checkpoints - is loop.c. */
#ifndef SPIN_TRAIN_STEP_H
#define SPIN_TRAIN_STEP_H

#include "train/step_parts.h"

struct spin_train_values {
    double loss, l1, ssim; /* means over the batch */
    bool seen;             /* some view shows a splat */
    double *each;          /* [n] losses, when not NULL */
};

/* The rank that draws an item of a batch; counts: splats of the frames. */
int spin_trainer_rank(const struct spin_train_item *items, int item, const size_t *counts);

/* One iteration: the mean loss of the n items (at most max_items), its gradient, one Adam step. Items of one
 * frame share one pass through the network. The host reads back the losses, once, at the end, and the number
 * of intersections of the views that are drawn together. Fails only when the rasteriser's lists cannot grow,
 * or the device failed. Ranks call it with the same items; images are needed of the rank's own. */
spin_status spin_trainer_step(struct spin_trainer *t, const struct spin_images *images,
                              const struct spin_train_item *items, int n,
                              struct spin_train_values *values);

#endif
