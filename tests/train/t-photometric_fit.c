/* Gains of cameras and falloff of their lenses from points that several cameras see: synthetic
 * rigs with known ground truth.
 * K: lens falloff exposure */
#include "train/photometric_fit.h"

#include "tests/tap.h"

enum { CAMERAS = 9, LENSES = 2, POINTS = 900, SEEN = 5, MOST_CAMERAS = 30 };

static const double c1[LENSES] = {-0.10, 0.04}, c2[LENSES] = {0.02, -0.07};
static const double corner_r2[LENSES] = {1.31640625, 1.31640625};
static struct spin_photometric_sample sample[POINTS * SEEN];

static double random01(uint32_t *state)
{
    *state = *state * 1664525u + 1013904223u;
    return (*state >> 8) / 16777216.0;
}

static double gain(int camera, int rgb)
{
    return 0.02 * (camera - 4) + 0.01 * rgb * (camera % 3 - 1);
}

/* every: each such sample is an outlier; 0: none. */
static void make(int every)
{
    uint32_t state = 7;

    for (int i = 0; i < POINTS * SEEN; i++) {
        struct spin_photometric_sample *s = &sample[i];
        int point = i / SEEN, lens;
        double r2 = 1.3 * random01(&state), colour = 0.2 + 0.6 * (point * 37 % 100) / 100.0;

        s->point = (uint32_t)point;
        s->half = point / 3 & 1;
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
    struct spin_photometric_result look;
    double worst = 0, corner = 0, zero = 0;

    ok(spin_photometric_choose(sample, POINTS * SEEN, CAMERAS, LENSES, corner_r2, exposure[0],
                               &look) == SPIN_OK &&
           look.gains == SPIN_PHOTOMETRIC_SEEN && look.falloff == SPIN_PHOTOMETRIC_SEEN,
       "%s: fitted and believed", what);
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

/* A camera and a lens without samples stay at 0, and outliers in red do not affect other colours.
 */
static void test_apart(void)
{
    static const double corners[LENSES + 1] = {1.3, 1.3, 1.3};
    float clean[CAMERAS + 2 + LENSES][6], red[CAMERAS + 2 + LENSES][6];
    const float *lens = clean[CAMERAS + 1 + LENSES];
    struct spin_photometric_result look;
    bool same = true;

    make(13);
    ok(spin_photometric_choose(sample, POINTS * SEEN, CAMERAS + 1, LENSES + 1, corners, clean[0],
                               &look) == SPIN_OK &&
           clean[CAMERAS][0] == 0 && clean[CAMERAS][1] == 0 && clean[CAMERAS][2] == 0,
       "a camera without samples stays at 0");
    ok(clean[CAMERAS + LENSES][0] != 0 && lens[0] == 0 && lens[3] == 0 && lens[5] == 0,
       "and so does a lens");
    for (size_t i = 0; i < POINTS * SEEN; i += 17)
        sample[i].value[0] = 0.9f;
    ok(spin_photometric_choose(sample, POINTS * SEEN, CAMERAS + 1, LENSES + 1, corners, red[0],
                               &look) == SPIN_OK &&
           red[0][0] != clean[0][0],
       "wrong values of red");
    for (size_t k = 0; k < CAMERAS + 2 + LENSES; k++)
        for (size_t c = 0; c < 6; c++)
            same &= c % 3 == 0 || red[k][c] == clean[k][c];
    ok(same, "change red alone");
}

/* A rig of one lens. The cameras' values of a point have `noise`, in the logarithm. */
struct rig {
    int cameras;
    double falloff[2];   /* darkening of the corners, in the halves of the scene: 0.1: by a tenth */
    double gain[2];      /* of every other camera, in the halves */
    double noise, radii; /* r^2 of a point is within such a range in all images */
};

static void check_rig(const char *what, const struct rig *rig, enum spin_photometric_why gains,
                      enum spin_photometric_why falloff)
{
    float exposure[MOST_CAMERAS + 1][6];
    const float *lens = exposure[rig->cameras];
    struct spin_photometric_result look;
    uint32_t state = 3;
    int seen = rig->cameras < SEEN ? rig->cameras : SEEN, n = POINTS * seen;
    double most = 0;

    for (int i = 0; i < n; i++) {
        struct spin_photometric_sample *s = &sample[i];
        int point = i / seen, half = point / 3 & 1;
        double middle = 1.3 * (point * 53 % 100) / 100.0, colour = 0.2 + 0.002 * (point % 300);
        double r2 = middle + rig->radii * (random01(&state) - middle / 1.3), t = r2 / corner_r2[0];

        *s = (struct spin_photometric_sample){.point = (uint32_t)point,
                                              .camera = (point + i % seen) % rig->cameras,
                                              .half = half,
                                              .r2 = (float)r2};
        colour *= exp(rig->gain[half] * (s->camera & 1) + rig->noise * (random01(&state) - 0.5)) *
                  (1 - rig->falloff[half] * (0.6 * t + 0.4 * t * t));
        for (int rgb = 0; rgb < 3; rgb++)
            s->value[rgb] = (float)colour;
    }
    if (!ok(spin_photometric_choose(sample, (size_t)n, rig->cameras, 1, corner_r2, exposure[0],
                                    &look) == SPIN_OK,
            "%s: fitted", what))
        return;
    ok(look.gains == gains && look.falloff == falloff, "%s, %d cameras: gains %d, falloff %d", what,
       rig->cameras, (int)look.gains, (int)look.falloff);
    if (falloff == SPIN_PHOTOMETRIC_SEEN)
        near(corner_r2[0] * ((double)lens[0] + corner_r2[0] * (double)lens[3]), -rig->falloff[0],
             0.012, "and how dark the corners are");
    else
        ok(lens[0] == 0 && lens[3] == 0, "no falloff is kept");
    for (int k = 0; k < rig->cameras; k++)
        most = larger(most, fabs((double)exposure[k][0]));
    ok((most > 0) == (gains == SPIN_PHOTOMETRIC_SEEN || falloff == SPIN_PHOTOMETRIC_SEEN),
       "gains are kept where they or the falloff are believed");
}

static void test_decision(void)
{
    static const int cameras[] = {4, 6, 12, MOST_CAMERAS};
    static const double dark[] = {0.05, 0.11, 0.3, 0.6};
    const enum spin_photometric_why seen = SPIN_PHOTOMETRIC_SEEN,
                                    held_out = SPIN_PHOTOMETRIC_NOT_HELD_OUT;

    for (size_t i = 0; i < sizeof cameras / sizeof *cameras; i++) {
        check_rig("no falloff", &(struct rig){cameras[i], {0}, {0}, 0.1, 1.3}, held_out, held_out);
        check_rig("gains alone", &(struct rig){cameras[i], {0}, {0.2, 0.2}, 0.1, 1.3}, seen,
                  held_out);
        for (size_t k = 0; k < sizeof dark / sizeof *dark; k++)
            check_rig("falloff", &(struct rig){cameras[i], {dark[k], dark[k]}, {0}, 0.1, 1.3},
                      held_out, seen);
    }
    check_rig("points at one radius", &(struct rig){8, {0.2, 0.2}, {0.2, 0.2}, 0.1, 0.2}, seen,
              SPIN_PHOTOMETRIC_SAME_RADII);
    check_rig("bright corners", &(struct rig){8, {-0.2, -0.2}, {0}, 0.1, 1.3}, held_out,
              SPIN_PHOTOMETRIC_ODD);
    check_rig("black corners", &(struct rig){8, {0.8, 0.8}, {0}, 0.1, 1.3}, held_out,
              SPIN_PHOTOMETRIC_ODD);
    check_rig("a falloff in half of the scene", &(struct rig){8, {0.3, 0}, {0}, 0.1, 1.3}, held_out,
              held_out);
    check_rig("gains in half of the scene", &(struct rig){8, {0}, {0.2, -0.2}, 0.1, 1.3}, held_out,
              held_out);
    check_rig("gains that explain little", &(struct rig){8, {0}, {0.04, 0.04}, 0.8, 1.3}, held_out,
              held_out);
}

TAP_MAIN
{
    float one[2][6];
    struct spin_photometric_result look;

    make(0);
    check("clean", 1e-3, 5e-3);
    make(17);
    check("each 17th sample is wrong", 6e-3, 1e-2);
    ok(spin_photometric_choose(sample, 0, 1, 1, corner_r2, one[0], &look) == SPIN_OK &&
           one[0][0] == 0 && one[1][0] == 0 && one[1][3] == 0,
       "without samples all is 0");
    test_apart();
    test_decision();
}
