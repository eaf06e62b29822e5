/* A typed, strided view of numbers: an array of an .npy file, or a tensor of a checkpoint. */
#pragma once

#include "spin.h"

#define SPIN_NPY_MAX_DIMS 8

/* The values are neither copied nor owned: they are valid as long as the file or archive that
 * contains them. The code that fills this struct ensures that every element lies within the
 * storage. */
struct spin_array {
    char kind;     /* 'f' 'i' 'u' 'b' as in numpy, or 'B' for bfloat16 */
    int item_size; /* bytes: 1 2 4 8 */
    bool big_endian;
    int n_dims;
    uint64_t shape[SPIN_NPY_MAX_DIMS];
    int64_t stride[SPIN_NPY_MAX_DIMS]; /* per dimension, in elements */
    uint64_t offset;                   /* index of the first element in the storage */
    uint64_t count;                    /* product of shape */
    const unsigned char *data;         /* NULL: a tensor that is not bound to its storage yet */
    size_t n_bytes;                    /* size of the values; set for .npy only */
    const char *storage;    /* tensors: key of the storage; NULL: the values are in data */
    uint64_t storage_count; /* tensors: number of elements in the storage */
};

/* Set strides from the shape: row-major, or column-major if `fortran`. */
void spin_array_set_strides(struct spin_array *a, bool fortran);
/* Whether the elements are adjacent, in row-major order. */
bool spin_array_is_contiguous(const struct spin_array *a);

/* Copy and convert `count` elements, from flat row-major index `first` on, of any kind, byte order
 * and layout. The conversion to integers truncates fractions, clamps values out of range, and
 * converts NaN to 0. */
void spin_array_to_f32(const struct spin_array *a, uint64_t first, uint64_t count, float *out);
void spin_array_to_f64(const struct spin_array *a, uint64_t first, uint64_t count, double *out);
void spin_array_to_i64(const struct spin_array *a, uint64_t first, uint64_t count, int64_t *out);
/* The values in place if they are native, contiguous float32 at an aligned address; else NULL. */
const float *spin_array_f32(const struct spin_array *a);

/* Set kind and item_size from a numpy type such as "f4"; false if the type is not a plain
 * number. */
bool spin_array_set_type(struct spin_array *a, const char *code);
/* Whether the array has this shape, where -1 matches any size. */
bool spin_array_has_shape(const struct spin_array *a, int n_dims, const int64_t *shape);
/* Format a shape as "[3, 500, 4]"; a size of -1, which matches any, becomes *. */
void spin_array_shape_text(int n_dims, const uint64_t *shape, char *text, size_t n_text);
