/* One gain and offset per channel and camera, fitted afterwards, compared with sums computed pixel
 * by pixel.
 * K: lens colour */
#include "eval/metrics.h"

#include "tests/tap.h"

enum { PLANE = 400, VIEWS = 4 };

static float image[VIEWS][3 * PLANE], photo[VIEWS][3 * PLANE];
static const int camera[VIEWS] = {7, 3, 7, 3};

static double noise(int view, int i) { return ((view * 131 + i * 7919) % 97 - 48) / 4800.0; }

static double psnr_of(int view, const double gain[3], const double offset[3])
{
    double squares = 0;

    for (int i = 0; i < 3 * PLANE; i++) {
        double fitted = gain[i / PLANE] * (double)image[view][i] + offset[i / PLANE];

        squares += pow(fitted - (double)photo[view][i], 2);
    }
    return -10 * log10(squares / (3 * PLANE));
}

TAP_MAIN
{
    static const double gain[3] = {0.9, 1.1, 1.0}, offset[3] = {0.02, -0.03, 0.05};
    static const double none[3] = {1, 1, 1}, zero[3] = {0, 0, 0};
    struct spin_colour_sums sums[VIEWS];
    double psnr[VIEWS], plain = 0, fitted = 0, known = 0;

    for (int v = 0; v < VIEWS; v++) {
        for (int i = 0; i < 3 * PLANE; i++) {
            int c = i / PLANE;

            image[v][i] = (float)(0.2 + (i * 104729 + v * 31) % 500 / 1000.0);
            photo[v][i] = (float)((camera[v] == 7 ? gain[c] * (double)image[v][i] + offset[c]
                                                  : (double)image[v][i]) +
                                  noise(v, i));
        }
        spin_colour_sums(camera[v], PLANE, image[v], photo[v], &sums[v]);
    }
    spin_colour_fit(sums, VIEWS, psnr);
    for (int v = 0; v < VIEWS; v++) {
        bool other = camera[v] == 7;

        plain += psnr_of(v, none, zero) / VIEWS;
        known += psnr_of(v, other ? gain : none, other ? offset : zero) / VIEWS;
        fitted += psnr[v] / VIEWS;
    }
    ok(fitted > known - 1e-6 && fitted < known + 0.2 && known > plain + 3,
       "the fit finds gain and offset of each camera: %.3f dB, known ones %.3f, none %.3f", fitted,
       known, plain);
    for (int i = 0; i < 3 * PLANE; i++)
        image[0][i] = 3; /* an image of one colour, brighter than white */
    spin_colour_sums(1, PLANE, image[0], photo[0], &sums[0]);
    ok(sums[0].of[0].x == PLANE && sums[0].of[2].xx == PLANE, "pictures are clamped at white");
    spin_colour_fit(sums, 1, psnr);
    ok(isfinite(psnr[0]) && psnr[0] > 5, "one colour is fitted by an offset: %.2f dB", psnr[0]);
    plain = psnr[0];
    for (int i = 0; i < 3 * PLANE; i++)
        image[0][i] = 0.5f + 1e-6f * photo[0][i];
    spin_colour_sums(1, PLANE, image[0], photo[0], &sums[0]);
    spin_colour_fit(sums, 1, psnr);
    near(psnr[0], plain, 1e-6, "so is one but for rounding");
}
