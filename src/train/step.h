/* One iteration of a training (docs/method.md sections 3 to 7). loop.c repeats it, and adds data,
 * evaluations and checkpoints. */
#pragma once

#include "train/trainer.h"

/* One image of a batch. */
struct spin_train_item {
    int frame;
    const struct spin_camera *camera;
    int exposure, lens; /* rows of the camera and of its lens in spin_exposures.param */
    uint32_t image;     /* number of the item's image in the image store */
};

struct spin_train_values {
    double loss, l1, ssim; /* means over the images of the batch */
    /* True if at least one splat is visible in at least one view of the batch. */
    bool seen;
    /* [n] set to the loss of each item that this rank renders, other values are left unchanged; or
     * NULL. */
    double *each;
};

/* Returns the rank that renders item `item` of a batch of n. Each rank renders a range of
 * consecutive items, since neighbouring items may show the same frame. */
int spin_step_rank(int item, int n, int n_ranks);

/* Returns a frame's splats as they are rendered, with the values that splats own combined with
 * those of their tracks. The result is valid until the next call or the next iteration. */
struct spin_frame_batch spin_trainer_frame(struct spin_trainer *t, int frame);

/* Runs one iteration: computes the mean loss of the n items (at most max_items) and its gradient,
 * and makes one Adam step. Items that show the same frame share one pass through the network. The
 * host waits for the device only to read the number of intersections of each group of views that
 * are rendered together and, at the end, the losses. Fails only if the rasteriser's lists cannot
 * grow, if the device fails, or if an all-reduce fails. All ranks call it with the same items, and
 * have bit-identical parameters afterwards; each rank needs only the images of the items that it
 * renders. */
spin_status spin_trainer_step(struct spin_trainer *t, const struct spin_images *images,
                              const struct spin_train_item *items, int n,
                              struct spin_train_values *values);
