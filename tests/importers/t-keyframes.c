/* Values between key frames, compared with manual calculations.
 * K: keyframes ex4dgs import */
#include "math/keyframes.h"

#include "tests/tap.h"

/* Two columns of keys: 0, 1, 3, 2 and ten times that. */
static const float keys[] = {0, 0, 1, 10, 3, 30, 2, 20};

static struct keyframes at(enum keyframes_kind kind, double part)
{
    return (struct keyframes){kind, 1, part, 1 + part};
}

static void test_values(void)
{
    struct keyframes linear = at(KEYFRAMES_LINEAR, 0.25), cube = at(KEYFRAMES_CUBE, 0.25);
    struct keyframes pchip = at(KEYFRAMES_PCHIP, 0.25);

    near(spin_keyframes_value(&linear, keys, 2), 1.5, 1e-12,
         "linear: a quarter of the way from 1 to 3");
    /* Hermite at 1/4: 27/32 of 1, 9/64 of the slope there, 5/32 of 3, -3/64 of the slope there. */
    near(spin_keyframes_value(&cube, keys, 2),
         27.0 / 32 + 9.0 / 64 * 1.5 + 15.0 / 32 - 3.0 / 64 * 0.5, 1e-12,
         "cube: slopes 3/2 and 1/2");
    near(spin_keyframes_value(&pchip, keys, 2), 27.0 / 32 + 9.0 / 64 * 4 / 3 + 15.0 / 32, 1e-12,
         "pchip: slopes 4/3, and 0 where the keys turn round");
    near(spin_keyframes_value(&cube, keys + 1, 2), 10 * spin_keyframes_value(&cube, keys, 2), 1e-12,
         "another column");
    cube.part = 0;
    near(spin_keyframes_value(&cube, keys, 2), 1, 0, "a key itself");
}

static void turned(const float quats[8], double part, const float want[4], const char *what)
{
    struct keyframes k = {KEYFRAMES_CUBE, 0, part, part};
    double worst = 0;
    float got[4];

    spin_keyframes_turn(&k, quats, got);
    for (int c = 0; c < 4; c++)
        worst = larger(worst, fabs(got[c] - want[c]));
    near(worst, 0, 1e-6, what);
}

static void test_turns(void)
{
    const float s = sqrtf(0.5f), c30 = sqrtf(0.75f);

    turned((const float[]){2, 0, 0, 0, 0, 3, 0, 0}, 0.5, (const float[]){s, s, 0, 0},
           "half of a half turn, of keys of any length");
    turned((const float[]){1, 0, 0, 0, 0, 1, 0, 0}, 1.0 / 3, (const float[]){c30, 0.5f, 0, 0},
           "a third of it");
    /* 120 degrees between the keys: 60 from either, not 30 through the opposite sign. */
    turned((const float[]){1, 0, 0, 0, -0.5f, c30, 0, 0}, 0.5, (const float[]){0.5f, c30, 0, 0},
           "the longer way where keys have opposite signs");
    turned((const float[]){1, 0, 0, 0, -1, 0, 0, 0}, 0.5, (const float[]){1, 0, 0, 0},
           "the first of two that cancel out");
    turned((const float[]){0, 0, 1, 0, 0, 0, 1, 0}, 0.7, (const float[]){0, 0, 1, 0}, "equal keys");
}

static double seen(double time, float a, float b, float log_before, float log_after)
{
    const float times[2] = {a, b}, widths[2] = {log_before, log_after};
    struct keyframes k = {KEYFRAMES_CUBE, 0, 0, time};

    return spin_keyframes_visibility(&k, times, widths, 0.5);
}

static void test_visibility(void)
{
    float half = logf(0.5f), three = logf(1.5f);

    near(seen(3, 2, 4, half, half), 1, 0, "all of it between the two times");
    near(seen(3, 4, 2, half, half), 1, 0, "in any order");
    near(seen(5, 2, 4, half, three), exp(-0.25), 1e-6, "1 after the later: (1 / (1.5 + 0.5))^2");
    near(seen(2, 2, 4, half, three), exp(-4), 1e-6,
         "at the earlier, 2 before the later: (2 / (0.5 + 0.5))^2");
    near(seen(1.5, 2, 4, three, half), exp(-1.5625), 1e-6, "before both: (2.5 / (1.5 + 0.5))^2");
    near(seen(4, 4, 4, half, half), 1, 0, "two equal times");
    near(seen(900, 2, 4, half, 800), 1, 0, "an edge beyond measure");
}

TAP_MAIN
{
    test_values();
    test_turns();
    test_visibility();
}
