/* Polyak average: the mean of the parameters over the last iterations. Every iteration draws other
 * images, so at the end of a training the parameters fluctuate in proportion to the learning rates.
 * Their mean does not, and so the rates need not decay to zero. Used by the methods tracks and 4d.
 */
#pragma once

#include "train/trainer.h"

/* Averages over the last share (0..1) of the iterations, but not before iteration `until`. */
struct spin_average spin_average_of(double share, int64_t until, int64_t iterations);
/* Call it after each iteration: every few iterations it adds the parameters to the mean, and the
 * last one replaces them by the mean. All ranks call it. */
spin_status spin_average_step(struct spin_trainer *t);
/* Restores the state after the trainer's iteration and allocates the mean, which the checkpoint
 * then fills in. */
spin_status spin_average_resume(struct spin_trainer *t);
/* *n: number of values that are averaged. */
spin_status spin_average_values(struct spin_trainer *t, size_t *n);
