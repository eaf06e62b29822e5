/* A camera's gain and offset: the formula, its slopes, its gradient against central differences, the
 * same bits for any number of threads.
 * K: threads tint */
#include <math.h>
#include <stdlib.h>

#include "math/exposure.h"
#include "tests/device/verbs.h"

enum { PIXELS = 5000 };

static float image[3 * PIXELS], out[3 * PIXELS], weight[3 * PIXELS], back[3 * PIXELS];

static double value(struct spin_device *d, const float *exposure)
{
    double sum = 0;

    on_exposure(d, PIXELS, exposure, image, out);
    for (int i = 0; i < 3 * PIXELS; i++)
        sum += (double)weight[i] * (double)out[i];
    return sum;
}

static void check_path(const char *path)
{
    const float exposure[6] = {0.1f, -0.2f, 0.3f, 0.01f, -0.02f, 0.05f};
    float d_exposure[4][6] = {{0}};
    const int n_threads[4] = {1, 2, 3, 8};
    struct spin_device *d;
    double worst = 0, slope = 0;

    setenv("SPIN_CPU", path, 1);
    for (int k = 0; k < 4; k++) {
        d = check_device(n_threads[k]);
        memcpy(back, weight, sizeof back);
        on_exposure_back(d, PIXELS, exposure, image, back, d_exposure[k]);
        check_device_free(d);
        check_same_bits(d_exposure[k], d_exposure[0], sizeof d_exposure[0],
                        "the same bits on many threads");
    }
    d = check_device(2);
    for (int i = 0; i < 6; i++) {
        float up[6], down[6], step = 1e-2f;
        double numeric;

        memcpy(up, exposure, sizeof up);
        memcpy(down, exposure, sizeof down);
        up[i] += step;
        down[i] -= step;
        numeric = (value(d, up) - value(d, down)) / ((double)up[i] - (double)down[i]);
        worst = fmax(worst, fabs(numeric - (double)d_exposure[0][i]) / (fabs(numeric) + 1));
    }
    ok(worst < 2e-3, "%s: gradient against central differences (worst %.2g)", path, worst);
    value(d, exposure);
    worst = 0;
    for (int i = 0; i < 3 * PIXELS; i++) {
        double gain = exp((double)exposure[i / PIXELS]);

        worst = fmax(worst, fabs(gain * (double)image[i] + (double)exposure[3 + i / PIXELS] -
                                 (double)out[i]));
        slope = fmax(slope, fabs(gain * (double)weight[i] - (double)back[i]));
    }
    ok(worst < 1e-6, "%s: gain and offset of each channel (worst %.2g)", path, worst);
    ok(slope < 1e-6, "%s: the picture's gradient is scaled by the gain (worst %.2g)", path, slope);
    check_device_free(d);
}

TAP_MAIN
{
    const char *const paths[] = {"base", "v3", "v4"};

    for (int i = 0; i < 3 * PIXELS; i++) {
        image[i] = (float)(i * 7919 % 1000) / 1000;
        weight[i] = (float)(i * 104729 % 1000) / 1000 - 0.3f;
    }
    for (int i = 0; i < 3; i++) {
        struct spin_device d;

        setenv("SPIN_CPU", paths[i], 1);
        if (spin_device_open("cpu", 1, &d) != SPIN_OK) {
            skip(paths[i], spin_last_error());
            continue;
        }
        spin_device_close(&d);
        check_path(paths[i]);
    }
}
