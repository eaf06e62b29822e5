/* A typed, strided view of numbers: an array of an .npy file, a tensor of a checkpoint. */
#pragma once

#include "spin.h"

#define SPIN_NPY_MAX_DIMS 8

/* Nothing is copied and nothing is owned: the values die with the file or archive they lie in.
 * Whoever fills the struct has checked that every element lies inside of its bytes. */
struct spin_array {
    char kind;     /* 'f' 'i' 'u' 'b', 'B' bfloat16 */
    int item_size; /* bytes: 1 2 4 8 */
    bool big_endian;
    int n_dims;
    uint64_t shape[SPIN_NPY_MAX_DIMS];
    int64_t stride[SPIN_NPY_MAX_DIMS]; /* elements from one index to the next */
    uint64_t offset;                   /* elements before the first one */
    uint64_t count;                    /* product of shape */
    const unsigned char *data;         /* NULL: not bound yet (tensors) */
    size_t n_bytes;                    /* of the values (.npy) */
    const char *storage;    /* tensors: key of the storage; NULL: the values are in data */
    uint64_t storage_count; /* tensors: elements in the storage */
};

/* Row-major strides from the shape; or column-major ones. */
void spin_array_set_strides(struct spin_array *a, bool fortran);
/* The elements lie one after the other in row-major order. */
bool spin_array_is_contiguous(const struct spin_array *a);

/* Copy count elements from flat row-major index first on, converted. Any kind, byte order, layout.
 * To integers: fractions are cut off, what does not fit becomes the nearest limit, NaN becomes 0.
 */
void spin_array_to_f32(const struct spin_array *a, uint64_t first, uint64_t count, float *out);
void spin_array_to_f64(const struct spin_array *a, uint64_t first, uint64_t count, double *out);
void spin_array_to_i64(const struct spin_array *a, uint64_t first, uint64_t count, int64_t *out);
/* The values in place, when they are native contiguous float32 at an aligned address; else NULL. */
const float *spin_array_f32(const struct spin_array *a);

/* Kind and size of "f4" and its like; false when it is no plain number. */
bool spin_array_set_type(struct spin_array *a, const char *code);
/* Whether its shape is this one; a -1 matches anything. */
bool spin_array_has_shape(const struct spin_array *a, int n_dims, const int64_t *shape);
/* "[3, 500, 4]" into text; a size of -1, which matches anything, is *. */
void spin_array_shape_text(int n_dims, const uint64_t *shape, char *text, size_t n_text);
