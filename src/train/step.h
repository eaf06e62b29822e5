/* One training step of the network (docs/method.md sections 3 to 7). The loop around it - data,
 * schedule of views, evaluation, checkpoints - is loop.c. */
#pragma once

#include "train/trainer.h"

/* One picture of a batch. */
struct spin_train_item {
    int frame;
    const struct spin_camera *camera;
    int exposure, lens; /* rows of the camera and of its lens among the exposures */
    uint32_t image;     /* number of its photograph */
};

struct spin_train_values {
    double loss, l1, ssim; /* means over the batch */
    bool seen;             /* some view shows a splat */
    double *each;          /* [n] losses of the items that this rank draws, when not NULL */
};

/* The rank that draws an item of a batch of n: neighbours stay together, as they may show one
 * frame. */
int spin_step_rank(int item, int n, int n_ranks);

/* The frame's splats as they are drawn: their own values with those of their tracks. Good until the
 * next call, or the next step. */
struct spin_frame_batch spin_trainer_frame(struct spin_trainer *t, int frame);

/* One iteration: the mean loss of the n items (at most max_items), its gradient, one Adam step.
 * Items of one frame share one pass through the network. The host reads back the losses, once, at
 * the end, and the number of intersections of the views that are drawn together. Fails only when
 * the rasteriser's lists cannot grow, or the device failed. Ranks call it with the same items, and
 * have the same bits afterwards; images are needed of the rank's own. */
spin_status spin_trainer_step(struct spin_trainer *t, const struct spin_images *images,
                              const struct spin_train_item *items, int n,
                              struct spin_train_values *values);
