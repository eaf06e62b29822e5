/* Few values that stand for many: a book of 256 numbers, and a palette of vectors, both chosen so
 * that the sum of squared errors is small. The same input gives the same output on every machine
 * and thread. */
#pragma once

#include "base/pool.h"

#define SPIN_CODEBOOK 256

/* 256 numbers, rising, for n finite values: Lloyd's algorithm (1982) in one dimension, from places
 * whose density is the third root of the values' (Panter and Dite 1951). Each is rounded to six
 * decimal digits, so that few characters say it. With no values all are 0. */
spin_status spin_codebook_make(const float *values, size_t n, float book[SPIN_CODEBOOK]);
/* The nearest. */
unsigned char spin_codebook_nearest(const float book[SPIN_CODEBOOK], float value);

/* At most n_colours vectors for n rows of width floats: the part with the largest sum of squared
 * errors is cut in two by 2-means until there are as many (bisecting k-means). label[n],
 * palette[n_colours][width]; *n_used of them are used. The work is shared by the pool's threads;
 * NULL: by none. */
spin_status spin_palette_make(const float *rows, size_t n, size_t width, size_t n_colours,
                              struct spin_pool *pool, uint32_t *label, float *palette,
                              size_t *n_used);
