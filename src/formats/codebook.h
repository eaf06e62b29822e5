/* Scalar quantisation with a codebook of 256 numbers, and vector quantisation with a palette of
 * vectors. Both minimise, approximately, the sum of squared errors. The result is the same on every
 * machine and with any number of threads. */
#pragma once

#include "base/pool.h"

#define SPIN_CODEBOOK 256

/* Computes a codebook of 256 ascending numbers for n finite values by Lloyd's algorithm (1982) in
 * one dimension. The density of the initial numbers is proportional to the cube root of the density
 * of the values (Panter and Dite 1951). Each number is rounded to six significant digits, since it
 * is later printed as JSON with six digits. If n is 0, all numbers are 0. */
spin_status spin_codebook_make(const float *values, size_t n, float book[SPIN_CODEBOOK]);
/* Returns the index of the number in the codebook that is nearest to the value. */
unsigned char spin_codebook_nearest(const float book[SPIN_CODEBOOK], float value);

/* Computes a palette of at most n_colours vectors for n rows of `width` floats, by bisecting
 * k-means: it repeatedly divides the cluster with the largest sum of squared errors by 2-means.
 * label: [n], receives the palette index of each row; palette: [n_colours][width], receives the
 * vectors; *n_used: receives the number of vectors. If `pool` is NULL, all work is done by the
 * calling thread. */
spin_status spin_palette_make(const float *rows, size_t n, size_t width, size_t n_colours,
                              struct spin_pool *pool, uint32_t *label, float *palette,
                              size_t *n_used);
