/* Implements the functions of usd.h for layers in binary form, called crates (.usdc), of versions
 * 0.7 to 0.13.
 *
 * A crate begins with "PXR-USDC", its version and the offset of a table of contents, which lists
 * six sections: TOKENS (texts), STRINGS (indices of tokens), FIELDS (pairs of name and value),
 * FIELDSETS (lists of fields), PATHS (a tree) and SPECS (prims and attributes, each with a path, a
 * list of fields and a kind). A value is a word of 64 bits: bits 48 to 55 are its type; bits 61, 62
 * and 63 are flags for compressed, inline and array; the lower 48 bits are the value itself if it
 * is inline, otherwise its offset in the file. */
#pragma once

#include "formats/usd_layer.h"

bool spin_usd_crate_detect(const void *data, size_t size);
/* Reads the prims and attributes of the layer in out->data, but not their values. */
spin_status spin_usd_crate_open(struct spin_usd_layer *out);
/* Counts the numbers of a value, not its tuples. A tuple that does not have `width` numbers is an
 * error. */
spin_status spin_usd_crate_count(const struct spin_usd_value *v, unsigned width, size_t *n);
/* Reads n numbers as floats or, if `floats` is NULL, as doubles. n: the result of
 * spin_usd_crate_count(). */
spin_status spin_usd_crate_numbers(const struct spin_usd_value *v, size_t n, float *floats,
                                   double *doubles);
spin_status spin_usd_crate_text(const struct spin_usd_value *v, char **out);
spin_status spin_usd_crate_reference(const struct spin_usd_value *v, char **asset, char **path);
spin_status spin_usd_crate_entry(const struct spin_usd_value *dictionary, const char *name,
                                 struct spin_usd_value *out);
bool spin_usd_crate_next(struct spin_usd_items *items, struct spin_usd_value *out);
