/* List of all arrays that a training keeps between iterations, for saving, loading, checking and
 * averaging them. */
#pragma once

#include "train/trainer.h"

/* An array of floats or, from SPIN_STATE_SEEN on, of 32-bit numbers. */
struct spin_state_array {
    char name[48];
    enum {
        SPIN_STATE_VALUES,
        SPIN_STATE_STEPS, /* last steps of lazy Adam */
        SPIN_STATE_GRADIENT,
        /* SEEN and GRADIENT are each rank's part of a sum. In a checkpoint rank 0 has the whole sum
         * and the other ranks have zeros. */
        SPIN_STATE_SEEN,
        SPIN_STATE_TRACK, /* tracks of a frame's splats */
        SPIN_STATE_PLACE  /* rows of a frame's splats in the output */
    } kind;
    float SPIN_DEV *at;
    uint32_t *host; /* not NULL: the array is in this host memory and not at `at` */
    size_t n;
    int frame;
};

/* *out [*n], which the caller frees. permutation [frames][splats]: rows in the output; NULL: not
 * needed. */
spin_status spin_state_arrays(struct spin_trainer *t, uint32_t **permutation,
                              struct spin_state_array **out, size_t *n);
/* True for parameters, false for moments and all else. */
bool spin_state_is_parameter(const struct spin_state_array *array);
