/* The mean of what is learned over the last steps. Every step draws other pictures, so the end of a
 * training is as noisy as its learning rates are high; the mean is not, and so rates need not fall
 * to zero. Of tracks and of what frames have of their own, not of a network. */
#pragma once

#include "train/trainer.h"

/* Over a share of the iterations, 0..1, none before `until`. */
struct spin_average spin_average_of(double share, int64_t until, int64_t iterations);
/* After each step; the last one leaves the mean as the parameters. All ranks call it. */
spin_status spin_average_step(struct spin_trainer *t);
/* As it stood after the trainer's iteration, with room for the values that a state has. */
spin_status spin_average_resume(struct spin_trainer *t);
/* Values that are averaged. */
spin_status spin_average_values(struct spin_trainer *t, size_t *n);
