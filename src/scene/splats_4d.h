/* The arrays of 4D splats by name, for those who store them. */
#pragma once

#include "spin.h"

enum { SPIN_N_ARRAYS_4D = 13 };
/* Array k: its name, its place in *s, the floats of a row. An array that these splats have is not
 * NULL, or is in `parts` of enum spin_splats_4d_part: see spin_splats_4d_has(). */
const char *spin_array_4d_name(int k);
float **spin_array_4d_of(struct spin_splats_4d *s, int k);
size_t spin_array_4d_width(const struct spin_splats_4d *s, int k);
/* Rotations, sizes, opacities and colours with 11 significant bits, and multiples of 2^-11 (HALF)
 * or of steps that pictures hardly show (COMPACT), as of spin-retrain --precision. */
enum spin_round_4d { SPIN_ROUND_NOTHING, SPIN_ROUND_HALF, SPIN_ROUND_COMPACT };
/* In place; to be settled again. */
void spin_splats_4d_round(struct spin_splats_4d *s, enum spin_round_4d round);
/* Steps in 1 of array k; 0: it is not rounded. */
float spin_array_4d_per_unit(int k, enum spin_round_4d round);
/* Whether array k belongs to splats of that degree with these parts. */
bool spin_array_4d_in(const struct spin_splats_4d *s, int k, unsigned parts);
/* The bit of an array that may be left out; 0: there is no such one. */
unsigned spin_array_4d_part(const char *name);
/* Whether spans are those of the rows, as spin_splats_4d_settle() makes them. */
bool spin_splats_4d_is_settled(const struct spin_splats_4d *s);
/* Those that are there. */
unsigned spin_splats_4d_parts(const struct spin_splats_4d *s);
/* The rows that are marked with 1 of settled ones, into *out, to be freed also after a failure. */
spin_status spin_splats_4d_take(const struct spin_splats_4d *s, const unsigned char *mark,
                                struct spin_splats_4d *out);
