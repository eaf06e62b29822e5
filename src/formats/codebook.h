/* Scalar quantisation with a codebook of 256 numbers, and vector quantisation with a palette of
 * vectors. Codebook and palette are chosen for a small sum of squared errors. The result is the
 * same on every machine and with any number of threads. */
#pragma once

#include "base/pool.h"

#define SPIN_CODEBOOK 256

/* Computes a codebook of 256 ascending numbers for n finite values by Lloyd's algorithm (1982) in
 * one dimension. The density of the initial numbers is the cube root of the density of the values
 * (Panter and Dite 1951). Each number is rounded to six significant digits, so that it prints short
 * in JSON. If n is 0, all numbers are 0. */
spin_status spin_codebook_make(const float *values, size_t n, float book[SPIN_CODEBOOK]);
/* Returns the index of the codebook's number that is nearest to the value. */
unsigned char spin_codebook_nearest(const float book[SPIN_CODEBOOK], float value);

/* Computes a palette of at most n_colours vectors for n rows of `width` floats, by bisecting
 * k-means: it repeatedly divides the cluster with the largest sum of squared errors by 2-means.
 * label [n] receives the palette index of each row; palette [n_colours][width] the vectors, of
 * which the first *n_used are set. If `pool` is NULL, only the calling thread works. */
spin_status spin_palette_make(const float *rows, size_t n, size_t width, size_t n_colours,
                              struct spin_pool *pool, uint32_t *label, float *palette,
                              size_t *n_used);
