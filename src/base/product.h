/* One matrix product, for networks that are evaluated and not trained. */
#pragma once

#include <stdbool.h>
#include <stddef.h>

/* sums [rows][columns] = start [rows] + left [rows][n], whose rows lie `apart` floats apart, x
 * right [n][columns]; with start NULL, sums += the product. relu: negative sums become 0 then.
 * columns: a multiple of 16. Every sum runs over n in order: the same bits for every size of the
 * matrices. */
void spin_multiply_add(int rows, int columns, int n, const float *left, size_t apart,
                       const float *right, const float *start, bool relu, float *sums);
