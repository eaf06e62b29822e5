/* Functions of floats that are computed in double and rounded. The functions of C libraries for
 * floats differ in the last bit; those for doubles differ, too, but so little that the rounded
 * values are the same except in about one case in 10^8. So an import gives the same numbers on all
 * systems. */
#pragma once

#include "math/portable.h"

SPIN_FN float spin_rounded_exp(float x) { return (float)exp((double)x); }
SPIN_FN float spin_rounded_tanh(float x) { return (float)tanh((double)x); }
SPIN_FN float spin_rounded_sin(float x) { return (float)sin((double)x); }
SPIN_FN float spin_rounded_cos(float x) { return (float)cos((double)x); }
