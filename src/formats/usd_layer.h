/* Layers of OpenUSD: trees of prims with their metadata and attributes. A layer is a text (.usda)
 * or a crate, the binary form (.usdc); usd_stage.h composes layers to a scene.
 *
 * Values are not read when a layer is opened, since most of the file consists of the arrays of
 * splats. Text and crates are parsed without OpenUSD, and only as far as scenes of splats require:
 * relationships, connections and variants are skipped. All functions validate what they read. Error
 * messages do not contain the path of the file. */
#pragma once

#include "base/mem.h"

struct spin_usd_layer;

/* An unread value in a layer. */
struct spin_usd_value {
    const struct spin_usd_layer *layer; /* NULL: no value, or a blocked one (None) */
    const char *text;                   /* layers in text form: characters of the value */
    size_t n_text;
    uint64_t word;    /* crates: the word that represents the value, see below */
    size_t n_numbers; /* private: number of numbers; SIZE_MAX: not counted yet */
};

struct spin_usd_sample {
    double time; /* time code */
    struct spin_usd_value value;
};

/* An attribute, or an entry of metadata. Metadata have no samples. */
struct spin_usd_field {
    const char *name;
    struct spin_usd_value value;
    struct spin_usd_sample *sample; /* [n_samples], with increasing times */
    size_t n_samples;
    struct spin_usd_field *next;
};

struct spin_usd_prim {
    const char *name;
    const char *type; /* type of the prim; "" if this layer does not specify it */
    bool defined;     /* true: this layer defines the prim (`def`); false: only overrides it */
    struct spin_usd_field *metadata, *attribute;
    struct spin_usd_prim *child, *next;
};

struct spin_usd_layer {
    struct spin_arena arena;
    const unsigned char *data; /* the file, owned by the caller */
    size_t size;
    struct spin_usd_prim root;    /* the pseudo-root, whose metadata are those of the layer */
    struct spin_usd_crate *crate; /* private; NULL: the layer is text */
    bool variants;                /* true: the layer has variants, which are skipped */
};

/* Iterates over the items of an array of texts or of a list of references; a single text or
 * reference has one item. Usage: struct spin_usd_items items = {.of = value}; while
 * (spin_usd_next(&items, &item)) */
struct spin_usd_items {
    const struct spin_usd_value *of;
    size_t at; /* private */
};

/* ---- Reading --------------------------------------------------------------------------------- */

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

/* ---- Layers in text form --------------------------------------------------------------------- */

/* The functions above call these for layers in text form (.usda). */

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

/* ---- Crates ---------------------------------------------------------------------------------- */

/* The functions above call these for layers in binary form, called crates (.usdc), of versions 0.7
 * to 0.13.
 *
 * A crate begins with "PXR-USDC", its version and the offset of a table of contents, which lists
 * six sections: TOKENS (texts), STRINGS (indices of tokens), FIELDS (pairs of name and value),
 * FIELDSETS (lists of fields), PATHS (a tree) and SPECS (prims and attributes, each with a path, a
 * list of fields and a kind). A value is a word of 64 bits: bits 48 to 55 are its type; bits 61, 62
 * and 63 are flags for compressed, inline and array; the lower 48 bits are the value itself if it
 * is inline, otherwise its offset in the file. */

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
