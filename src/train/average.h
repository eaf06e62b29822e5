/* Polyak average: the mean of the parameters over the last iterations. Every iteration draws other
 * images, so at the end of a training the parameters fluctuate in proportion to the learning rates.
 * The mean of the parameters fluctuates far less, so the learning rates need not decay to zero. The
 * methods "tracks" and "4d" use the average. */
#pragma once

#include "train/trainer.h"

/* Plans an average over the last `share` (0..1) of all `iterations`. Iterations up to `until` are
 * never averaged, even if `share` includes them. */
struct spin_average spin_average_of(double share, int64_t until, int64_t iterations);
/* Must be called by all ranks after each iteration. Every few iterations it adds the parameters to
 * the mean; after the last iteration it replaces the parameters by their mean. */
spin_status spin_average_step(struct spin_trainer *t);
/* After a resume, derives the number of averaged iterations from the trainer's iteration and
 * allocates the mean, which the caller then loads from the checkpoint. */
spin_status spin_average_resume(struct spin_trainer *t);
/* Sets *n to the number of values that the average covers: all trained parameters. */
spin_status spin_average_values(struct spin_trainer *t, size_t *n);
