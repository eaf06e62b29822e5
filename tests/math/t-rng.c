/* Random numbers: fixed forever, uniform, normal, independent streams.
 * K: rng */
#include "math/rng.h"
#include "tests/tap.h"

enum { N = 200000 };

static void uniform(void)
{
    double mean = 0, square = 0, along = 0, across = 0;
    int inside = 1, counts[16] = {0}, low = N, high = 0;

    for (uint64_t i = 0; i < N; i++) {
        double x = spin_rng_uniform(1, 2, i);

        inside &= x >= 0 && x < 1;
        mean += x / N;
        square += x * x / N;
        along += (x - 0.5) * (spin_rng_uniform(1, 2, i + 1) - 0.5) * 12 / N;
        across += (x - 0.5) * (spin_rng_uniform(1, 3, i) - 0.5) * 12 / N;
        counts[spin_rng_below(9, 9, i, 16)]++;
    }
    for (int k = 0; k < 16; k++) {
        low = counts[k] < low ? counts[k] : low;
        high = counts[k] > high ? counts[k] : high;
    }
    ok(inside, "uniform is in [0, 1)");
    near(mean, 0.5, 4 * 0.2887 / sqrt(N), "its mean");
    near(square - mean * mean, 1.0 / 12, 1e-3, "its variance");
    near(along, 0, 4 / sqrt(N), "neighbours are not correlated");
    near(across, 0, 4 / sqrt(N), "streams are not correlated");
    ok(low > N / 16 - 500 && high < N / 16 + 500, "below() fills its range evenly");
}

static void normal(void)
{
    double moment[5] = {0};
    int finite = 1;

    for (uint64_t i = 0; i < N; i++) {
        double x = spin_rng_normal(3, 4, i);

        finite &= isfinite(x) != 0;
        for (int k = 1; k < 5; k++)
            moment[k] += pow(x, k) / N;
    }
    ok(finite, "normal is finite");
    near(moment[1], 0, 4 / sqrt(N), "its mean");
    near(moment[2], 1, 4 * sqrt(2.0 / N), "its variance");
    near(moment[3], 0, 4 * sqrt(15.0 / N), "its skewness");
    near(moment[4], 3, 4 * sqrt(96.0 / N), "its fourth moment");
}

TAP_MAIN
{
    ok(spin_rng_u64(0, 0, 0) == spin_rng_u64(0, 0, 0) &&
           spin_rng_u64(0, 0, 0) != spin_rng_u64(0, 0, 1) &&
           spin_rng_u64(0, 0, 0) != spin_rng_u64(0, 1, 0) &&
           spin_rng_u64(0, 0, 0) != spin_rng_u64(1, 0, 0),
       "a function of seed, stream and counter");
    /* A saved run must be repeatable with a later build: these numbers may not change. */
    ok(spin_rng_u64(0, 0, 0) == 0x568a9b0b1a2c05ecu && spin_rng_u64(1, 2, 3) == 0xeb3aa0ce549fec8cu,
       "the numbers are the same for ever");
    uniform();
    normal();
}
