/* Reads layers of OpenUSD, see usd_layer.h; usd_stage.h composes them to a scene. */
#pragma once

#include "formats/usd_layer.h"

/* Reads the structure of a layer in memory, which must stay valid until spin_usd_close(). Zero *out
 * before the call, and close it even after a failure. */
spin_status spin_usd_open(const void *data, size_t size, struct spin_usd_layer *out);
void spin_usd_close(struct spin_usd_layer *layer);

/* Return the prim at a path such as "/World/Splats"; the field of this name in a list of fields;
 * and the sample that applies at a time, which is the last one not later than this time or, before
 * the first sample, the first. NULL: there is none. */
struct spin_usd_prim *spin_usd_prim_at(struct spin_usd_layer *layer, const char *path);
struct spin_usd_prim *spin_usd_child(const struct spin_usd_prim *prim, const char *name, size_t n);
struct spin_usd_field *spin_usd_field(struct spin_usd_field *list, const char *name);
struct spin_usd_value *spin_usd_sample_at(struct spin_usd_field *field, double time);

/* Read the numbers of a value, which is a number, a tuple of `width` numbers, or an array of
 * either. spin_usd_count() counts the tuples. The other two functions read n tuples, and fail if
 * the value has another number of them. Quaternions are w x y z. */
spin_status spin_usd_count(struct spin_usd_value *value, unsigned width, size_t *n);
spin_status spin_usd_floats(struct spin_usd_value *value, unsigned width, size_t n, float *out);
spin_status spin_usd_doubles(struct spin_usd_value *value, unsigned width, size_t n, double *out);

/* Sets *out, which the caller frees, to the text of a string, a token, an asset path, a prim path
 * or a number. */
spin_status spin_usd_text(const struct spin_usd_value *value, char **out);
/* Sets *asset and *path, which the caller frees, to both parts of a reference; a part that is
 * missing is "". */
spin_status spin_usd_reference(const struct spin_usd_value *item, char **asset, char **path);

/* Sets *out to the entry of a dictionary with this name, or to its first entry if `name` is NULL.
 * If there is none, out->layer is NULL. */
spin_status spin_usd_entry(const struct spin_usd_value *dictionary, const char *name,
                           struct spin_usd_value *out);

/* Sets *out to the next item, and returns false if there is none. */
bool spin_usd_next(struct spin_usd_items *items, struct spin_usd_value *out);
