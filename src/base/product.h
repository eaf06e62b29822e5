/* Matrix multiplication, for networks that are evaluated but not trained. */
#pragma once

#include <stdbool.h>
#include <stddef.h>

/* sums [rows][columns] = start [rows] + left [rows][n] x right [n][columns], with a stride of
 * `apart` floats between rows of left; if start is NULL, sums += the product. relu: negative
 * results become 0. columns: a multiple of 16. Each sum is accumulated in order of n, so that its
 * bits do not depend on the size of the matrices. */
void spin_multiply_add(int rows, int columns, int n, const float *left, size_t apart,
                       const float *right, const float *start, bool relu, float *sums);
