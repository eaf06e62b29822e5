/* List of all arrays that a training keeps between iterations, for saving, loading, checking and
 * averaging them. */
#pragma once

#include "train/trainer.h"

/* An array that a training keeps. The values are floats or, for the kind SPIN_STATE_SEEN and later
 * kinds, 32-bit unsigned integers. */
struct spin_state_array {
    char name[48];
    enum {
        SPIN_STATE_VALUES, /* parameters, moments, turns, and the Polyak average */
        SPIN_STATE_STEPS,  /* the last Adam step of each line of the table, for lazy Adam */
        SPIN_STATE_GRADIENT,
        /* GRADIENT and SEEN are the statistics of a frame's splats. Each rank has a part of them;
         * the sum of these parts is the whole. A checkpoint contains the whole sum; a resume gives
         * it to rank 0, and zeros to the other ranks. */
        SPIN_STATE_SEEN,
        SPIN_STATE_TRACK, /* the track of each splat of a frame */
        SPIN_STATE_PLACE  /* the row in the output of each splat of a frame */
    } kind;
    float SPIN_DEV *at;
    /* If not NULL, the array is here, in host memory; otherwise it is at `at`, in device memory. */
    uint32_t *host;
    size_t n;
    int frame;
};

/* Sets *out [*n] to the list of all arrays, which the caller frees. permutation [frames][splats] is
 * the memory of the arrays of kind SPIN_STATE_PLACE; NULL if the caller does not need them. */
spin_status spin_state_arrays(struct spin_trainer *t, uint32_t **permutation,
                              struct spin_state_array **out, size_t *n);
/* True if the array contains parameters, which the training optimises; false if it contains
 * moments, statistics or anything else. */
bool spin_state_is_parameter(const struct spin_state_array *array);
