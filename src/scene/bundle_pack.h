/* Packs the arrays of a bundle. A series is one array [n, ...] for each frame, or a single array
 * for the whole clip. The 4-byte words of an array are split into byte planes, which are compressed
 * by deflate.
 *
 * A word is usually the bit pattern of a float. If "per_unit" of meta.json lists the series, with a
 * number u for each column, the word is an integer k in zigzag encoding, and the value is k / u:
 * the words 0, 1, 2, 3, 4, ... encode k = 0, -1, 1, -2, 2, ...
 *
 * The first rows of a frame may be XORed with the same rows of frame 0. "xor_rows" of meta.json
 * lists, for each frame, the number of rows that are XORed.
 *
 * Plane k contains byte k of every word, where byte 0 is the lowest. There are two layouts, which
 * differ in the type of the npy array:
 *
 *     |i1   [1 to 4, ..., n]   column by column; the highest planes are omitted if all bytes are 0
 *     |u1   [4, n, ...]        row by row; "per_unit" does not apply, and words are bit patterns */
#pragma once

#include "io/json.h"
#include "io/npy.h"

/* SPIN_UNITS: maximum number of columns of a series in "per_unit". SPIN_WIDE: an array with this
 * many columns or more contains SH. */
enum { SPIN_UNITS = 96, SPIN_WIDE = 12 };
/* spin_word_of() encodes an integer as a word (zigzag encoding); spin_word_to() decodes the
 * word. */
static inline uint32_t spin_word_of(int32_t k) { return (uint32_t)k << 1 ^ (uint32_t)(k >> 31); }
static inline int32_t spin_word_to(uint32_t word) { return (int32_t)(word >> 1 ^ -(word & 1)); }

/* A callback that copies the bit patterns of values [first, first + n) of an array to `to`. */
typedef spin_status (*spin_pack_read_fn)(void *context, uint64_t first, size_t n, uint32_t *to);

/* The state of all series of a bundle that is being written. Zero it before use. */
struct spin_packer {
    struct spin_pack_series *series;
    size_t n, capacity;
    /* True: arrays of SPIN_WIDE columns or more are packed several times faster, but become a few
     * percent larger. */
    bool quick;
};

/* Writes an array that does not fit into memory, in layout |u1. The whole array is read by read()
 * four times, once per plane. */
spin_status spin_pack_write(struct spin_zip_writer *w, const char *name, int n_dims,
                            const uint64_t *shape, spin_pack_read_fn read, void *context);
/* Declares that the values of column c of a series are multiples of 1 / per_unit[c]. An array with
 * other values is written in layout |u1. Must be called before the first array of the series, and
 * only once. */
spin_status spin_packer_units(struct spin_packer *packer, const char *series, size_t width,
                              const float *per_unit);
/* Writes array `series`/`frame`, or array `series` if frame is -1. The frames of a series must be
 * written in order, beginning with frame 0. */
spin_status spin_packer_put(struct spin_packer *packer, struct spin_zip_writer *w,
                            const char *series, int frame, int n_dims, const uint64_t *shape,
                            const void *values);
/* Adds the keys "xor_rows" and "per_unit" to the JSON of meta.json. */
void spin_packer_json(const struct spin_packer *packer, spin_json *meta);
void spin_packer_free(struct spin_packer *packer);

/* Rounds finite values to `bits` significant bits, then to multiples of `step`, which is a power of
 * two. If `step` is 0, values are rounded to significant bits only. */
void spin_round_values(float *values, size_t n, int bits, float step);
