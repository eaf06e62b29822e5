/* A table whose lines are left alone until a step needs them (device.h, struct spin_lazy_adam): what it
 * keeps, and when it pays. */
#ifndef SPIN_TRAIN_LAZY_ADAM_H
#define SPIN_TRAIN_LAZY_ADAM_H

#include "model/field.h"

struct spin_lazy_table {
    struct spin_lazy_adam lazy; /* lazy.last NULL: not in use */
    size_t n_lines;
    int64_t capacity; /* steps there is room for */
    float *skipped_step, *moment_decay;
    double *sum; /* [capacity + 1][2] the two sums of spin_adam_skip, unrounded */
};

/* Floats by which the parameters should begin later, so that lines are those of the cache. */
size_t spin_lazy_pad(const struct spin_field *field);
size_t spin_lazy_bytes(const struct spin_field *field, int64_t steps);
/* True when `splats` of a step need less than half of the lines of a hashed level, by chance; else
 * stepping all of them costs no more. */
bool spin_lazy_pays(const struct spin_field *field, double splats, int64_t steps);

spin_status spin_lazy_enable(struct spin_lazy_table *t, struct spin_device *device,
                             const struct spin_field *field, int64_t steps);
void spin_lazy_close(struct spin_lazy_table *t, struct spin_device *device);
/* Step done + 1 with rate lr is over. */
void spin_lazy_advance(struct spin_lazy_table *t, double lr);

#endif
