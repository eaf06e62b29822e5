/* Implements the functions of usd.h for layers in text form (.usda). */
#pragma once

#include "formats/usd_layer.h"

bool spin_usd_text_detect(const void *data, size_t size);
/* Reads the prims and attributes of the layer in out->data, but not their values. */
spin_status spin_usd_text_open(struct spin_usd_layer *out);
/* Counts the numbers of a value, not its tuples. A tuple that does not have `width` numbers is an
 * error. */
spin_status spin_usd_text_count(const struct spin_usd_value *v, unsigned width, size_t *n);
/* Reads n numbers as floats or, if `floats` is NULL, as doubles. */
spin_status spin_usd_text_numbers(const struct spin_usd_value *v, unsigned width, size_t n,
                                  float *floats, double *doubles);
spin_status spin_usd_text_text(const struct spin_usd_value *v, char **out);
spin_status spin_usd_text_reference(const struct spin_usd_value *v, char **asset, char **path);
spin_status spin_usd_text_entry(const struct spin_usd_value *dictionary, const char *name,
                                struct spin_usd_value *out);
bool spin_usd_text_next(struct spin_usd_items *items, struct spin_usd_value *out);
