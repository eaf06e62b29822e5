/* Names and widths of the columns of splats, and access to columns of struct spin_splats. */
#pragma once

#include "spin.h"

/* for (unsigned column = 1; column < SPIN_COLUMNS_END; column <<= 1) visits every value of enum
 * spin_column. */
enum { SPIN_N_COLUMNS = 6, SPIN_COLUMNS_END = 1 << SPIN_N_COLUMNS };

/* The name of a column, such as "means" for SPIN_COL_MEANS. */
const char *spin_column_name(unsigned column);
/* The column with this name; 0 if there is none. */
unsigned spin_column_named(const char *name);
/* Floats per row of a column. sh_degree: used for SH only; negative degrees count as 0. */
size_t spin_column_width(unsigned column, int sh_degree);
/* Sets shape to that of a column's npy array of n rows. Returns the number of dimensions. */
int spin_column_shape(unsigned column, size_t n, int sh_degree, uint64_t shape[3]);
/* The member of *s that points to a column. */
float **spin_column_of(struct spin_splats *s, unsigned column);
/* Copies the rows with mark[i] = 1, out of n rows of `width` floats, to `to`. */
void spin_rows_take(const float *from, size_t n, size_t width, const unsigned char *mark,
                    float *to);
