/* One iteration of a training (docs/method.md sections 3 to 7). loop.c repeats it, and adds data,
 * evaluations and checkpoints. */
#pragma once

#include "train/trainer.h"

/* One image of a batch. */
struct spin_train_item {
    int frame;
    const struct spin_camera *camera;
    int exposure, lens; /* rows of the camera and of its lens among the exposures */
    uint32_t image;     /* number of the item's image in the store */
};

struct spin_train_values {
    double loss, l1, ssim; /* means over the batch */
    bool seen;             /* a splat is visible in some view */
    double *each; /* NULL, or [n]: receives the losses of the items that this rank renders */
};

/* The rank that renders an item of a batch of n. Neighbouring items, which may show the same frame,
 * have the same rank. */
int spin_step_rank(int item, int n, int n_ranks);

/* A frame's splats as they are rendered: the values that they own combined with those of their
 * tracks. Valid until the next call or iteration. */
struct spin_frame_batch spin_trainer_frame(struct spin_trainer *t, int frame);

/* One iteration: the mean loss of the n items (at most max_items), its gradient, one Adam step.
 * Items of one frame share one pass through the network. The host reads back only the losses, at
 * the end, and the number of intersections of each group of views rendered together. Fails only if
 * the rasteriser's lists cannot grow, or if the device fails. All ranks call it with the same
 * items, and have bit-identical parameters afterwards; each rank needs only the images of its own
 * items. */
spin_status spin_trainer_step(struct spin_trainer *t, const struct spin_images *images,
                              const struct spin_train_item *items, int n,
                              struct spin_train_values *values);
