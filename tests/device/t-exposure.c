/* A camera's gain and offset and its lens's falloff: the formula, its derivatives, the gradient by
 * central differences, clipping at white, the same bits for any number of threads.
 * K: threads tint lens falloff */

#include "math/exposure.h"
#include "tests/device/verbs.h"

enum { WIDTH = 100, HEIGHT = 50, PIXELS = WIDTH * HEIGHT, VALUES = 2 * SPIN_EXPOSURE };

/* The principal point is off-centre, since r is measured from it. */
static const struct spin_camera_f32 cam = {
    .width = WIDTH, .height = HEIGHT, .cx = 43.5f, .cy = 27.0f};
static const float exposure[VALUES] = {0.1f,   -0.2f,  0.3f,   0.01f,  -0.02f,  0.05f,
                                       -0.12f, -0.08f, -0.10f, 0.025f, -0.015f, 0.01f};

static float image[3 * PIXELS], out[3 * PIXELS], weight[3 * PIXELS], back[3 * PIXELS];

/* The falloff in double, from the definition. */
static double falloff(int c, int x, int y)
{
    double dx = (x + 0.5 - 43.5) / (WIDTH / 2.0), dy = (y + 0.5 - 27.0) / (WIDTH / 2.0);
    double r2 = dx * dx + dy * dy;

    return 1 + (double)exposure[6 + c] * r2 + (double)exposure[9 + c] * r2 * r2;
}

static double value(struct spin_device *d, const float *at)
{
    double sum = 0;

    on_exposure(d, &cam, at, image, out);
    for (int i = 0; i < 3 * PIXELS; i++)
        sum += (double)weight[i] * (double)out[i];
    return sum;
}

static void check_gradient(struct spin_device *d, const char *path, const float *gradient)
{
    double worst = 0;

    for (int i = 0; i < VALUES; i++) {
        float up[VALUES], down[VALUES], step = 1e-2f;
        double numeric;

        memcpy(up, exposure, sizeof up);
        memcpy(down, exposure, sizeof down);
        up[i] += step;
        down[i] -= step;
        numeric = (value(d, up) - value(d, down)) / ((double)up[i] - (double)down[i]);
        worst = larger(worst, fabs(numeric - (double)gradient[i]) / (fabs(numeric) + 1));
    }
    ok(worst < 2e-3, "%s: gradient against central differences (worst %.2g)", path, worst);
}

static void check_formula(struct spin_device *d, const char *path)
{
    double worst = 0, slope = 0;

    value(d, exposure);
    for (int i = 0; i < 3 * PIXELS; i++) {
        int c = i / PIXELS, x = i % WIDTH, y = i % PIXELS / WIDTH;
        double gain = exp((double)exposure[c]) * falloff(c, x, y);

        worst =
            larger(worst, fabs(gain * (double)image[i] + (double)exposure[3 + c] - (double)out[i]));
        slope = larger(slope, fabs(gain * (double)weight[i] - (double)back[i]));
    }
    ok(worst < 1e-6, "%s: gain, offset and falloff of each channel (worst %.2g)", path, worst);
    ok(slope < 1e-6, "%s: the picture's gradient is scaled by gain and falloff (worst %.2g)", path,
       slope);
}

/* Values brighter than white are clipped and have no gradient. */
static void check_white(struct spin_device *d, const char *path)
{
    float bright[3 * PIXELS], slopes[VALUES] = {0};
    bool white = true, still = true;

    for (int i = 0; i < 3 * PIXELS; i++)
        bright[i] = 2;
    on_exposure(d, &cam, exposure, bright, out);
    memcpy(back, weight, sizeof back);
    on_exposure_back(d, &cam, exposure, bright, back, slopes);
    for (int i = 0; i < 3 * PIXELS; i++) {
        white &= out[i] == 1;
        still &= back[i] == 0;
    }
    for (int i = 0; i < VALUES; i++)
        still &= slopes[i] == 0;
    ok(white, "%s: nothing is brighter than white", path);
    ok(still, "%s: beyond white all slopes are 0", path);
}

static void check_path(const char *path)
{
    float gradient[4][VALUES] = {{0}};
    const int n_threads[4] = {1, 2, 3, 8};
    struct spin_device *d;

    setenv("SPIN_CPU", path, 1);
    for (int k = 0; k < 4; k++) {
        d = check_device(n_threads[k]);
        memcpy(back, weight, sizeof back);
        on_exposure_back(d, &cam, exposure, image, back, gradient[k]);
        check_device_free(d);
        check_same_bits(gradient[k], gradient[0], sizeof gradient[0],
                        "the same bits on many threads");
    }
    d = check_device(2);
    check_gradient(d, path, gradient[0]);
    check_formula(d, path);
    check_white(d, path);
    check_device_free(d);
}

TAP_MAIN
{
    const char *const paths[] = {"base", "v3", "v4"};

    for (int i = 0; i < 3 * PIXELS; i++) {
        image[i] = (float)(i * 7919 % 1000) / 1500;
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
