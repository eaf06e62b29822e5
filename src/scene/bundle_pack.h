/* Packed arrays of a bundle: deflated planes of the bytes of 4-byte words; in a series, also
 * differences from frame 0.
 *
 * A word is the bit pattern of a float, or an integer: a series that is listed in "per_unit" of
 * meta.json, with one number u per column, stores the value k / u as k, where k = 0, -1, 1, -2, 2,
 * ... is encoded as the words 0, 1, 2, 3, 4, ... A series is an array for each frame, [n, ...], or
 * one array without frames. The first rows of a later frame may be XORed with the same rows of
 * frame 0; "xor_rows" in meta.json lists the number of these rows for each frame.
 *
 *     bytes     array               plane k has byte k of every word, the lowest first
 *     |i1       [1 to 4, ..., n]    column after column; planes that are all 0 are left out
 *     |u1       [4, n, ...]         row after row; the words are always the bits of floats */
#pragma once

#include "io/json.h"
#include "io/npy.h"

/* The most columns of a series with units; the fewest columns of an array of SH. */
enum { SPIN_UNITS = 96, SPIN_WIDE = 12 };
/* The word of an integer, and the integer of a word. */
static inline uint32_t spin_word_of(int32_t k) { return (uint32_t)k << 1 ^ (uint32_t)(k >> 31); }
static inline int32_t spin_word_to(uint32_t word) { return (int32_t)(word >> 1 ^ -(word & 1)); }

/* Reads values [first, first + n) of an array as bits. */
typedef spin_status (*spin_pack_read_fn)(void *context, uint64_t first, size_t n, uint32_t *to);

/* The series of a bundle that is being written; zero it before use. */
struct spin_packer {
    struct spin_pack_series *series;
    size_t n, capacity;
    bool quick; /* pack arrays of SPIN_WIDE columns or more several times faster, into a few percent
                   more */
};

/* Writes one array that does not fit into memory, as |u1. read() is called four times for each
 * value, once per plane. */
spin_status spin_pack_write(struct spin_zip_writer *w, const char *name, int n_dims,
                            const uint64_t *shape, spin_pack_read_fn read, void *context);
/* Declares that values of column c of a series are multiples of 1 / per_unit[c]. An array with any
 * other value is written as |u1. Call it once, before the first array of the series. */
spin_status spin_packer_units(struct spin_packer *packer, const char *series, size_t width,
                              const float *per_unit);
/* Writes array `series`/`frame`, or `series` itself if frame is -1. The frames of a series must
 * come in order, from 0. */
spin_status spin_packer_put(struct spin_packer *packer, struct spin_zip_writer *w,
                            const char *series, int frame, int n_dims, const uint64_t *shape,
                            const void *values);
/* Puts "xor_rows" and "per_unit" into meta.json. */
void spin_packer_json(const struct spin_packer *packer, spin_json *meta);
void spin_packer_free(struct spin_packer *packer);

/* Rounds finite values to this many significant bits, then to multiples of step: a power of two, or
 * 0 for none. */
void spin_round_values(float *values, size_t n, int bits, float step);
