/* Arrays of a bundle, packed: planes of their bytes, deflated; in a series, differences from frame 0.
 *
 * An array of 4-byte values of shape [n, ...] lies as bytes [4, n, ...]: plane k has byte k of every value, the
 * lowest first. A series is an array for each frame; in a later frame the first rows may be the exclusive or
 * of their bits with those of frame 0. How many rows of each frame are stands in meta.json, "xor_rows". */
#ifndef SPIN_SCENE_BUNDLE_PACK_H
#define SPIN_SCENE_BUNDLE_PACK_H

#include "io/json.h"
#include "io/npy.h"

/* Values [first, first + n) of an array, as bits. */
typedef spin_status (*spin_pack_read_fn)(void *context, uint64_t first, size_t n, uint32_t *to);

/* The series of a bundle that is being written; zero it first. */
struct spin_packer {
    struct spin_pack_series *series;
    size_t n, capacity;
};

/* One array of its own; read() is called four times for every value. */
spin_status spin_pack_write(struct spin_zip_writer *w, const char *name, int n_dims,
                            const uint64_t *shape, spin_pack_read_fn read, void *context);
/* `series`/`frame`, or an array of its own with a frame of -1. Frames of a series come in order, from 0. */
spin_status spin_packer_put(struct spin_packer *packer, struct spin_zip_writer *w,
                            const char *series, int frame, int n_dims, const uint64_t *shape,
                            const void *values);
/* "xor_rows". */
spin_json *spin_packer_json(const struct spin_packer *packer);
void spin_packer_free(struct spin_packer *packer);

/* Round finite values to this many significant bits, and to multiples of step: a power of two, or 0. */
void spin_round_values(float *values, size_t n, int bits, float step);

#endif
