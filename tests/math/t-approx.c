/* The polynomials compared with libm in double, on a dense sweep of floats, and NaN.
 * K: golden approx network */
#include "math/approx.h"
#include "tests/check.h"
#include "tests/tap.h"

/* Worst error of f against want over [low, high]; relative or absolute. */
static double worst(float (*f)(float), double (*want)(double), double low, double high,
                    int relative)
{
    double most = 0;
    int n = 400000;

    for (int i = 0; i <= n; i++) {
        float x = (float)(low + (high - low) * i / n);
        double w = want(x), e = fabs(f(x) - w);

        if (relative)
            e /= fabs(w);
        most = larger(most, e);
    }
    return most;
}

static float f_exp(float x) { return spin_exp(x); }
static float f_exp2(float x) { return spin_exp2(x); }
static float f_sigmoid(float x) { return spin_sigmoid(x); }
static float f_erf(float x) { return spin_erf(x); }
static float f_gelu(float x) { return spin_gelu(x); }
static float f_slope(float x)
{
    float slope;

    spin_gelu_both(x, &slope);
    return slope;
}
static double d_sigmoid(double x) { return 1 / (1 + exp(-x)); }
static double d_gelu(double x) { return x * 0.5 * erfc(-x / sqrt(2)); }
static double d_slope(double x)
{
    return 0.5 * erfc(-x / sqrt(2)) + x * exp(-x * x / 2) * 0.3989422804014327;
}

static void bound(double error, double limit, const char *what)
{
    ok(error <= limit, "%s: error %.3g, stated %.1g", what, error, limit);
}

static void golden(void)
{
    const char *path = check_fixture("core/gelu.npz");
    struct spin_npz npz;
    struct spin_array info;
    float *x, *got, *slope;
    double *y, *dy, abs = check_tolerance("gelu.npz", "abs", 1e-6);

    if (!path) {
        skip("core/gelu.npz", "fixture not found");
        return;
    }
    if (!ok(spin_npz_open(path, &npz) == SPIN_OK, "core/gelu.npz opens"))
        return;
    x = check_load_f32(&npz, "x", &info);
    y = check_load(&npz, "y", NULL);
    dy = check_load(&npz, "dy", NULL);
    got = malloc(info.count * sizeof *got);
    slope = malloc(info.count * sizeof *slope);
    for (uint64_t i = 0; i < info.count; i++)
        got[i] = spin_gelu_both(x[i], &slope[i]);
    check_close(got, y, (size_t)info.count, abs, 0, "golden gelu");
    check_close(slope, dy, (size_t)info.count, abs, 0, "golden slope of gelu");
    for (uint64_t i = 0; i < info.count; i++)
        got[i] = spin_gelu(x[i]);
    check_close(got, y, (size_t)info.count, abs, 0, "golden gelu without its slope");
    free(x), free(y), free(dy), free(got), free(slope);
    spin_npz_close(&npz);
}

TAP_MAIN
{
    bound(worst(f_exp, exp, -87, 88, 1), 2e-7, "exp, relative");
    bound(worst(f_exp, exp, -1, 1, 1), 2e-7, "exp near 0, relative");
    bound(worst(f_exp2, exp2, -126, 127, 1), 3e-7, "exp2, relative");
    bound(worst(f_sigmoid, d_sigmoid, -86, 86, 1), 4e-7, "sigmoid, relative");
    bound(worst(f_sigmoid, d_sigmoid, -200, 200, 0), 2e-7, "sigmoid, absolute");
    bound(worst(f_erf, erf, -6, 6, 0), 6e-7, "erf, absolute");
    bound(worst(f_gelu, d_gelu, -6, 6, 0), 5e-7, "gelu, absolute");
    bound(worst(f_gelu, d_gelu, -100, 0, 0), 2e-7, "gelu of negative numbers, absolute");
    bound(worst(f_slope, d_slope, -20, 20, 0), 5e-7, "slope of gelu, absolute");
    ok(spin_exp(0.0f) == 1.0f && spin_exp2(0.0f) == 1.0f && spin_sigmoid(0.0f) == 0.5f,
       "exact at 0");
    ok(spin_exp2(5.0f) == 32.0f && spin_exp2(-126.0f) == 0x1p-126f, "powers of two are exact");
    ok(isfinite(spin_exp(1e30f)) && spin_exp(-1e30f) > 0.0f, "clamped, not infinite and not 0");
    ok(isnan(spin_exp(NAN)) && isnan(spin_exp2(NAN)) && isnan(spin_sigmoid(NAN)) &&
           isnan(spin_erf(NAN)) && isnan(spin_gelu(NAN)) && isnan(f_slope(NAN)),
       "NaN stays NaN");
    ok(spin_gelu(1e30f) == 1e30f && fabsf(spin_gelu(-1e30f)) < 1e-7f, "gelu far out");
    golden();
}
