/* Polyak average: the mean of the parameters over the last iterations. Every iteration draws other
 * images, so at the end of a training the parameters fluctuate in proportion to the learning rates.
 * Their mean fluctuates far less, so the rates need not decay to zero. The methods tracks and 4d
 * use it. */
#pragma once

#include "train/trainer.h"

/* Plans an average over the last `share` (0..1) of the iterations, but not before iteration
 * `until`. */
struct spin_average spin_average_of(double share, int64_t until, int64_t iterations);
/* Call it after each iteration. It adds the parameters to the mean every few iterations, and after
 * the last iteration replaces the parameters by their mean. All ranks call it. */
spin_status spin_average_step(struct spin_trainer *t);
/* After a resume, derives the number of averaged iterations from the trainer's iteration and
 * allocates the mean, which the caller then loads from the checkpoint. */
spin_status spin_average_resume(struct spin_trainer *t);
/* *n: the number of averaged values. */
spin_status spin_average_values(struct spin_trainer *t, size_t *n);
