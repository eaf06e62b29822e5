/* When lazy Adam for the hash table pays (device.h, struct spin_lazy_adam), and the memory it
 * takes. */
#pragma once

#include "model/field.h"

/* Floats by which the parameters should begin later, so that lines are those of the cache. */
size_t spin_lazy_pad(const struct spin_field *field);
/* Lines of a table, or of some levels of it. */
size_t spin_lazy_lines(const struct spin_field *field);
/* True when `splats` of a step need less than half of the lines of a hashed level, by chance; else
 * stepping all of them costs no more. */
bool spin_lazy_pays(const struct spin_field *field, double splats, int64_t steps);
