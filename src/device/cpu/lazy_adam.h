/* The private data of the CPU device for a table with lazy Adam. */
#pragma once

#include "device/device.h"

struct spin_cpu_lazy_adam {
    struct spin_lazy_adam public;
    struct spin_grid grid;
    struct spin_param_group table;
    /* [steps + 1][2], indexed by the last step that a line took: the arguments drift and tiny with
     * which spin_adam_skip() brings the line up to step `done`. */
    float *skipped_step;
    /* [steps + 1][2], indexed by the number of missed steps t: .9^t and .999^t, by which the
     * moments decay. */
    float *moment_decay;
    /* [steps + 1][2], the two sums from which drift and tiny are computed, see spin_adam_skip() */
    double *sum;
};
