/* A typed, strided view of numbers: an array of an .npy file, or a tensor of a checkpoint. */
#pragma once

#include "spin.h"

#define SPIN_NPY_MAX_DIMS 8

/* The struct refers to values that it does not own: they are valid until the file or archive that
 * contains them is closed. The code that fills this struct ensures that every element lies within
 * the storage. */
struct spin_array {
    /* The type as numpy's letter 'f', 'i', 'u' or 'b' (bool), or 'B' for bfloat16. */
    char kind;
    int item_size; /* bytes per element: 1, 2, 4 or 8 */
    bool big_endian;
    int n_dims;
    uint64_t shape[SPIN_NPY_MAX_DIMS];
    /* Distance between neighbouring elements along each dimension, in elements. */
    int64_t stride[SPIN_NPY_MAX_DIMS];
    uint64_t offset; /* index of the first element in the storage */
    uint64_t count;  /* number of elements, the product of `shape` */
    /* Start of the storage; NULL for a tensor that is not bound to its storage yet. */
    const unsigned char *data;
    /* Size of all elements in bytes; set only for arrays of .npy files. */
    size_t n_bytes;
    /* For tensors of PyTorch, the key of the storage that contains the values; otherwise NULL. */
    const char *storage;
    uint64_t storage_count; /* for tensors of PyTorch, the number of elements in the storage */
};

/* Set the strides for elements that are adjacent in row-major order or, if `fortran` is set, in
 * column-major order. */
void spin_array_set_strides(struct spin_array *a, bool fortran);
/* Whether the elements are adjacent, in row-major order. */
bool spin_array_is_contiguous(const struct spin_array *a);

/* Convert `count` elements, from element `first` in row-major order, to the type of `out`. The
 * array may have any kind, byte order and layout. The conversion to integers truncates fractions,
 * clamps values out of range, and converts NaN to 0. */
void spin_array_to_f32(const struct spin_array *a, uint64_t first, uint64_t count, float *out);
void spin_array_to_f64(const struct spin_array *a, uint64_t first, uint64_t count, double *out);
void spin_array_to_i64(const struct spin_array *a, uint64_t first, uint64_t count, int64_t *out);
/* Returns a pointer to the values in place if they are contiguous float32 numbers in the byte order
 * of the host, at an aligned address; otherwise returns NULL. */
const float *spin_array_f32(const struct spin_array *a);

/* Set kind and item_size from a numpy type such as "f4"; returns false if the type is not a number
 * or bool of 1, 2, 4 or 8 bytes. */
bool spin_array_set_type(struct spin_array *a, const char *code);
/* Whether the array has this shape, where -1 matches any size. */
bool spin_array_has_shape(const struct spin_array *a, int n_dims, const int64_t *shape);
/* Format a shape as "[3, 500, 4]". A size of UINT64_MAX, the -1 of spin_array_has_shape(), is
 * printed as "*". */
void spin_array_shape_text(int n_dims, const uint64_t *shape, char *text, size_t n_text);
