/* Reads layers of OpenUSD (usd_layer.h), in text or in binary form. usd_stage.h composes layers to
 * a scene. */
#pragma once

#include "formats/usd_layer.h"

/* Reads the structure of a layer, but not its values. The memory with the layer must stay valid
 * until spin_usd_close(). Set *out to zero before the call, and close it even after a failure. */
spin_status spin_usd_open(const void *data, size_t size, struct spin_usd_layer *out);
void spin_usd_close(struct spin_usd_layer *layer);

/* These functions return NULL if they find nothing. They search for a prim by its path, such as
 * "/World/Splats"; for a child of a prim by its name of n characters; for a field by its name in a
 * list; and for the sample that is valid at a time: the last sample up to this time or, if there is
 * none, the first sample. */
struct spin_usd_prim *spin_usd_prim_at(struct spin_usd_layer *layer, const char *path);
struct spin_usd_prim *spin_usd_child(const struct spin_usd_prim *prim, const char *name, size_t n);
struct spin_usd_field *spin_usd_field(struct spin_usd_field *list, const char *name);
struct spin_usd_value *spin_usd_sample_at(struct spin_usd_field *field, double time);

/* These functions read the numbers of a value, which is a number, a tuple of `width` numbers, or an
 * array of numbers or tuples. spin_usd_count() counts the tuples. The other two functions read n
 * tuples, and fail if the value has more or fewer. Quaternions are w x y z. */
spin_status spin_usd_count(struct spin_usd_value *value, unsigned width, size_t *n);
spin_status spin_usd_floats(struct spin_usd_value *value, unsigned width, size_t n, float *out);
spin_status spin_usd_doubles(struct spin_usd_value *value, unsigned width, size_t n, double *out);

/* Sets *out, which the caller frees, to the text of a string, a token, an asset path, a prim path
 * or a number. */
spin_status spin_usd_text(const struct spin_usd_value *value, char **out);
/* Sets *asset and *path, which the caller frees, to the asset path and the prim path of a
 * reference; a missing part is "". */
spin_status spin_usd_reference(const struct spin_usd_value *item, char **asset, char **path);

/* Sets *out to the value of the entry `name` of a dictionary, or of its first entry if `name` is
 * NULL. If there is none, sets out->layer to NULL. */
spin_status spin_usd_entry(const struct spin_usd_value *dictionary, const char *name,
                           struct spin_usd_value *out);

/* Sets *out to the next item and returns true; returns false if there is none. */
bool spin_usd_next(struct spin_usd_items *items, struct spin_usd_value *out);
