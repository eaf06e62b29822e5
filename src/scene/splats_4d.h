/* Access to the arrays of 4D splats by index and name, for reading and writing them. */
#pragma once

#include "spin.h"

enum { SPIN_N_ARRAYS_4D = 13 };
/* The next three functions return the name of array k, the address of its member in *s, and its
 * number of floats per row. The member is NULL if *s does not have the array. */
const char *spin_array_4d_name(int k);
float **spin_array_4d_of(struct spin_splats_4d *s, int k);
size_t spin_array_4d_width(const struct spin_splats_4d *s, int k);
/* How rotations, log scales, opacities and colours are rounded: NOTHING does not round; HALF rounds
 * to 11 significant bits and to multiples of 2^-11; COMPACT rounds to 11 significant bits and to
 * multiples of larger steps, which are hardly visible. See --precision of spin-retrain. */
enum spin_round_4d { SPIN_ROUND_NOTHING, SPIN_ROUND_HALF, SPIN_ROUND_COMPACT };
/* Rounds these arrays in place. The caller must call spin_splats_4d_finish() afterwards. */
void spin_splats_4d_round(struct spin_splats_4d *s, enum spin_round_4d round);
/* Returns the number of rounding steps per unit for array k; 0 if the array is not rounded. */
float spin_array_4d_per_unit(int k, enum spin_round_4d round);
/* Returns whether 4D splats that have the degree of *s and these `parts`, a set of enum
 * spin_splats_4d_part, have array k. */
bool spin_array_4d_in(const struct spin_splats_4d *s, int k, unsigned parts);
/* Returns the enum spin_splats_4d_part of the optional array with this name; 0 if there is none. */
unsigned spin_array_4d_part(const char *name);
/* Returns whether the spans match the rows, which is true after spin_splats_4d_finish(). */
bool spin_splats_4d_is_finished(const struct spin_splats_4d *s);
/* Returns the set of optional arrays that *s has. */
unsigned spin_splats_4d_parts(const struct spin_splats_4d *s);
/* Copies the rows i with mark[i] = 1 to *out, including their spans. The caller frees *out, also if
 * the call fails. */
spin_status spin_splats_4d_select(const struct spin_splats_4d *s, const unsigned char *mark,
                                  struct spin_splats_4d *out);
