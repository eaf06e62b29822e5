/* Matrix multiplication for the inference of networks. */
#pragma once

#include <stdbool.h>
#include <stddef.h>

/* Compute sums [rows][columns] as the matrix product of left [rows][n] and right [n][columns], plus
 * start[r] in each row r. If `start` is NULL, add the product to the previous values of `sums`. If
 * `relu` is true, replace negative results by 0. `columns` must be a multiple of 16, and `apart` is
 * the distance from one row of `left` to the next, in floats. The n products of a sum are added in
 * order and without FMA, so that the sum is bit-identical for any number of rows and columns, and
 * on any processor. */
void spin_multiply_add(int rows, int columns, int n, const float *left, size_t apart,
                       const float *right, const float *start, bool relu, float *sums);
