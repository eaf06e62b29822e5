/* The arrays of 4D splats by name, for those who store them. */
#ifndef SPIN_SCENE_SPLATS_4D_H
#define SPIN_SCENE_SPLATS_4D_H

#include "spin.h"

enum { SPIN_N_ARRAYS_4D = 13 };
/* Array k: its name, its place in *s, the floats of a row. An array that these splats have is not NULL, or is in `parts`
 * of enum spin_splats_4d_part: see spin_splats_4d_has(). */
const char *spin_array_4d_name(int k);
float **spin_array_4d_of(struct spin_splats_4d *s, int k);
size_t spin_array_4d_width(const struct spin_splats_4d *s, int k);
/* Whether array k belongs to splats of that degree with these parts. */
bool spin_array_4d_in(const struct spin_splats_4d *s, int k, unsigned parts);
/* The bit of an array that may be left out; 0: there is no such one. */
unsigned spin_array_4d_part(const char *name);
/* Those that are there. */
unsigned spin_splats_4d_parts(const struct spin_splats_4d *s);

#endif
