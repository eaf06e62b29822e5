/* What the one-rank step (step.c) and the step of several ranks (step_ranks.c) have in common. */
#ifndef SPIN_TRAIN_STEP_PARTS_H
#define SPIN_TRAIN_STEP_PARTS_H

#include "train/trainer.h"

/* One picture of a batch. */
struct spin_train_item {
    int frame;
    const struct spin_camera *camera;
    int exposure, lens; /* rows of the camera and of its lens among the exposures */
    uint32_t image;     /* number of its photograph */
};

struct spin_step_batch {
    const struct spin_images *images;
    const struct spin_train_item *items;
    int n;
};

/* The frames of these items: first[f] is the first item that shows frame f of the batch. */
struct spin_frame_batch spin_step_frames(struct spin_trainer *t, const struct spin_step_batch *b,
                                         const int *first, int n);
/* What the frames' splats have from their tracks. */
void spin_step_add_tracks(struct spin_trainer *t, const struct spin_frame_batch *frames);
/* Zero gradients, all views of the frames, and their gradients in d_attr and d_means. */
spin_status spin_step_draw(struct spin_trainer *t, const struct spin_step_batch *b,
                           const int *first, struct spin_frame_batch *frames);
/* The tracks' gradients from those of the frames' splats. */
void spin_step_tracks_back(struct spin_trainer *t, const struct spin_frame_batch *frames);
/* These, and Adam for what belongs to the frames alone. */
void spin_step_finish(struct spin_trainer *t, const struct spin_step_batch *b, const int *first,
                      const struct spin_frame_batch *frames);

/* What all frames share and is small, heads and exposures, has the sums of the frames' gradients, one after the
 * other. take: this frame's gradients [spin_step_shared()], and zeros in their place. */
size_t spin_step_shared(const struct spin_trainer *t);
void spin_step_take_shared(struct spin_trainer *t, float SPIN_DEV *out);
void spin_step_add_shared(struct spin_trainer *t, const float SPIN_DEV *from);

/* The frame's splats as they are drawn: their own values with those of their tracks. Good until the next call,
 * or the next step. */
struct spin_frame_batch spin_trainer_frame(struct spin_trainer *t, int frame);

#endif
