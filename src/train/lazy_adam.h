/* Decides whether lazy Adam pays for the hash table (device.h, struct spin_lazy_adam), and sizes
 * its memory. */
#pragma once

#include "model/field.h"

/* Floats by which the start of the parameters should be shifted, so that lines coincide with cache
 * lines. */
size_t spin_lazy_pad(const struct spin_field *field);
/* Number of lines in the hashed levels, the part of the table that lazy Adam updates. */
size_t spin_lazy_lines(const struct spin_field *field);
/* True if `splats` splats per iteration need on average less than half of the lines of a hashed
 * level; otherwise updating all of them costs no more. False also if lazy Adam cannot handle the
 * sizes. */
bool spin_lazy_pays(const struct spin_field *field, double splats, int64_t steps);
