/* The columns of splats: their names, widths and members of struct spin_splats. */
#pragma once

#include "spin.h"

/* for (unsigned column = 1; column < SPIN_COLUMNS_END; column <<= 1) visits each of enum
 * spin_column. */
enum { SPIN_N_COLUMNS = 6, SPIN_COLUMNS_END = 1 << SPIN_N_COLUMNS };

/* "means" for SPIN_COL_MEANS, etc. */
const char *spin_column_name(unsigned column);
/* The column of that name, or 0. */
unsigned spin_column_named(const char *name);
/* Floats per row; of SH at this degree, where a negative degree counts as 0. */
size_t spin_column_width(unsigned column, int sh_degree);
/* The shape of n rows as an array in a file; returns the number of dimensions. */
int spin_column_shape(unsigned column, size_t n, int sh_degree, uint64_t shape[3]);
float **spin_column_of(struct spin_splats *s, unsigned column);
/* Copies those of n rows of `width` floats whose mark is 1 to `to`. */
void spin_rows_take(const float *from, size_t n, size_t width, const unsigned char *mark,
                    float *to);
