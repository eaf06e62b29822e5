/* PLY files: header, elements, properties by name, all three encodings. */
#pragma once

#include "io/file.h"

enum spin_ply_type {
    SPIN_PLY_I8,
    SPIN_PLY_U8,
    SPIN_PLY_I16,
    SPIN_PLY_U16,
    SPIN_PLY_I32,
    SPIN_PLY_U32,
    SPIN_PLY_F32,
    SPIN_PLY_F64
};

struct spin_ply_property {
    char name[64];
    enum spin_ply_type type; /* of the values */
    bool is_list;
    enum spin_ply_type count_type; /* lists */
    size_t offset;                 /* within a record, when no list precedes it */
};

struct spin_ply_element {
    char name[64];
    uint64_t count;
    struct spin_ply_property *property;
    size_t n_properties;
    bool has_list;
    size_t stride;        /* bytes of a record without lists */
    uint64_t data_offset; /* of the first record in the file (binary) */
};

struct spin_ply {
    struct spin_map map;
    char *path;
    bool ascii, big_endian;
    struct spin_ply_element *element;
    size_t n_elements;
    char **comment; /* [n_comments] without the word comment */
    size_t n_comments;
    uint64_t extra_bytes; /* after the last record */
    double *ascii_values; /* private: [records of all elements][properties] */
    bool borrowed;        /* private: map belongs to someone else */
};

/* Reads the header and checks that the body holds what it says. */
spin_status spin_ply_open(const char *path, struct spin_ply *out);
/* The same for bytes already in memory, which are borrowed until close; `what` names them. */
spin_status spin_ply_parse(const char *what, const unsigned char *bytes, size_t n_bytes,
                           struct spin_ply *out);
void spin_ply_close(struct spin_ply *ply);
/* Comments of splats that are meant to be drawn antialiased, as Postshot and Brush write them;
 * whether there is one. */
#define SPIN_PLY_ANTIALIASED "comment antialiased 1\ncomment SplatRenderMode: mip\n"
bool spin_ply_is_antialiased(const struct spin_ply *ply);
/* NULL when there is none. */
const struct spin_ply_element *spin_ply_find_element(const struct spin_ply *ply, const char *name);
/* The element 'vertex', of less than 2^32 rows. */
spin_status spin_ply_vertices(const struct spin_ply *ply, const struct spin_ply_element **out);
/* Index of the property, or -1. Exact names; lists are never found. */
int spin_ply_find(const struct spin_ply_element *e, const char *name);
/* One column, converted to float, written to out[0], out[step], ... `step` in floats. Lists are not
 * readable this way (asserted). */
void spin_ply_column(const struct spin_ply *ply, const struct spin_ply_element *e, int property,
                     float *out, size_t step);

/* Several columns in one pass over the records: what to use when most of a record is wanted, as
 * each column alone walks the whole file. */
struct spin_ply_target {
    int property;
    float *out;
    size_t step;
};
void spin_ply_columns(const struct spin_ply *ply, const struct spin_ply_element *e,
                      const struct spin_ply_target *target, size_t n_targets);
