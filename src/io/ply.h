/* PLY files: header, elements, properties by name, in all three encodings. */
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
    enum spin_ply_type type; /* type of the value, or of the items of a list */
    bool is_list;
    enum spin_ply_type count_type; /* for lists only: type of the counts */
    /* Position in a record, in bytes; valid only if no list precedes the property. */
    size_t offset;
};

struct spin_ply_element {
    char name[64];
    uint64_t count;
    struct spin_ply_property *property;
    size_t n_properties;
    bool has_list;
    size_t stride; /* size of a record in bytes; valid only if the element has no lists */
    /* Position of the first record in the file; valid for binary files only. */
    uint64_t data_offset;
};

struct spin_ply {
    struct spin_map map;
    char *path;
    bool ascii, big_endian;
    struct spin_ply_element *element;
    size_t n_elements;
    char **comment; /* [n_comments] texts of the comment lines, without the keyword "comment" */
    size_t n_comments;
    uint64_t extra_bytes; /* number of bytes after the last record */
    double *ascii_values; /* private: [records of all elements][properties] */
    bool borrowed;        /* private: the caller owns `map` */
    /* An offset for positions far from 0, such as geographic ones: it is subtracted from the
     * properties x, y and z before they are rounded to floats. Opening a file sets it to 0. */
    double shift[3];
};

/* Read the header, and check that the file is as long as the header requires. */
spin_status spin_ply_open(const char *path, struct spin_ply *out);
/* Do the same for a file in memory. The memory must stay valid until spin_ply_close(). what: name
 * of the file in messages. */
spin_status spin_ply_parse(const char *what, const unsigned char *bytes, size_t n_bytes,
                           struct spin_ply *out);
void spin_ply_close(struct spin_ply *ply);
/* Comments by which Postshot and Brush declare that the splats are to be rendered with
 * antialiasing. The function returns whether a file contains one of them. */
#define SPIN_PLY_ANTIALIASED "comment antialiased 1\ncomment SplatRenderMode: mip\n"
bool spin_ply_is_antialiased(const struct spin_ply *ply);
/* Returns the element of this name, or NULL if there is none. */
const struct spin_ply_element *spin_ply_find_element(const struct spin_ply *ply, const char *name);
/* *out receives the element 'vertex'. It is an error if the file has no such element, or one with
 * 2^32 records or more. */
spin_status spin_ply_vertices(const struct spin_ply *ply, const struct spin_ply_element **out);
/* Index of the property of exactly this name, or -1; lists are never found. */
int spin_ply_find(const struct spin_ply_element *e, const char *name);
/* Convert one column to float and write it to out[0], out[step], ...; step counts floats. The
 * property must not be a list (asserted). */
void spin_ply_column(const struct spin_ply *ply, const struct spin_ply_element *e, int property,
                     float *out, size_t step);

/* Read several columns in one pass over the records, each as spin_ply_column() does. This is faster
 * than one spin_ply_column() per property if most properties are needed, since each of those calls
 * traverses the whole file. */
struct spin_ply_target {
    int property;
    float *out;
    size_t step;
};
void spin_ply_columns(const struct spin_ply *ply, const struct spin_ply_element *e,
                      const struct spin_ply_target *target, size_t n_targets);
