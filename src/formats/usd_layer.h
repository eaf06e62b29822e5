/* Layers of OpenUSD: trees of prims with their metadata and attributes. A layer is a text (.usda)
 * or a crate, the binary form (.usdc); usd_stage.h composes layers to a scene.
 *
 * Values are not read when a layer is opened, since the arrays of splats are most of the file. Both
 * forms are parsed without OpenUSD, and only as far as scenes of splats need: relationships,
 * connections and variants are skipped. No function trusts the file. Error messages do not contain
 * its path. */
#pragma once

#include "base/mem.h"

struct spin_usd_layer;

/* A value in a file. */
struct spin_usd_value {
    const struct spin_usd_layer *layer; /* NULL: there is no value, or it is blocked */
    const char *text;                   /* text: the characters of the value */
    size_t n_text;
    uint64_t word;    /* crate: type, and the value or its offset */
    size_t n_numbers; /* private: count of numbers in the value; SIZE_MAX: not counted yet */
};

struct spin_usd_sample {
    double time; /* time code */
    struct spin_usd_value value;
};

/* An attribute, or an entry of metadata, which has no samples. */
struct spin_usd_field {
    const char *name;
    struct spin_usd_value value;
    struct spin_usd_sample *sample; /* [n_samples], with increasing times */
    size_t n_samples;
    struct spin_usd_field *next;
};

struct spin_usd_prim {
    const char *name;
    const char *type; /* type of the prim; "" if this layer states none */
    bool defined;     /* the layer defines the prim (`def`); if false, it only overrides opinions of
                         other layers */
    struct spin_usd_field *metadata, *attribute;
    struct spin_usd_prim *child, *next;
};

struct spin_usd_layer {
    struct spin_arena arena;
    const unsigned char *data; /* the file, owned by the caller */
    size_t size;
    struct spin_usd_prim root;    /* the pseudo-root, whose metadata are those of the layer */
    struct spin_usd_crate *crate; /* private; NULL: the layer is text */
    bool variants;                /* the layer has variants, which are skipped */
};

/* The items of an array of texts or of a list of references; a single text or reference has one
 * item. Usage: struct spin_usd_items items = {.of = value}; while (spin_usd_next(&items, &item)) */
struct spin_usd_items {
    const struct spin_usd_value *of;
    size_t at; /* private */
};
