/* Parameters with their gradient and Adam's moments, on the device. */
#pragma once

#include "device/device.h"

struct spin_param {
    float SPIN_DEV *p, *g, *m, *v; /* [n] */
    size_t n, pad;                 /* pad: floats reserved before each array */
};

/* Allocates the arrays, all zero; each starts `pad` floats after the start of its memory. Close it
 * also after a failure. */
spin_status spin_param_open(struct spin_param *param, struct spin_device *d, size_t n, size_t pad);
void spin_param_close(struct spin_param *param, struct spin_device *d);
/* The group of values [first, last), for an Adam step. */
struct spin_param_group spin_param_group(const struct spin_param *param, size_t first, size_t last,
                                         double lr, int64_t step);
