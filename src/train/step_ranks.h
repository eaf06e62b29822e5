/* A round of a step with several ranks. */
#ifndef SPIN_TRAIN_STEP_RANKS_H
#define SPIN_TRAIN_STEP_RANKS_H

#include "train/step_parts.h"

/* Up to as many frames as there are ranks; first[i]: the first item that shows frame i, which rank i draws. All
 * ranks call it and step the frames alike. The losses come to values. */
spin_status spin_step_round(struct spin_trainer *t, const struct spin_step_batch *b,
                            const int *first, int n);

#endif
