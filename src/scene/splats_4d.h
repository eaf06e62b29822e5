/* Access to the arrays of 4D splats by index and name, for reading and writing them. */
#pragma once

#include "spin.h"

enum { SPIN_N_ARRAYS_4D = 13 };
/* The name of array k, its member in *s, and its floats per row. The member is NULL if *s does not
 * have the array. */
const char *spin_array_4d_name(int k);
float **spin_array_4d_of(struct spin_splats_4d *s, int k);
size_t spin_array_4d_width(const struct spin_splats_4d *s, int k);
/* Rounding of rotations, log scales, opacities and colours to 11 significant bits, and to multiples
 * of 2^-11 (HALF) or of larger steps that are hardly visible (COMPACT). See spin-retrain
 * --precision. */
enum spin_round_4d { SPIN_ROUND_NOTHING, SPIN_ROUND_HALF, SPIN_ROUND_COMPACT };
/* Rounds all arrays in place. Call spin_splats_4d_settle() afterwards. */
void spin_splats_4d_round(struct spin_splats_4d *s, enum spin_round_4d round);
/* Number of rounding steps per unit for array k; 0: the array is not rounded. */
float spin_array_4d_per_unit(int k, enum spin_round_4d round);
/* True if array k exists in splats of the degree of *s with these `parts`, a set of enum
 * spin_splats_4d_part. */
bool spin_array_4d_in(const struct spin_splats_4d *s, int k, unsigned parts);
/* The enum spin_splats_4d_part of an optional array; 0: no optional array has this name. */
unsigned spin_array_4d_part(const char *name);
/* True if the spans match the rows, as after spin_splats_4d_settle(). */
bool spin_splats_4d_is_settled(const struct spin_splats_4d *s);
/* The set of optional arrays in *s. */
unsigned spin_splats_4d_parts(const struct spin_splats_4d *s);
/* Copies the rows with mark[i] = 1 to *out, including their spans. Free *out even after a
 * failure. */
spin_status spin_splats_4d_take(const struct spin_splats_4d *s, const unsigned char *mark,
                                struct spin_splats_4d *out);
