/* The arrays of 4D splats by name, for reading and writing them. */
#pragma once

#include "spin.h"

enum { SPIN_N_ARRAYS_4D = 13 };
/* Array k: its name, its pointer in *s, the floats per row. The pointer is NULL if the splats lack
 * the array; spin_array_4d_in() decides by their degree and `parts` (enum spin_splats_4d_part). */
const char *spin_array_4d_name(int k);
float **spin_array_4d_of(struct spin_splats_4d *s, int k);
size_t spin_array_4d_width(const struct spin_splats_4d *s, int k);
/* Rounds rotations, scales, opacities and colours to 11 significant bits, and to multiples of 2^-11
 * (HALF) or of steps that are hardly visible (COMPACT); see spin-retrain --precision. */
enum spin_round_4d { SPIN_ROUND_NOTHING, SPIN_ROUND_HALF, SPIN_ROUND_COMPACT };
/* Rounds in place; settle the splats again afterwards. */
void spin_splats_4d_round(struct spin_splats_4d *s, enum spin_round_4d round);
/* Rounding steps per unit of array k; 0: never rounded. */
float spin_array_4d_per_unit(int k, enum spin_round_4d round);
/* True if splats of the degree of *s with these parts have array k. */
bool spin_array_4d_in(const struct spin_splats_4d *s, int k, unsigned parts);
/* The enum spin_splats_4d_part bit of an optional array; 0: there is no optional array of that
 * name. */
unsigned spin_array_4d_part(const char *name);
/* True if spans are up to date with the rows, as after spin_splats_4d_settle(). */
bool spin_splats_4d_is_settled(const struct spin_splats_4d *s);
/* The optional arrays that *s has. */
unsigned spin_splats_4d_parts(const struct spin_splats_4d *s);
/* Copies those rows of settled splats whose mark is 1 to *out; free it even after a failure. */
spin_status spin_splats_4d_take(const struct spin_splats_4d *s, const unsigned char *mark,
                                struct spin_splats_4d *out);
