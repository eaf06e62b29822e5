/* Decides whether lazy Adam (device.h, struct spin_lazy_adam) is faster than an update of the whole
 * hash table, and computes the sizes of its memory. */
#pragma once

#include "model/field.h"

/* Number of floats by which the start of the table's parameters must be shifted so that the lines
 * of lazy Adam coincide with cache lines. */
size_t spin_lazy_pad(const struct spin_field *field);
/* Number of lines in the hashed levels, the only part of the table that is divided into lines. */
size_t spin_lazy_lines(const struct spin_field *field);
/* True if the evaluation of `splats` splats in an iteration reads, on average, less than half of
 * the lines of a hashed level; if it reads more, lazy Adam saves nothing. False also if lazy Adam
 * does not support the sizes of the table or this number of Adam steps. */
bool spin_lazy_pays(const struct spin_field *field, double splats, int64_t steps);
