/* Arrays of a bundle, packed: planes of the bytes of 4-byte words, deflated; in a series,
 * differences from frame 0.
 *
 * A word is the bits of a value. In a series that has a "per_unit" in meta.json, a number u for
 * each column, it is a whole number k for the value k / u: 0, -1, 1, -2, 2, ... are the words 0, 1,
 * 2, 3, 4, ... A series is an array for each frame, [n, ...], or one array without frames. In a
 * later frame the first rows may be the exclusive or of their words with those of frame 0. How many
 * rows of each frame are stands in meta.json, "xor_rows".
 *
 *     bytes     array               plane k has byte k of every word, the lowest first
 *     |i1       [1 to 4, ..., n]    column after column; planes that are all 0 are left out
 *     |u1       [4, n, ...]         row after row; always the bits of values */
#pragma once

#include "io/json.h"
#include "io/npy.h"

/* Columns of a series that has units, at most; of arrays of SH, at least. */
enum { SPIN_UNITS = 96, SPIN_WIDE = 12 };
/* The word of a whole number, and back. */
static inline uint32_t spin_word_of(int32_t k) { return (uint32_t)k << 1 ^ (uint32_t)(k >> 31); }
static inline int32_t spin_word_to(uint32_t word) { return (int32_t)(word >> 1 ^ -(word & 1)); }

/* Values [first, first + n) of an array, as bits. */
typedef spin_status (*spin_pack_read_fn)(void *context, uint64_t first, size_t n, uint32_t *to);

/* The series of a bundle that is being written; zero it first. */
struct spin_packer {
    struct spin_pack_series *series;
    size_t n, capacity;
    bool quick; /* arrays from SPIN_WIDE columns on are packed several times as fast, a few percent
                   less */
};

/* One array that does not fit into memory, as |u1; read() is called four times for every value. */
spin_status spin_pack_write(struct spin_zip_writer *w, const char *name, int n_dims,
                            const uint64_t *shape, spin_pack_read_fn read, void *context);
/* Values of column c of a series are meant to be multiples of 1 / per_unit[c]. An array with a
 * value that is not one lies as |u1. To be called once, before the first array of the series. */
spin_status spin_packer_units(struct spin_packer *packer, const char *series, size_t width,
                              const float *per_unit);
/* `series`/`frame`, or an array of its own with a frame of -1. Frames of a series come in order,
 * from 0. */
spin_status spin_packer_put(struct spin_packer *packer, struct spin_zip_writer *w,
                            const char *series, int frame, int n_dims, const uint64_t *shape,
                            const void *values);
/* "xor_rows" and "per_unit" go into meta.json. */
void spin_packer_json(const struct spin_packer *packer, spin_json *meta);
void spin_packer_free(struct spin_packer *packer);

/* Round finite values to this many significant bits, and to multiples of step: a power of two, or
 * 0. */
void spin_round_values(float *values, size_t n, int bits, float step);
