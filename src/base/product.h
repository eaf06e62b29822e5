/* Matrix multiplication for the inference of networks. */
#pragma once

#include <stdbool.h>
#include <stddef.h>

/* Compute sums [rows][columns] as the matrix product of left [rows][n] and right [n][columns], plus
 * start[r] in each row r. If `start` is NULL, the product is added to the previous values of
 * `sums`. Rows of `left` begin `apart` floats apart. relu: replace negative results by 0. columns:
 * a multiple of 16. The n products of each sum are added in order, so that the bits of a sum do not
 * depend on the number of rows and columns. */
void spin_multiply_add(int rows, int columns, int n, const float *left, size_t apart,
                       const float *right, const float *start, bool relu, float *sums);
