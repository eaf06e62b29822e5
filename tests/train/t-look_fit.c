/* Gains of cameras and falloff of their lenses from points that several cameras see: made-up rigs of which all is known.
 * K: lens falloff exposure */
#include "train/look_fit.h"

#include "tests/tap.h"

enum { CAMERAS = 9, LENSES = 2, POINTS = 900, SEEN = 5 };

static const double c1[LENSES] = {-0.10, 0.04}, c2[LENSES] = {0.02, -0.07};
static struct spin_look_sample sample[POINTS * SEEN];

static double random01(uint32_t *state)
{
    *state = *state * 1664525u + 1013904223u;
    return (*state >> 8) / 16777216.0;
}

static double gain(int camera, int rgb)
{
    return 0.02 * (camera - 4) + 0.01 * rgb * (camera % 3 - 1);
}

/* every: each such sample is a wrong one; 0: none. */
static void make(int every)
{
    uint32_t state = 7;

    for (int i = 0; i < POINTS * SEEN; i++) {
        struct spin_look_sample *s = &sample[i];
        int point = i / SEEN, lens;
        double r2 = 1.3 * random01(&state), colour = 0.2 + 0.6 * (point * 37 % 100) / 100.0;

        s->point = (uint32_t)point;
        s->camera = (point + i % SEEN * 2) % CAMERAS;
        s->lens = lens = s->camera >= 6;
        s->r2 = (float)r2;
        for (int rgb = 0; rgb < 3; rgb++)
            s->value[rgb] =
                (float)(colour * exp(gain(s->camera, rgb)) * (1 + r2 * (c1[lens] + r2 * c2[lens])));
        if (every && i % every == 0)
            s->value[0] = s->value[1] = s->value[2] = 0.9f;
    }
}

static void check(const char *what, double most_gain, double most_falloff)
{
    float exposure[CAMERAS + LENSES][6];
    double worst = 0, corner = 0, zero = 0;

    ok(spin_look_fit(sample, POINTS * SEEN, CAMERAS, LENSES, exposure[0]) == SPIN_OK, "%s: fitted",
       what);
    for (int rgb = 0; rgb < 3; rgb++) {
        double mean = 0;

        for (int k = 0; k < CAMERAS; k++)
            mean += gain(k, rgb) / CAMERAS;
        for (int k = 0; k < CAMERAS; k++) {
            worst = larger(worst, fabs((double)exposure[k][rgb] - (gain(k, rgb) - mean)));
            zero = larger(zero, fabs((double)exposure[k][3 + rgb]));
        }
        for (int k = 0; k < LENSES; k++)
            for (double r2 = 0.1; r2 < 1.35; r2 += 0.1)
                corner = larger(corner,
                                fabs(r2 * ((double)exposure[CAMERAS + k][rgb] - c1[k]) +
                                     r2 * r2 * ((double)exposure[CAMERAS + k][3 + rgb] - c2[k])));
    }
    ok(worst < most_gain, "%s: log gains, less their mean (worst %.2g)", what, worst);
    ok(corner < most_falloff, "%s: falloff of both lenses (worst %.2g)", what, corner);
    ok(zero == 0, "%s: no offsets", what);
}

/* A camera that shows nothing stays at 0, and what is wrong in red changes no other colour. */
static void test_apart(void)
{
    float clean[CAMERAS + 1 + LENSES][6], red[CAMERAS + 1 + LENSES][6];
    bool same = true;

    make(13);
    ok(spin_look_fit(sample, POINTS * SEEN, CAMERAS + 1, LENSES, clean[0]) == SPIN_OK &&
           clean[CAMERAS][0] == 0 && clean[CAMERAS][1] == 0 && clean[CAMERAS][2] == 0,
       "a camera without samples stays at 0");
    for (size_t i = 0; i < POINTS * SEEN; i += 17)
        sample[i].value[0] = 0.9f;
    ok(spin_look_fit(sample, POINTS * SEEN, CAMERAS + 1, LENSES, red[0]) == SPIN_OK &&
           red[0][0] != clean[0][0],
       "wrong values of red");
    for (size_t k = 0; k < CAMERAS + 1 + LENSES; k++)
        for (size_t c = 0; c < 6; c++)
            same &= c % 3 == 0 || red[k][c] == clean[k][c];
    ok(same, "change red alone");
}

TAP_MAIN
{
    float one[2][6];

    make(0);
    check("clean", 1e-3, 5e-3);
    make(17);
    check("each 17th sample is wrong", 6e-3, 1e-2);
    ok(spin_look_fit(sample, 0, 1, 1, one[0]) == SPIN_OK && one[0][0] == 0 && one[1][0] == 0 &&
           one[1][3] == 0,
       "without samples all is 0");
    test_apart();
}
