/* Counter-based random numbers: pure functions of (seed, stream, counter), so that threads and
 * devices can draw numbers in any order. The finaliser of SplitMix64 (Steele, Lea and Flood 2014)
 * mixes seed and stream to a key, and then key + (counter + 1) * G to the number, where G is 2^64
 * divided by the golden ratio. */
#pragma once

#include "math/portable.h"

SPIN_FN uint64_t spin_rng_mix(uint64_t x)
{
    x = (x ^ (x >> 30)) * 0xbf58476d1ce4e5b9u;
    x = (x ^ (x >> 27)) * 0x94d049bb133111ebu;
    return x ^ (x >> 31);
}

SPIN_FN uint64_t spin_rng_u64(uint64_t seed, uint64_t stream, uint64_t counter)
{
    uint64_t key = spin_rng_mix(spin_rng_mix(seed + 0x9e3779b97f4a7c15u) + stream);

    return spin_rng_mix(key + (counter + 1u) * 0x9e3779b97f4a7c15u);
}

SPIN_FN uint32_t spin_rng_u32(uint64_t seed, uint64_t stream, uint64_t counter)
{
    return (uint32_t)(spin_rng_u64(seed, stream, counter) >> 32);
}

/* Uniform in [0, 1), a multiple of 2^-24. */
SPIN_FN float spin_rng_uniform(uint64_t seed, uint64_t stream, uint64_t counter)
{
    return (float)(spin_rng_u64(seed, stream, counter) >> 40) * 5.9604644775390625e-8f;
}

/* Uniform integer in 0 .. n-1, for n > 0. The bias is below n / 2^32. */
SPIN_FN uint32_t spin_rng_below(uint64_t seed, uint64_t stream, uint64_t counter, uint32_t n)
{
    return (uint32_t)(((uint64_t)spin_rng_u32(seed, stream, counter) * n) >> 32);
}

/* Standard normal (Box and Muller), from the two halves of one 64-bit number. */
SPIN_FN float spin_rng_normal(uint64_t seed, uint64_t stream, uint64_t counter)
{
    uint64_t bits = spin_rng_u64(seed, stream, counter);
    double u = ((double)(bits >> 32) + 0.5) * 2.3283064365386963e-10; /* (0, 1) */
    double v = (double)(uint32_t)bits * 2.3283064365386963e-10;       /* [0, 1) */

    return (float)(sqrt(-2.0 * log(u)) * cos(6.283185307179586 * v));
}
