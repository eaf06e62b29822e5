/* The container of glTF 2.0 in one binary file, and numbers in it. */
#ifndef SPIN_FORMATS_GLB_ACCESSOR_H
#define SPIN_FORMATS_GLB_ACCESSOR_H

#include "io/json.h"

/* A file in memory, which is borrowed until the end. */
struct spin_glb_file {
    spin_json *json;
    const unsigned char *bytes; /* of the binary chunk */
    uint64_t n_bytes;
};

/* Free also after a failure. Zero it before. Errors do not name the file, here and below. */
spin_status spin_glb_open(const unsigned char *file, size_t size, struct spin_glb_file *out);
void spin_glb_close(struct spin_glb_file *glb);

/* Item of a list of the document by the index that another object holds; NULL when there is none. */
const spin_json *spin_glb_item(const struct spin_glb_file *glb, const char *list,
                               const spin_json *index);
int64_t spin_glb_integer(const spin_json *object, const char *key, int64_t fallback);
/* The bytes of a buffer view. */
spin_status spin_glb_view(const struct spin_glb_file *glb, const spin_json *view,
                          const unsigned char **bytes, uint64_t *n_bytes);

/* Component types, as bits: plain, and normalised integers. */
enum {
    SPIN_GLB_I8 = 1 << 0,
    SPIN_GLB_U8 = 1 << 1,
    SPIN_GLB_I16 = 1 << 2,
    SPIN_GLB_U16 = 1 << 3,
    SPIN_GLB_F32 = 1 << 4,
    SPIN_GLB_NORMALISED = 8 /* shift */
};

/* n rows of `width` numbers, `stride` bytes apart. */
struct spin_glb_numbers {
    const unsigned char *at;
    size_t n, width, stride;
    int component; /* one of the bits */
    bool normalised;
};

/* An accessor of rows of `width` (1, 3 or 4) numbers of one of the `allowed` types; all of it lies in the
 * binary chunk. */
spin_status spin_glb_find(const struct spin_glb_file *glb, const spin_json *accessor, size_t width,
                          unsigned allowed, struct spin_glb_numbers *out);
/* Row i, normalised integers as 0..1 or -1..1. */
void spin_glb_row(const struct spin_glb_numbers *numbers, size_t i, float *out);

#endif
