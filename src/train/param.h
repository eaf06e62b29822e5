/* Parameters with their gradient and Adam's moments, on the device. */
#pragma once

#include "device/device.h"

struct spin_param {
    float SPIN_DEV *p, *g, *m, *v; /* [n] */
    size_t n, pad;                 /* pad: floats reserved before each */
};

/* All zero; p lies `pad` floats into its block, and so do the others. After a failure close as
 * well. */
spin_status spin_param_open(struct spin_param *param, struct spin_device *d, size_t n, size_t pad);
void spin_param_close(struct spin_param *param, struct spin_device *d);
/* Values [first, last) of them, for a step of Adam. */
struct spin_param_group spin_param_group(const struct spin_param *param, size_t first, size_t last,
                                         double lr, int64_t step);
