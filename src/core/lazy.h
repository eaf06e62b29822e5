/* A table whose lines are left alone until a step needs them (device.h, struct spin_lazy): what it
 * keeps, and when it pays. */
#ifndef SPIN_CORE_LAZY_H
#define SPIN_CORE_LAZY_H

#include "core/model.h"

struct spin_lazy_table {
    struct spin_lazy lazy; /* lazy.last NULL: not in use */
    size_t n_lines;
    int64_t capacity; /* steps there is room for */
    float *drift, *fade;
    double *sum; /* [capacity + 1][2] the two sums of spin_adam_skip, unrounded */
};

/* Floats by which the parameters should begin later, so that lines are those of the cache. */
size_t spin_lazy_pad(const struct spin_model *model);
size_t spin_lazy_bytes(const struct spin_model *model, int64_t steps);
/* True when `splats` of a step need less than half of the lines of a hashed level, by chance; else
 * stepping all of them costs no more. */
bool spin_lazy_pays(const struct spin_model *model, double splats, int64_t steps);

spin_status spin_lazy_open(struct spin_lazy_table *t, struct spin_device *device,
                           const struct spin_model *model, int64_t steps);
void spin_lazy_close(struct spin_lazy_table *t, struct spin_device *device);
/* Step done + 1 with rate lr is over. */
void spin_lazy_did(struct spin_lazy_table *t, double lr);

#endif
