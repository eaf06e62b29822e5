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
    uint64_t word;    /* crates: the word that represents the value, see usd_crate.h */
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
