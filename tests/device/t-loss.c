/* L1 + SSIM: golden values and gradients, finite differences, the same bits for any number of
 * threads, PSNR.
 * K: golden loss raster threads */
#include "math/loss.h"
#include "tests/device/raster.h"

/* The variances of a constant image are differences of nearly equal numbers: for these,
 * docs/method.md 5 requires a relative error of 3e-4 instead of the absolute 2e-6. */
static double value_tolerance(bool flat, double want)
{
    double tolerance = check_tolerance("loss.npz", "value_abs", 2e-6);
    return flat ? fmax(tolerance, 3e-4 * fabs(want)) : tolerance;
}

/* Whether every channel is constant. */
static bool is_flat(const float *image, size_t pixels)
{
    for (size_t i = 0; i < 3 * pixels; i++)
        if (image[i] != image[i / pixels * pixels])
            return false;
    return true;
}

static double one_value(struct spin_npz *npz, int pair, const char *name)
{
    char key[32];
    double *values, value;

    snprintf(key, sizeof key, "%d_%s", pair, name);
    values = check_load(npz, key, NULL);
    value = values[0];
    free(values);
    return value;
}

static void check_value(struct spin_npz *npz, int pair, bool flat, const char *name, double got)
{
    char key[32];
    double *want;

    snprintf(key, sizeof key, "%d_%s", pair, name);
    want = check_load(npz, key, NULL);
    near(got, want[0], value_tolerance(flat, want[0]), key);
    free(want);
}

/* The device clamps the image, so the unclamped PSNR is computed by the formula alone. */
static void check_psnr(struct spin_device *d, struct spin_npz *npz, int pair, int w, int h,
                       float *image, const float *truth)
{
    const char *names[3] = {"psnr", "psnr_channel_mean", "psnr_clamped"};
    size_t pixels = (size_t)(w * h);
    double got[3] = {spin_psnr(spin_squares(image, truth, 3 * pixels) / (3 * (double)pixels))};
    double values[SPIN_MEASURE_VALUES];

    for (size_t c = 0; c < 3; c++)
        got[1] += spin_psnr(spin_squares(image + c * pixels, truth + c * pixels, pixels) /
                            (double)pixels) /
                  3;
    on_measure(d, w, h, image, NULL, truth, NULL, values);
    got[2] = spin_psnr(values[SPIN_MEASURE_SQUARES] / (3 * (double)pixels));
    for (int i = 0; i < 3; i++) {
        char key[32];
        double *want;
        snprintf(key, sizeof key, "%d_%s", pair, names[i]);
        if (!spin_npz_has(npz, key))
            continue; /* identical images */
        want = check_load(npz, key, NULL);
        near(got[i], want[0], check_tolerance("loss.npz", "psnr_abs", 1e-4), key);
        free(want);
    }
}

/* For two identical images the gradient is 0, up to rounding of terms of 1e-3 that cancel. */
static void check_gradient(bool identical, const float *got, const double *want, size_t n,
                           const char *what)
{
    if (identical)
        check_close(got, want, n, 1e-8, 0, what);
    else
        check_rel_to_absmax(got, want, n, check_tolerance("loss.npz", "grad_rel_to_absmax", 5e-4),
                            what);
}

/* Solves loss = (1 - lambda) l1 + lambda (1 - ssim) of the first pair for lambda. */
static double lambda_of(struct spin_npz *npz)
{
    double l1 = one_value(npz, 0, "l1"), ssim = one_value(npz, 0, "ssim");

    return (one_value(npz, 0, "loss") - l1) / (1 - ssim - l1);
}

static void golden_pair(struct spin_device *d, struct spin_npz *npz, int pair)
{
    char key[32];
    struct spin_array info;
    float *image, *truth, *d_image;
    double *want, values[3], lambda;
    bool flat, identical;
    int w, h;

    snprintf(key, sizeof key, "%d_img", pair);
    image = check_load_f32(npz, key, &info);
    snprintf(key, sizeof key, "%d_gt", pair);
    truth = check_load_f32(npz, key, NULL);
    h = (int)info.shape[1];
    w = (int)info.shape[2];
    d_image = calloc(info.count, sizeof(float));
    flat = is_flat(image, (size_t)(w * h)) && is_flat(truth, (size_t)(w * h));
    identical = memcmp(image, truth, info.count * sizeof *image) == 0;
    lambda = check_setting_or("loss.npz", "lambda_dssim", lambda_of(npz));
    on_loss(d, w, h, image, truth, NULL, (float)lambda, 1, values, d_image);
    check_value(npz, pair, flat, "loss", values[0]);
    check_value(npz, pair, flat, "l1", values[1]);
    check_value(npz, pair, flat, "ssim", values[2]);
    snprintf(key, sizeof key, "%d_grad", pair);
    want = check_load(npz, key, NULL);
    check_gradient(identical, d_image, want, (size_t)info.count, key);
    free(want);
    /* lambda 1 leaves only SSIM; weight -1 gives its gradient */
    on_loss(d, w, h, image, truth, NULL, 1, -1, values, d_image);
    snprintf(key, sizeof key, "%d_grad_ssim", pair);
    want = check_load(npz, key, NULL);
    check_gradient(identical, d_image, want, (size_t)info.count, key);
    free(want);
    check_psnr(d, npz, pair, w, h, image, truth);
    free(image);
    free(truth);
    free(d_image);
}

static void golden(struct spin_device *d)
{
    const char *file = check_fixture("core/loss.npz");
    struct spin_npz npz;
    char key[32];

    if (!file) {
        skip("golden values", "core/loss.npz is not here");
        return;
    }
    if (spin_npz_open(file, &npz) != SPIN_OK) {
        ok(0, "core/loss.npz opens: %s", spin_last_error());
        return;
    }
    for (int pair = 0; snprintf(key, sizeof key, "%d_img", pair), spin_npz_has(&npz, key); pair++)
        golden_pair(d, &npz, pair);
    spin_npz_close(&npz);
}

/* An image in bytes measures the same as the same image in floats, and the two regions of the mask
 * are measured separately. */
static void bytes(struct spin_device *d)
{
    enum { W = 33, H = 21, N = 3 * W * H };
    float *x = allocate(N, 4), *again = allocate(N, 4), *y = allocate(N, 4);
    uint8_t *rgb = allocate(N, 1), *mask = allocate((W * H + 7) / 8, 1);
    double of_bytes[SPIN_MEASURE_VALUES], of_floats[SPIN_MEASURE_VALUES], sum[2] = {0}, red = 0;
    uint64_t state = 5;

    for (int i = 0; i < W * H; i++) {
        for (int c = 0; c < 3; c++) {
            rgb[3 * i + c] = (uint8_t)(256 * random_f(&state));
            y[c * W * H + i] = (float)rgb[3 * i + c] / 255.0f;
            x[c * W * H + i] = again[c * W * H + i] = random_between(&state, -0.2f, 1.2f);
        }
        mask[i / 8] |= (uint8_t)((i % 7 < 2) << i % 8);
    }
    on_measure(d, W, H, x, rgb, NULL, mask, of_bytes);
    on_measure(d, W, H, again, NULL, y, mask, of_floats);
    check_same_bits(of_bytes, of_floats, sizeof of_bytes, "bytes measure as their floats do");
    for (int i = 0; i < N; i++) {
        double off = (double)x[i] - (double)y[i];

        sum[i % (W * H) % 7 < 2] += off * off;
        red += i < W * H ? off * off : 0;
        if (x[i] < 0 || x[i] > 1)
            ok(0, "value %d is clamped", i);
    }
    near(of_bytes[SPIN_MEASURE_OUTSIDE], sum[0], 1e-4 * sum[0], "squares outside of the mask");
    near(of_bytes[SPIN_MEASURE_INSIDE], sum[1], 1e-4 * sum[1], "squares inside of it");
    near(of_bytes[SPIN_MEASURE_SQUARES], sum[0] + sum[1], 1e-4 * sum[0], "and of all");
    near(of_bytes[SPIN_MEASURE_RED], red, 1e-4 * red, "and of red");
    free(x), free(again), free(y), free(rgb), free(mask);
}

/* Central difference along a random direction, away from the kink of |x|: (L(x + hv) - L(x - hv)) /
 * 2h = g . v; with equal or with individual pixel weights. */
static void differences(struct spin_device *d, bool weighted)
{
    enum { W = 37, H = 29, N = 3 * W * H };
    float *x = allocate(N, 4), *y = allocate(N, 4), *v = allocate(N, 4), *moved = allocate(N, 4),
          *g = allocate(N, 4);
    float *weights = allocate(W * H, 4), *w = weighted ? weights : NULL;
    double low[3], high[3], values[3], along = 0;
    const float step = 2e-3f;
    uint64_t state = 7;

    for (int i = 0; i < N; i++) {
        y[i] = random_between(&state, 0.2f, 0.8f);
        x[i] = y[i] + (random_f(&state) < 0.5f ? -1 : 1) * random_between(&state, 0.05f, 0.2f);
        v[i] = random_between(&state, -1, 1);
    }
    for (int i = 0; i < W * H; i++)
        weights[i] = i % 5 == 0 ? 0 : 2.5f;
    on_loss(d, W, H, x, y, w, 0.2f, 3, values, g);
    for (int i = 0; i < N; i++) {
        along += (double)g[i] * v[i];
        moved[i] = x[i] + step * v[i];
    }
    on_loss(d, W, H, moved, y, w, 0.2f, 3, high, NULL);
    for (int i = 0; i < N; i++)
        moved[i] = x[i] - step * v[i];
    on_loss(d, W, H, moved, y, w, 0.2f, 3, low, NULL);
    near(along, 3 * (high[0] - low[0]) / (2 * step), 1e-3 * fabs(along) + 1e-4,
         weighted ? "and so when pixels count more or less often"
                  : "the gradient is 3 times the slope of the loss");
    free(weights);
    free(x);
    free(y);
    free(v);
    free(moved);
    free(g);
}

/* Weights: all 1 is the same as none, a common factor has no effect, L1 is the weighted mean, and
 * pixels outside a window that alone has weight do not matter. */
static void weights(struct spin_device *d)
{
    enum { W = 50, H = 61, N = 3 * W * H };
    float *x = allocate(N, 4), *y = allocate(N, 4), *g = allocate(N, 4), *other = allocate(N, 4);
    float *one = allocate(W * H, 4), *some = allocate(W * H, 4);
    double plain[3], values[3], sum = 0, mass = 0, worst = 0, outside = 0;
    uint64_t state = 3;

    for (int i = 0; i < N; i++) {
        x[i] = random_f(&state);
        y[i] = random_f(&state);
    }
    for (int i = 0; i < W * H; i++) {
        one[i] = 1;
        some[i] = i % W > 20 && i % W < 30 ? 3 : 0;
    }
    on_loss(d, W, H, x, y, NULL, 0.2f, 1, plain, g);
    on_loss(d, W, H, x, y, one, 0.2f, 1, values, other);
    check_same_bits(values, plain, sizeof plain, "weights of 1: the loss without");
    check_same_bits(other, g, N * sizeof *g, "weights of 1: the gradient without");

    on_loss(d, W, H, x, y, some, 0.2f, 1, plain, g);
    for (int i = 0; i < N; i++) {
        float w = some[i % (W * H)];

        sum += (double)w * fabs((double)x[i] - (double)y[i]);
        mass += (double)w;
    }
    near(plain[1], sum / mass, 1e-6, "L1 is the weighted mean");
    for (int i = 0; i < W * H; i++)
        one[i] = 4 * some[i];
    on_loss(d, W, H, x, y, one, 0.2f, 1, values, other);
    for (int i = 0; i < N; i++)
        worst = larger(worst, fabs((double)other[i] - (double)g[i]));
    ok(values[0] == plain[0] && worst == 0, "a common factor of four changes nothing");
    for (int i = 0; i < N; i++)
        if (some[i % (W * H)] == 0 && (i % W <= 20 - 5 || i % W >= 30 + 5)) {
            outside = larger(outside, fabs((double)g[i]));
            x[i] = 0.5f;
        }
    on_loss(d, W, H, x, y, some, 0.2f, 1, values, NULL);
    ok(outside == 0 && values[0] == plain[0], "what counts nowhere has no gradient and no part");
    free(x), free(y), free(g), free(other), free(one), free(some);
}

/* The columns in the middle of a wide image have the same gradient as in a narrow image. */
static void wide(struct spin_device *d)
{
    enum { W = 600, CUT = 200, H = 30, FAR = 10, ALL = 3 * W * H, PART = 3 * CUT * H };
    float *x = allocate(ALL, 4), *y = allocate(ALL, 4), *g = allocate(ALL, 4);
    float *cut_x = allocate(PART, 4), *cut_y = allocate(PART, 4), *cut_g = allocate(PART, 4);
    double values[3], worst = 0, most = 0;
    uint64_t state = 12;

    for (int i = 0; i < ALL; i++) {
        x[i] = random_f(&state);
        y[i] = random_f(&state);
    }
    for (int i = 0; i < PART; i++) {
        cut_x[i] = x[i / CUT * W + CUT + i % CUT];
        cut_y[i] = y[i / CUT * W + CUT + i % CUT];
    }
    on_loss(d, W, H, x, y, NULL, 0.2f, (float)W / CUT, values, g);
    on_loss(d, CUT, H, cut_x, cut_y, NULL, 0.2f, 1, values, cut_g);
    for (int i = 0; i < PART; i++)
        if (i % CUT >= FAR && i % CUT < CUT - FAR) {
            most = larger(most, fabs((double)cut_g[i]));
            worst = larger(worst, fabs((double)g[i / CUT * W + CUT + i % CUT] - (double)cut_g[i]));
        }
    near(worst / most, 0, 1e-5, "the middle of a wide picture");
    free(x), free(y), free(g), free(cut_x), free(cut_y), free(cut_g);
}

static void same_bits(const char *path)
{
    enum { W = 131, H = 97, N = 3 * W * H };
    float *x = allocate(N, 4), *y = allocate(N, 4), *one = allocate(N, 4), *more = allocate(N, 4);
    double first[3], values[3];
    uint64_t state = 11;

    for (int i = 0; i < N; i++) {
        x[i] = random_f(&state);
        y[i] = random_f(&state);
    }
    for (int n = 1; n <= 8; n = n < 3 ? n + 1 : n + 5) {
        struct spin_device *d = device_of_path(path, n);
        char what[64];
        on_loss(d, W, H, x, y, NULL, 0.2f, 1, n == 1 ? first : values, n == 1 ? one : more);
        if (n > 1) {
            snprintf(what, sizeof what, "%s: values are the same with %d threads", path, n);
            check_same_bits(values, first, sizeof first, what);
            snprintf(what, sizeof what, "%s: gradients are the same with %d threads", path, n);
            check_same_bits(more, one, N * sizeof(float), what);
        }
        check_device_free(d);
    }
    free(x);
    free(y);
    free(one);
    free(more);
}

/* Constant images far outside 0..1, and a single pixel. */
static void extremes(struct spin_device *d)
{
    enum { W = 20, H = 14, N = 3 * W * H };
    float *x = allocate(N, 4), *y = allocate(N, 4), *g = allocate(N, 4);
    double values[3];
    int finite = 1;

    for (int i = 0; i < N; i++) {
        x[i] = 100.3f;
        y[i] = 0.7f;
    }
    on_loss(d, W, H, x, y, NULL, 0.2f, 1, values, g);
    for (int i = 0; i < N; i++)
        finite &= isfinite(g[i]);
    ok(finite && isfinite(values[0]), "flat images of 100 and 0.7 have a finite loss and gradient");
    on_loss(d, 1, 1, x, x, NULL, 0.2f, 1, values, g);
    near(values[0], 0, 1e-6, "one pixel equal to itself has no loss");
    near(values[2], 1, 1e-6, "and SSIM 1");
    free(x);
    free(y);
    free(g);
}

/* With a matte, the loss is that of an input image which has been composited over the changed
 * background. */
static void mattes(struct spin_device *d)
{
    enum { W = 40, H = 30, PLANE = W * H, N = 3 * PLANE };
    static const float change[3] = {0.9f, -0.2f, 0.4f};
    float *x = allocate(N, 4), *y = allocate(N, 4), *over = allocate(N, 4), *got = allocate(N, 4),
          *want = allocate(N, 4);
    uint8_t *matte = allocate(PLANE, 1);
    double values[2][3], worst = 0;
    uint64_t state = 9;

    for (int i = 0; i < N; i++) {
        x[i] = random_f(&state);
        y[i] = random_f(&state);
    }
    for (int i = 0; i < PLANE; i++)
        matte[i] = (uint8_t)(i % 5 ? i % 256 : 0);
    for (int i = 0; i < N; i++) {
        int m = matte[i % PLANE];

        over[i] = y[i] + (m ? (float)(255 - m) / 254.0f : 0) * change[i / PLANE];
    }
    on_loss(d, W, H, x, over, NULL, 0.2f, 1, values[0], want);
    with_matte.matte = matte;
    memcpy(with_matte.change, change, sizeof change);
    on_loss(d, W, H, x, y, NULL, 0.2f, 1, values[1], got);
    memset(&with_matte, 0, sizeof with_matte);
    for (int k = 0; k < 3; k++)
        near(values[1][k], values[0][k], 1e-6,
             "with a matte, the value is that over the background");
    for (int i = 0; i < N; i++)
        worst = larger(worst, fabs((double)got[i] - (double)want[i]));
    near(worst, 0, 1e-7, "and so is the gradient");
    free(x);
    free(y);
    free(over);
    free(got);
    free(want);
    free(matte);
}

TAP_MAIN
{
    for (int i = 0; i < CPU_PATHS; i++) {
        struct spin_device *d = device_of_path(cpu_paths[i], 2);
        if (!d)
            continue;
        printf("# code path %s\n", cpu_paths[i]);
        golden(d);
        bytes(d);
        differences(d, false);
        differences(d, true);
        weights(d);
        mattes(d);
        wide(d);
        extremes(d);
        check_device_free(d);
        same_bits(cpu_paths[i]);
    }
}
