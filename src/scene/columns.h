/* Names and widths of the columns of splats, and access to columns of struct spin_splats. */
#pragma once

#include "spin.h"

/* The loop for (unsigned column = 1; column < SPIN_COLUMNS_END; column <<= 1) visits every value of
 * enum spin_column. */
enum { SPIN_N_COLUMNS = 6, SPIN_COLUMNS_END = 1 << SPIN_N_COLUMNS };

/* Returns the name of a column, such as "means" for SPIN_COL_MEANS. */
const char *spin_column_name(unsigned column);
/* Returns the column with this name; 0 if there is none. */
unsigned spin_column_named(const char *name);
/* Returns the number of floats per row of a column. sh_degree matters for column sh only; a
 * negative degree counts as 0. */
size_t spin_column_width(unsigned column, int sh_degree);
/* Sets `shape` to the shape of the npy array of a column with n rows. Returns the number of
 * dimensions. */
int spin_column_shape(unsigned column, size_t n, int sh_degree, uint64_t shape[3]);
/* Returns the address of the member of *s that points to a column. */
float **spin_column_of(struct spin_splats *s, unsigned column);
/* Copies to `to` the rows i with mark[i] = 1, out of n rows of `width` floats each. */
void spin_rows_select(const float *from, size_t n, size_t width, const unsigned char *mark,
                      float *to);

/* Sends splats that one rank read or computed to rank 0, which writes them (io/ranks.h): copies
 * these columns from *splats of rank `from` to *splats of rank 0. On other ranks the
 * function does nothing. */
spin_status spin_share_splats(struct spin_splats *splats, unsigned columns, int from);
