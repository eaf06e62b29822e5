/* Matrix multiplication for the inference of networks. */
#pragma once

#include <stdbool.h>
#include <stddef.h>

/* sums [rows][columns] = start [rows] + left [rows][n] x right [n][columns], where rows of left are
 * `apart` floats apart. If start is NULL, the product is added to sums. relu: negative results
 * become 0. columns: a multiple of 16. Each sum adds its n products in order, so that its bits do
 * not depend on the number of rows and columns. */
void spin_multiply_add(int rows, int columns, int n, const float *left, size_t apart,
                       const float *right, const float *start, bool relu, float *sums);
