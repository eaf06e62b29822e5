/* Writes crates, the binary form of layers of OpenUSD (.usdc), in version 0.8, which all readers of
 * crates support; usd_layer.h describes the format. Values are written to the file when they are
 * added. Prims and attributes stay in memory until spin_usdc_end(), which writes the tables.
 *
 * The functions for values return the word of 64 bits that represents a value in the file. If they
 * fail, the status is kept in the writer, and spin_usdc_end() returns it. */
#pragma once

#include "io/file.h"

/* Types of values, with the numbers of the file format. */
enum spin_usdc_type {
    SPIN_USDC_FLOAT = 8,
    SPIN_USDC_HALF = 7,
    SPIN_USDC_TOKEN = 11,
    SPIN_USDC_MATRIX4D = 15,
    SPIN_USDC_QUATF = 17,
    SPIN_USDC_QUATH = 18,
    SPIN_USDC_FLOAT2 = 20,
    SPIN_USDC_FLOAT3 = 24,
    SPIN_USDC_HALF3 = 25
};

/* Largest number of fields of a prim or an attribute. */
enum { SPIN_USDC_FIELDS = 12 };

/* A prim or an attribute. */
struct spin_usdc_node {
    uint32_t name; /* index of a token */
    int32_t parent;
    bool is_attribute;
    int n_fields;
    uint32_t field_name[SPIN_USDC_FIELDS]; /* indices of tokens */
    uint64_t field[SPIN_USDC_FIELDS];
};

struct spin_usdc_writer {
    struct spin_out *out;
    uint64_t at; /* length of the file so far */
    spin_status status;

    /* The following members are private. */
    char *tokens; /* [n_token_bytes] all tokens, each terminated by NUL */
    size_t n_tokens, n_token_bytes, token_room;
    uint32_t *string; /* [n_strings] indices of tokens */
    size_t n_strings, string_room;
    struct spin_usdc_node *node; /* [n_nodes] in depth-first order; the first is the pseudo-root */
    size_t n_nodes, node_room;
};

/* Begins a file. `out` must be open and empty. Set *w to zero before the call, and free it even
 * after a failure. */
void spin_usdc_begin(struct spin_usdc_writer *w, struct spin_out *out);
/* Writes the tables and the header. */
spin_status spin_usdc_end(struct spin_usdc_writer *w);
void spin_usdc_free(struct spin_usdc_writer *w);

/* Reserves an array of n items of `bytes` bytes each, which the caller writes at *offset with
 * spin_out_put() in little-endian byte order. */
uint64_t spin_usdc_reserve(struct spin_usdc_writer *w, enum spin_usdc_type type, size_t n,
                           size_t bytes, uint64_t *offset);
/* These functions write a value of `bytes` bytes, or an array of n items of `bytes` bytes each,
 * whose numbers have the byte order of this machine. */
uint64_t spin_usdc_value(struct spin_usdc_writer *w, enum spin_usdc_type type, const void *data,
                         size_t bytes);
uint64_t spin_usdc_array(struct spin_usdc_writer *w, enum spin_usdc_type type, size_t n,
                         const void *data, size_t bytes);
uint64_t spin_usdc_int(int32_t v);
uint64_t spin_usdc_float(float v);
uint64_t spin_usdc_double(struct spin_usdc_writer *w, double v);
uint64_t spin_usdc_token(struct spin_usdc_writer *w, const char *text);
uint64_t spin_usdc_string(struct spin_usdc_writer *w, const char *text);
uint64_t spin_usdc_tokens(struct spin_usdc_writer *w, const char *text);
/* Writes a dictionary with one entry: the boolean `name` with the value true. */
uint64_t spin_usdc_flag(struct spin_usdc_writer *w, const char *name);
/* Writes n time samples. time: increasing time codes; value: the words of the values. */
uint64_t spin_usdc_samples(struct spin_usdc_writer *w, const double *time, const uint64_t *value,
                           size_t n);

/* These functions add a prim or an attribute. The order must be depth-first: a prim, its
 * attributes, its children. parent: index of the parent prim; 0 is the pseudo-root, whose fields
 * are the metadata of the layer. spin_usdc_prim() returns the index of the prim. */
int32_t spin_usdc_prim(struct spin_usdc_writer *w, int32_t parent, const char *type,
                       const char *name);
void spin_usdc_attribute(struct spin_usdc_writer *w, int32_t prim, const char *type,
                         const char *name, bool uniform);
/* Adds a field to the prim or attribute that was added last. */
void spin_usdc_field(struct spin_usdc_writer *w, const char *name, uint64_t value);
/* Adds a list of API schemas to the prim that was added last, with `name` as its only item. */
void spin_usdc_schema(struct spin_usdc_writer *w, const char *name);
