/* Everything that a training keeps between steps, in one list: walked to save it, to load it, to
 * check and to average it. */
#pragma once

#include "train/trainer.h"

/* Floats, and from SPIN_STATE_SEEN on numbers. */
struct spin_state_array {
    char name[48];
    enum {
        SPIN_STATE_VALUES,
        SPIN_STATE_STEPS, /* of lazy Adam */
        SPIN_STATE_GRADIENT,
        SPIN_STATE_SEEN,  /* this and the gradient are parts of sums over ranks: rank 0 has all, the
                             others zeros */
        SPIN_STATE_TRACK, /* of a frame's splats */
        SPIN_STATE_PLACE  /* of them in the output */
    } kind;
    float SPIN_DEV *at;
    uint32_t *host; /* or there */
    size_t n;
    int frame;
};

/* *out [*n], to be freed. permutation [frames][splats]: places in the output; NULL: not wanted. */
spin_status spin_state_arrays(struct spin_trainer *t, uint32_t **permutation,
                              struct spin_state_array **out, size_t *n);
/* What is learned; its moments go into it with the next step. */
bool spin_state_is_parameter(const struct spin_state_array *array);
