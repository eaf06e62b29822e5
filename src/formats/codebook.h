/* Vector quantisation: a codebook of 256 numbers, and a palette of vectors, both chosen for a small
 * sum of squared errors. The result is the same on every machine and with any number of threads. */
#pragma once

#include "base/pool.h"

#define SPIN_CODEBOOK 256

/* Computes a codebook of 256 ascending numbers for n finite values: Lloyd's algorithm (1982) in one
 * dimension, starting with a density of numbers that is the cube root of the values' (Panter and
 * Dite 1951). Each number is rounded to six decimal digits, to keep its text short. Without values
 * all are 0. */
spin_status spin_codebook_make(const float *values, size_t n, float book[SPIN_CODEBOOK]);
/* Index of the nearest number. */
unsigned char spin_codebook_nearest(const float book[SPIN_CODEBOOK], float value);

/* Computes a palette of at most n_colours vectors for n rows of `width` floats: bisecting k-means,
 * which divides the part with the largest sum of squared errors by 2-means until there are enough.
 * label [n], palette [n_colours][width], of which *n_used are used. pool NULL: single-threaded. */
spin_status spin_palette_make(const float *rows, size_t n, size_t width, size_t n_colours,
                              struct spin_pool *pool, uint32_t *label, float *palette,
                              size_t *n_used);
