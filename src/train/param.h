/* An array of parameters in device memory, with their gradient and Adam's moments. */
#pragma once

#include "device/device.h"

struct spin_param {
    float SPIN_DEV *p, *g, *m, *v; /* [n] parameters, gradient, first and second moments */
    size_t n, pad;                 /* pad: number of unused floats before each array */
};

/* Allocates the four arrays and sets them to zero. Each array starts `pad` floats after the start
 * of its allocation, see spin_lazy_pad(). Close it also after a failure. */
spin_status spin_param_open(struct spin_param *param, struct spin_device *d, size_t n, size_t pad);
void spin_param_close(struct spin_param *param, struct spin_device *d);
/* Describes the parameters [first, last) to the device's adam(), for Adam step `step` with learning
 * rate lr. */
struct spin_param_group spin_param_group(const struct spin_param *param, size_t first, size_t last,
                                         double lr, int64_t step);
