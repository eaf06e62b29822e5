/* The CPU's private data of a table with lazy Adam. */
#pragma once

#include "device/device.h"

struct spin_cpu_lazy_adam {
    struct spin_lazy_adam public;
    struct spin_grid grid;
    struct spin_param_group table;
    /* [steps + 1][2], indexed by the step of a line's last update: skipped_step and skipped_eps of
     * spin_adam_skip for catching up to step `done` */
    float *skipped_step;
    float *moment_decay; /* [steps + 1][2], indexed by the number of missed steps: .9^t, .999^t */
    double *sum;         /* [steps + 1][2], the two sums of spin_adam_skip before rounding */
};
