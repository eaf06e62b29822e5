/* How many of some values are NaN or infinite, at the speed of memory: importers look at every value of
 * every frame. */
#ifndef SPIN_IMPORTERS_LIB_FINITE_H
#define SPIN_IMPORTERS_LIB_FINITE_H

#include <string.h>

/* By the bits, whose exponent is all ones; in 32-bit sums, which the compiler turns into vectors. */
size_t spin_finite_missing(const float *values, size_t n);

#endif
