/* Compares the result of spin_eval() with independent computations: the quality of every view and
 * its means, dynamic regions, choice of views, storage, speed, images.
 * K: long eval measure */
#include <unistd.h>

#include <zlib.h>

#include "base/log.h"
#include "spin_run.h"
#include "run/run.h"
#include "eval/flicker.h"
#include "model/field.h"
#include "io/image.h"
#include "scene/bundle.h"
#include "scene/dataset.h"
#include "tests/check.h"
#include "tests/tap.h"

enum { W = 16, H = 12, ROWS = 3, CAMERAS = 3, FIRST = 7, MOVING = 4, SHIFT = 25 };

/* In the order of the files: the last one is held out. */
static const int camera_id[CAMERAS] = {0, 3, 5};
static const char *folder;
static char bundle[600], data[600], trained[600];

static const char *in(const char *format, int a, int b)
{
    static char path[4][700];
    static int next;
    char *p = path[next++ % 4];
    int n = snprintf(p, sizeof path[0], "%s/", folder);

    snprintf(p + n, sizeof path[0] - (size_t)n, format, a, b);
    return p;
}

/* ---- A data set of plain images, and splats that are not visible ----------------------------- */

static int value_of(int row, int camera, int channel)
{
    return 20 + 30 * row + 50 * camera + 13 * channel;
}

/* Number of pixels in the columns at the left that are dynamic: SHIFT brighter. One mask is too
 * small to be measured. */
static int n_dynamic(int row, int camera) { return row == 1 && camera == 2 ? 1 : MOVING * H; }

/* The middle camera's images have alpha: half of them is background. */
static double alpha_of(int camera) { return camera == 1 ? 128 / 255.0 : 1; }

static void put_chunk(FILE *f, const char *name, const unsigned char *bytes, size_t n)
{
    unsigned char word[8] = {0, 0, (unsigned char)(n >> 8), (unsigned char)n};
    uint32_t crc;

    memcpy(word + 4, name, 4);
    crc = (uint32_t)crc32(crc32(0, word + 4, 4), bytes, (uInt)n);
    fwrite(word, 1, 8, f);
    if (n > 0)
        fwrite(bytes, 1, n, f);
    for (int i = 0; i < 4; i++)
        fputc((int)(crc >> (24 - 8 * i) & 255), f);
}

/* A PNG with an alpha of 128. */
static void write_half(const char *path, const uint8_t *rgb)
{
    unsigned char rows[H * (1 + 4 * W)] = {0}, packed[4 * sizeof rows];
    const unsigned char head[13] = {0, 0, 0, W, 0, 0, 0, H, 8, 6};
    uLongf n = sizeof packed;
    FILE *f = fopen(path, "wb");

    for (int i = 0; i < W * H; i++) {
        unsigned char *to = rows + i / W * (1 + 4 * W) + 1 + 4 * (i % W);

        memcpy(to, rgb + 3 * i, 3);
        to[3] = 128;
    }
    if (!f || compress(packed, &n, rows, sizeof rows) != Z_OK)
        exit(1);
    fwrite("\x89PNG\r\n\x1a\n", 1, 8, f);
    put_chunk(f, "IHDR", head, sizeof head);
    put_chunk(f, "IDAT", packed, n);
    put_chunk(f, "IEND", head, 0);
    fclose(f);
}

static void write_pictures(void)
{
    uint8_t rgb[3 * W * H], mask[3 * W * H];

    for (int row = 0; row < ROWS; row++)
        for (int k = 0; k < CAMERAS; k++) {
            for (int i = 0; i < W * H; i++) {
                bool moves = n_dynamic(row, k) == 1 ? i == 0 : i % W < MOVING;

                for (int c = 0; c < 3; c++) {
                    rgb[3 * i + c] = (uint8_t)(value_of(row, k, c) + (moves ? SHIFT : 0));
                    mask[3 * i + c] = moves ? (k == 0 ? 1 : 255) : 0;
                }
            }
            if (k == 1)
                write_half(in("data/ims/%d/%06d.png", camera_id[k], FIRST + row), rgb);
            else if (spin_image_write(in("data/ims/%d/%06d.png", camera_id[k], FIRST + row), W, H,
                                      rgb, false) != SPIN_OK)
                exit(1);
            if (spin_image_write(in("data/seg/%d/%06d.png", camera_id[k], FIRST + row), W, H, mask,
                                 false) != SPIN_OK)
                exit(1);
        }
}

static void put_list(FILE *f, const char *key, int first, int end, const char *what)
{
    fprintf(f, ", \"%s\": [", key);
    for (int row = 0; row < ROWS; row++) {
        fprintf(f, "%s[", row ? ", " : "");
        for (int k = first; k < end; k++) {
            fprintf(f, "%s", k > first ? ", " : "");
            if (what)
                fprintf(f, "%s", what);
            else if (!strcmp(key, "w2c"))
                fprintf(f, "[[1, 0, 0, %g], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]", 0.1 * k);
            else if (!strcmp(key, "fn"))
                fprintf(f, "\"%d/%06d.png\"", camera_id[k], FIRST + row);
            else
                fprintf(f, "%d", camera_id[k]);
        }
        fprintf(f, "]");
    }
    fprintf(f, "]");
}

static void write_meta(const char *name, int first, int end)
{
    FILE *f = fopen(in(name, 0, 0), "w");

    if (!f)
        exit(1);
    fprintf(f, "{\"w\": %d, \"h\": %d", W, H);
    put_list(f, "k", first, end, "[[20, 0, 8], [0, 20, 6], [0, 0, 1]]");
    put_list(f, "w2c", first, end, NULL);
    put_list(f, "fn", first, end, NULL);
    put_list(f, "cam_id", first, end, NULL);
    fprintf(f, "}\n");
    fclose(f);
}

/* Writes one splat, given as its row of values. */
static void write_cloud(const char *name, int number, const char *values)
{
    static const char *const names[] = {"x",      "y",       "z",       "f_dc_0",  "f_dc_1",
                                        "f_dc_2", "opacity", "scale_0", "scale_1", "scale_2",
                                        "rot_0",  "rot_1",   "rot_2",   "rot_3"};
    FILE *f = fopen(in(name, number, 0), "w");

    if (!f)
        exit(1);
    fprintf(f, "ply\nformat ascii 1.0\nelement vertex 1\n");
    for (size_t i = 0; i < sizeof names / sizeof *names; i++)
        fprintf(f, "property float %s\n", names[i]);
    fprintf(f, "end_header\n%s\n", values);
    fclose(f);
}

static void make_clip(void)
{
    struct spin_import_options o = {.output = bundle, .data = data};
    char *r;

    mkdir(in("far", 0, 0), 0777);
    mkdir(in("other", 0, 0), 0777);
    mkdir(in("black", 0, 0), 0777);
    mkdir(in("data", 0, 0), 0777);
    mkdir(in("data/ims", 0, 0), 0777);
    mkdir(in("data/seg", 0, 0), 0777);
    for (int k = 0; k < CAMERAS; k++) {
        mkdir(in("data/ims/%d", camera_id[k], 0), 0777);
        mkdir(in("data/seg/%d", camera_id[k], 0), 0777);
    }
    for (int row = 0; row < ROWS; row++) {
        char far[80];

        snprintf(far, sizeof far, "%d %d 30000 0 0 0 -9 -5 -5 -5 1 0 0 0", 10000 + row,
                 20000 - row);
        write_cloud("far/f%d.ply", FIRST + row, far);
        write_cloud("other/f%d.ply", row, far);
        write_cloud("black/f%d.ply", FIRST + row, "0 0 2 -2 -2 -2 0 -2 -2 -2 1 0 0 0");
    }
    write_pictures();
    write_meta("data/train_meta.json", 0, 2);
    write_meta("data/test_meta.json", 2, 3);
    snprintf(bundle, sizeof bundle, "%s/far.spin", folder);
    snprintf(data, sizeof data, "%s/data", folder);
    o.input = in("far", 0, 0);
    if (!ok(spin_import(&o, &r) == SPIN_OK && check_report(r, "frames") == ROWS &&
                check_report(r, "numbers.0") == FIRST,
            "a clip of three frames, numbered as the pictures"))
        printf("#   %s\n", spin_last_error());
    ok(check_report(r, "bounds.min.0") == 10000 &&
           check_report(r, "bounds.min.1") == 20000 - ROWS + 1 &&
           check_report(r, "bounds.min.2") == 30000 &&
           check_report(r, "bounds.max.0") == 10000 + ROWS - 1 &&
           check_report(r, "bounds.max.1") == 20000 && check_report(r, "bounds.max.2") == 30000,
       "the box around all of its frames");
    free(r);
    o.input = in("other", 0, 0);
    o.force = true;
    o.output = in("other.spin", 0, 0);
    ok(spin_import(&o, NULL) == SPIN_E_USAGE, "other numbers do not meet those of the pictures");
    o.pair = "order";
    ok(spin_import(&o, &r) == SPIN_OK && check_report(r, "numbers.0") == 0,
       "unless paired by order");
    free(r);
}

/* --check-cameras: every overlay is on the darkened image of its own frame and camera. */
static void check_overlays(void)
{
    struct spin_import_options o = {.data = data};
    char overlays[600], *r;
    int good = 0;

    snprintf(overlays, sizeof overlays, "%s/overlays", folder);
    o.input = in("far", 0, 0);
    o.check_cameras = overlays;
    if (!ok(spin_import(&o, &r) == SPIN_OK && check_report(r, "cameras") == ROWS * CAMERAS,
            "nine overlays"))
        return;
    free(r);
    for (int row = 0; row < ROWS; row++)
        for (int k = 0; k < CAMERAS; k++) {
            uint8_t *rgb = NULL;
            int w, h, last = 3 * (W * H - 1);
            double dark = 0.45;
            const char *path = in("overlays/cam_%02d_frame_%05d.png", camera_id[k], FIRST + row);

            if (spin_image_read(path, NULL, &w, &h, &rgb) != SPIN_OK)
                continue;
            dark *= alpha_of(k); /* over black */
            good += w == W && h == H && fabs(rgb[last] - dark * value_of(row, k, 0)) <= 1 &&
                    fabs(rgb[last + 2] - dark * value_of(row, k, 2)) <= 1;
            free(rgb);
        }
    ok(good == ROWS * CAMERAS, "each over the picture of its frame and camera (%d)", good);
}

/* ---- Quality --------------------------------------------------------------------------------- */

static int place_of(int id)
{
    int k = 0;

    while (k < CAMERAS - 1 && camera_id[k] != id)
        k++;
    return k;
}

/* One channel of a pixel with this shift. */
static double pixel_of(int row, int camera, int shift, const float drawn[3], int c)
{
    double a = alpha_of(camera), v = value_of(row, camera, c) + shift, back = (double)drawn[c];

    return rint(a * v + (1 - a) * 255 * back) / 255;
}

/* Its squared error against the rendered colour. */
static double error_of(int row, int camera, int shift, const float drawn[3], int c)
{
    return pow(pixel_of(row, camera, shift, drawn, c) - (double)drawn[c], 2);
}

/* Mean squared error over the channels. */
static double errors(int row, int camera, int shift, const float drawn[3])
{
    double sum = 0;

    for (int c = 0; c < 3; c++)
        sum += error_of(row, camera, shift, drawn, c) / 3;
    return sum;
}

/* Mean squared error of a view against the mean colour of its camera's views, which fits best to a
 * render of one colour. */
static double fitted_errors(const struct spin_eval_report *r, size_t view, const float drawn[3])
{
    double sum = 0;

    for (int c = 0; c < 3; c++) {
        double mean = 0, n = 0;

        for (int pass = 0; pass < 2; pass++)
            for (size_t i = 0; i < r->n_views; i++) {
                int row = r->view[i].frame - FIRST, k = place_of(r->view[i].camera);
                double share = (double)n_dynamic(row, k) / (W * H),
                       moving = pixel_of(row, k, SHIFT, drawn, c),
                       still = pixel_of(row, k, 0, drawn, c);

                if (pass == 0 && r->view[i].camera == r->view[view].camera && ++n > 0)
                    mean += (share * moving + (1 - share) * still - mean) / n;
                if (pass == 1 && i == view)
                    sum += share * pow(moving - mean, 2) + (1 - share) * pow(still - mean, 2);
            }
    }
    return sum / 3;
}

static double decibels(double mse) { return -10 * log(mse) / log(10); }

struct sums {
    double psnr, dynamic, still, share, ssim;
    int n, n_dynamic;
};

static bool is(double got, double want)
{
    return isnan(want) ? isnan(got) : fabs(got - want) < 2e-4;
}

/* Checks every view, and sums up the values. */
static bool views_are_right(const struct spin_eval_report *r, const float drawn[3], struct sums *s)
{
    bool good = true;

    memset(s, 0, sizeof *s);
    for (size_t i = 0; i < r->n_views; i++) {
        const struct spin_quality *q = &r->view[i].q;
        int row = r->view[i].frame - FIRST, k = place_of(r->view[i].camera);
        double share = (double)n_dynamic(row, k) / (W * H);
        double dynamic = errors(row, k, SHIFT, drawn), still = errors(row, k, 0, drawn);
        bool few = n_dynamic(row, k) < 16;
        double channels = 0;

        for (int c = 0; c < 3; c++)
            channels += decibels(share * error_of(row, k, SHIFT, drawn, c) +
                                 (1 - share) * error_of(row, k, 0, drawn, c)) /
                        3;
        good = good && is(q->psnr_channel_mean, channels) &&
               is(q->psnr_colour_fitted, decibels(fitted_errors(r, i, drawn))) &&
               is(q->psnr, decibels(share * dynamic + (1 - share) * still)) &&
               is(q->psnr_dynamic, few ? NAN : decibels(dynamic)) &&
               is(q->psnr_static, decibels(still)) && is(q->dynamic, share) && q->valid;
        s->psnr += q->psnr;
        s->ssim += q->ssim;
        s->still += q->psnr_static;
        s->share += q->dynamic;
        s->dynamic += few ? 0 : q->psnr_dynamic;
        s->n_dynamic += !few;
        s->n++;
    }
    return good;
}

static bool means_are_right(const struct spin_quality *q, const struct sums *s)
{
    return q->valid && is(q->psnr, s->psnr / s->n) && is(q->ssim, s->ssim / s->n) &&
           is(q->psnr_static, s->still / s->n) && is(q->dynamic, s->share / s->n) &&
           is(q->psnr_dynamic, s->dynamic / s->n_dynamic);
}

static void check_eval(const struct spin_eval_options *o, size_t n_views, const char *what)
{
    struct spin_eval_report r;
    struct sums s;
    float drawn[3];
    int seen[ROWS][CAMERAS] = {{0}}, most = 0;

    for (int c = 0; c < 3; c++)
        drawn[c] = fminf(fmaxf(o->background[c], 0), 1);
    if (!ok(spin_evaluate(o, &r) == SPIN_OK && r.n_views == n_views, "%s: %zu views", what,
            n_views)) {
        printf("#   %zu, %s\n", r.n_views, spin_last_error());
        return;
    }
    for (size_t i = 0; i < r.n_views; i++) {
        int *at = &seen[r.view[i].frame - FIRST][place_of(r.view[i].camera)];

        most = ++*at > most ? *at : most;
    }
    ok(most == 1, "%s: each once", what);
    ok(r.dynamic == SPIN_DYNAMIC_MASKS, "%s: what moves is known from the masks", what);
    ok(views_are_right(&r, drawn, &s), "%s: the PSNR of every view, and of what moves", what);
    ok(means_are_right(&r.mean, &s), "%s: means over the views that have it", what);
    spin_eval_report_free(&r);
}

static void check_quality(void)
{
    struct spin_eval_options o = {.input = bundle, .device = "cpu", .n_threads = 1};
    static const int held_out[] = {0, 3}, none[] = {5};
    struct spin_eval_report r;

    o.background[0] = 0.1f;
    o.background[1] = 0.5f;
    o.background[2] = 0.9f;
    check_eval(&o, ROWS, "held out");
    o.split = SPIN_SPLIT_TRAIN;
    check_eval(&o, 2 * ROWS, "training");
    o.split = SPIN_SPLIT_ALL;
    check_eval(&o, 3 * ROWS, "all");
    o.range = (struct spin_range){true, FIRST + 1, FIRST + 3, 1};
    check_eval(&o, 3 * 2, "two frames");
    o.split = SPIN_SPLIT_TEST;
    o.test_cameras = held_out;
    o.n_test_cameras = 2;
    check_eval(&o, 2 * 2, "two frames, other cameras held out");
    o.split = SPIN_SPLIT_TRAIN;
    o.range.given = false;
    check_eval(&o, ROWS, "all frames, the camera left");
    o.background[0] = 1.5f;
    o.background[2] = -0.5f;
    check_eval(&o, ROWS, "pictures out of range are cut off before they are compared");
    o.split = SPIN_SPLIT_TEST;
    o.test_cameras = none;
    o.n_test_cameras = 1;
    ok(spin_evaluate(&o, &r) == SPIN_OK && r.n_views == ROWS && r.view[0].camera == 5,
       "the held-out camera is the one that was asked for");
    spin_eval_report_free(&r);
}

/* ---- Flicker --------------------------------------------------------------------------------- */

/* Mean of the change of the dynamic columns of camera k in the images, minus `render`. */
static double dynamic_change(int k, double render)
{
    double sum = 0;
    int n = 0;

    for (int row = 1; row < ROWS; row++)
        for (int i = 0; i < MOVING * H; i++) {
            bool before = n_dynamic(row - 1, k) > 1 || i == 0,
                 now = n_dynamic(row, k) > 1 || i == 0;

            sum += fabs(render - (30 + SHIFT * (now - before)));
            n++;
        }
    return sum / n;
}

/* A splat that covers all images has three greys, one in each frame: 0.28209 apart, with the
 * largest opacity of 0.99. The images are 30 apart from frame to frame. */
static void check_flicker(void)
{
    struct spin_import_options import = {.data = data};
    struct spin_eval_options o = {.device = "cpu", .n_threads = 1, .temporal = true};
    double step = 255 * 0.99 * 0.28209479;
    struct spin_flicker mean;
    struct spin_eval_report r;

    mkdir(in("greys", 0, 0), 0777);
    for (int row = 0; row < ROWS; row++) {
        char values[80];

        snprintf(values, sizeof values, "0 0 2 %d %d %d 9 3 3 3 1 0 0 0", row - 1, row - 1,
                 row - 1);
        write_cloud("greys/f%d.ply", FIRST + row, values);
    }
    import.input = in("greys", 0, 0);
    o.input = import.output = in("greys.spin", 0, 0);
    if (!ok(spin_import(&import, NULL) == SPIN_OK && spin_evaluate(&o, &r) == SPIN_OK &&
                r.n_flicker == 1 && r.flicker[0].camera == 5,
            "flicker of the held-out camera"))
        return;
    mean = spin_flicker_mean(r.flicker, r.n_flicker);
    near(mean.render, step, 0.01, "flicker of the renders");
    near(mean.images, 30, 1e-3, "flicker of the images");
    near(mean.dynamic_error, dynamic_change(2, step), 0.01, "wrong changes where something moves");
    ok(r.flicker[0].n_dynamic == 2 * 3 * MOVING * H &&
           r.flicker[0].n_static == 2 * 3 * (W - MOVING) * H,
       "a pixel is static if it is so in both frames");
    spin_eval_report_free(&r);
    o.split = SPIN_SPLIT_ALL;
    o.dynamic = SPIN_DYNAMIC_OFF;
    ok(spin_evaluate(&o, &r) == SPIN_OK && r.n_flicker == 3, "flicker of three cameras");
    mean = spin_flicker_mean(r.flicker, 1);
    near(mean.images, 30, 1e-3, "flicker of the first camera");
    mean = spin_flicker_mean(r.flicker + 1, 1);
    near(mean.images, 30 * alpha_of(1), 0.3, "flicker of images with alpha, over black");
    ok(isnan(mean.dynamic_error), "no dynamic regions, no error there");
    spin_eval_report_free(&r);
    o.range = (struct spin_range){true, FIRST, FIRST + 1, 1};
    ok(spin_evaluate(&o, &r) == SPIN_E_UNSUPPORTED, "one frame has no flicker: %s",
       spin_last_error());
}

/* ---- Camera colours -------------------------------------------------------------------------- */

/* The largest of the log gains (first = 0) or of the offsets (first = 3) of two cameras. */
static double largest_of(const float *exposure, size_t first)
{
    double most = 0;

    for (size_t i = 0; i < 12; i++)
        if (i % 6 / 3 == first / 3)
            most = larger(most, fabs((double)exposure[i]));
    return most;
}

/* One iteration of a small field, in one thread. */
static struct spin_retrain_options small_network(const char *input, const char *output)
{
    struct spin_retrain_options o;

    spin_retrain_preset("paper", &o);
    o.input = input;
    o.output = output;
    o.device = "cpu";
    o.n_threads = 1;
    o.precision = SPIN_PRECISION_FULL;
    o.levels = 4;
    o.hash_log2 = 8;
    o.hidden = 16;
    o.iterations = o.warmup = o.batch = 1;
    return o;
}

/* Where nothing is rendered, a gain has no effect: cameras learn offsets and no gains. A run in
 * which no splat is visible ends with an error, and its checkpoint is kept. */
static void check_tints(void)
{
    struct spin_retrain_options o = small_network(bundle, in("tinted.spin", 0, 0));
    struct spin_retrain_report r;
    struct spin_npz state;
    char part[700];
    float *exposure;

    snprintf(part, sizeof part, "%s.part", o.output);
    o.learn_exposure = SPIN_EXPOSURE_ON;
    o.lr_exposure = 0.01;
    if (!ok(spin_train(&o, &r) == SPIN_E_MALFORMED &&
                strstr(spin_last_error(), "no splat was visible") &&
                spin_npz_open(part, &state) == SPIN_OK,
            "learns colours of cameras that see nothing: %s", spin_last_error()))
        return;
    exposure = check_load_f32(&state, "exposure/p", NULL);
    ok(largest_of(exposure, 0) == 0, "no gains");
    near(largest_of(exposure, 3), 0.005, 1e-6, "offsets, with a mean of 0");
    free(exposure);
    spin_npz_close(&state);
}

/* A black splat on black: again a gain has no effect. The learned values are stored in the bundle
 * under their own names. */
static void check_black(void)
{
    struct spin_import_options import = {.data = data};
    struct spin_retrain_options o;
    struct spin_retrain_report r;
    struct spin_bundle b;
    double offset = 0, gain = 1;

    import.input = in("black", 0, 0);
    import.output = in("black.spin", 0, 0);
    o = small_network(import.output, in("brighter.spin", 0, 0));
    o.residual = SPIN_RESIDUAL_SOURCE;
    o.learn_exposure = SPIN_EXPOSURE_ON;
    o.lr_exposure = 0.01;
    if (!ok(spin_import(&import, NULL) == SPIN_OK && spin_train(&o, &r) == SPIN_OK &&
                spin_bundle_open(o.output, &b) == SPIN_OK,
            "learns the exposure of cameras before a black splat"))
        return;
    for (size_t i = 0; i < 2; i++) {
        const spin_json *one =
            spin_json_at(spin_json_get(spin_json_get(b.json, "trained"), "cameras"), i);

        for (size_t c = 0; c < 3; c++) {
            spin_json_number(spin_json_at(spin_json_get(one, "log_gain"), c), &gain);
            spin_json_number(spin_json_at(spin_json_get(one, "offset"), c), &offset);
            ok(gain == 0, "no gain of camera %zu", i);
            near(fabs(offset), 0.005, 1e-6, "but an offset");
        }
    }
    spin_bundle_close(&b);
}

/* If no splat is visible the image is the background, which also shows through images with alpha:
 * the first loss is known. */
static void check_first_loss(void)
{
    static const int held_out_too[] = {0, 5};
    struct spin_retrain_options o = small_network(bundle, in("first.spin", 0, 0));
    struct spin_retrain_report r;
    char log[600], line[2000] = "";
    const char *l1, *views;
    double want = 0;
    int frame = 0;
    FILE *f;

    snprintf(log, sizeof log, "%s/first.log", folder);
    o.log = log;
    o.test_cameras = held_out_too;
    o.n_test_cameras = 2;
    o.background[0] = 0.9f;
    o.background[1] = 0.1f;
    o.background[2] = 0.6f;
    if (!ok(spin_train(&o, &r) == SPIN_E_MALFORMED &&
                strstr(spin_last_error(), "no splat was visible"),
            "one step over a background"))
        return;
    f = fopen(log, "r");
    if (!f || !fgets(line, sizeof line, f))
        exit(1);
    fclose(f);
    l1 = strstr(line, "\"l1\": ");
    views = strstr(line, "[[");
    if (!ok(l1 && views && sscanf(views, "[[%d, 3]]", &frame) == 1, "is logged"))
        return;
    for (int c = 0; c < 3; c++)
        for (int moves = 0; moves < 2; moves++)
            want += (moves ? MOVING : W - MOVING) / (3.0 * W) * alpha_of(1) *
                    fabs((value_of(frame - FIRST, 1, c) + moves * SHIFT) / 255.0 -
                         (double)o.background[c]);
    near(atof(l1 + 6), want, 0.002, "its loss is that of the pictures over the background");
}

/* ---- A field: storage, speed, images --------------------------------------------------------- */

static void train(void)
{
    struct spin_import_options i = {.input = "fixtures/court-mini/params.npz",
                                    .data = "fixtures/court-mini"};
    struct spin_retrain_options o;
    struct spin_retrain_report r;
    struct spin_eval_options e = {.image_scale = 0.1, .device = "cpu", .n_threads = 1};
    struct spin_eval_report er;
    char source[600];

    snprintf(source, sizeof source, "%s/court.spin", folder);
    snprintf(trained, sizeof trained, "%s/trained.spin", folder);
    i.output = source;
    if (spin_import(&i, NULL) != SPIN_OK)
        exit(1);
    o = small_network(source, trained);
    o.image_scale = 0.1;
    o.iterations = 2;
    o.refine = 2;
    o.residual = SPIN_RESIDUAL_SOURCE;
    o.lr_table = 0.3; /* so that places and times differ */
    o.warmup = 0;
    o.background[1] = e.background[1] = 0.7f;
    if (!ok(spin_train(&o, &r) == SPIN_OK, "frames refined, and a network"))
        printf("#   %s\n", spin_last_error());
    e.input = trained;
    ok(spin_evaluate(&e, &er) == SPIN_OK && er.n_views == 12 && er.trained, "measured again");
    near(er.mean.psnr, r.test.psnr, 1e-5, "from its file, the network is what it was in training");
    near(er.mean.ssim, r.test.ssim, 1e-6, "in its SSIM as well");
    spin_eval_report_free(&er);
}

/* A field whose learning rates are 0 renders the same during and after training: every view of the
 * log has the SSIM of the evaluation, which shows that frames have their times and views their
 * frames. */
static void check_log(void)
{
    struct spin_retrain_options o;
    struct spin_retrain_report r;
    struct spin_eval_options e = {.image_scale = 0.25, .device = "cpu", .n_threads = 1};
    struct spin_eval_report er;
    char source[600], output[600], path[600], line[4096];
    int n = 0, good = 0;
    FILE *f;

    snprintf(source, sizeof source, "%s/court.spin", folder);
    snprintf(output, sizeof output, "%s/still.spin", folder);
    snprintf(path, sizeof path, "%s/still.log", folder);
    o = small_network(source, output);
    o.log = path;
    o.image_scale = 0.25;
    o.iterations = 12;
    o.residual = SPIN_RESIDUAL_SOURCE;
    o.lr_residual = o.lr_table = o.lr_position = o.lr_head_factor = 0;
    e.input = output;
    e.split = SPIN_SPLIT_TRAIN;
    if (!ok(spin_train(&o, &r) == SPIN_OK && spin_evaluate(&e, &er) == SPIN_OK, "learns nothing"))
        return;
    f = fopen(path, "r");
    while (f && fgets(line, sizeof line, f)) {
        const char *ssim = strstr(line, "\"ssim\": "), *views = strstr(line, "\"views\": [[");
        int frame, camera;

        if (!ssim || !views || sscanf(views, "\"views\": [[%d, %d]]", &frame, &camera) != 2)
            continue;
        n++;
        for (size_t i = 0; i < er.n_views; i++)
            good += er.view[i].frame == frame && er.view[i].camera == camera &&
                    fabs(er.view[i].q.ssim - atof(ssim + 8)) < 1e-5;
    }
    if (f)
        fclose(f);
    ok(n == 12 && good == n, "%d of %d views of the log look as they do afterwards", good, n);
    spin_eval_report_free(&er);
}

/* Size in bytes of the members whose names start with `begin`. */
static uint64_t bytes_of(const struct spin_zip *zip, const char *begin)
{
    uint64_t sum = 0;

    for (size_t i = 0; i < zip->n; i++)
        if (!strncmp(zip->member[i].name, begin, strlen(begin)))
            sum += zip->member[i].packed_size;
    return sum;
}

static void check_storage(const struct spin_eval_report *r)
{
    const struct spin_bundle_bytes *s = &r->storage;
    struct spin_npz npz;
    struct stat at;
    uint64_t network;

    if (stat(trained, &at) != 0 || spin_npz_open(trained, &npz) != SPIN_OK)
        exit(1);
    network = bytes_of(&npz.zip, "trained/");
    ok(s->file == (uint64_t)at.st_size, "storage: the file");
    ok(s->source > 0 && s->source == bytes_of(&npz.zip, "source/"), "storage: the source");
    ok(s->refined > 0 && s->refined == bytes_of(&npz.zip, "refined/"), "storage: refined frames");
    ok(s->positions > bytes_of(&npz.zip, "trained/means/") &&
           s->positions ==
               bytes_of(&npz.zip, "trained/means/") + bytes_of(&npz.zip, "trained/residual/"),
       "storage: positions, and what splats have of their own");
    ok(s->table > 0 && s->table == bytes_of(&npz.zip, "trained/table"), "storage: the table");
    ok(s->heads > 0 && s->heads == network - s->positions - s->table, "storage: the heads");
    spin_npz_close(&npz);
}

/* The sum of the reported times per frame and view cannot exceed the elapsed time. */
static void check_speed(void)
{
    struct spin_eval_options o = {
        .input = trained, .image_scale = 0.1, .device = "cpu", .n_threads = 1};
    struct spin_eval_report r;
    double start = spin_now_s(), took;

    o.dynamic = SPIN_DYNAMIC_OFF;
    o.test_cameras = (const int[]){0};
    o.n_test_cameras = 1;
    if (!ok(spin_evaluate(&o, &r) == SPIN_OK && r.n_views == 6, "a view of every frame"))
        return;
    took = spin_now_s() - start;
    ok(r.dynamic == SPIN_DYNAMIC_OFF && isnan(r.mean.psnr_dynamic),
       "what moves only when asked for");
    ok(r.seconds_decode > 0 && 6 * r.seconds_decode < took, "seconds to decode are of one frame");
    spin_eval_report_free(&r);

    o.image_scale = 1;
    o.split = SPIN_SPLIT_ALL;
    o.range = (struct spin_range){true, 1, 2, 1};
    o.source = true;
    start = spin_now_s();
    if (!ok(spin_evaluate(&o, &r) == SPIN_OK && r.n_views == 8, "eight views of a frame"))
        return;
    took = spin_now_s() - start;
    ok(r.seconds_draw > 0 && 8 * r.seconds_draw < took, "seconds to draw are of one view");
    check_storage(&r);
    spin_eval_report_free(&r);
}

/* Reads panel k of n of an image of --images. */
static void read_panel(const char *in_folder, int camera, int number, int k, int n, int w, int h,
                       uint8_t *out)
{
    char path[800];
    uint8_t *rgb = NULL;
    int width, height, gap = 4;

    snprintf(path, sizeof path, "%s/%s/cam_%02d_frame_%05d.png", folder, in_folder, camera, number);
    if (spin_image_read(path, NULL, &width, &height, &rgb) != SPIN_OK ||
        !ok(width == n * w + (n - 1) * gap && height == h, "%s: %d pictures beside each other",
            in_folder, n))
        exit(tap_done());
    for (int y = 0; y < h; y++)
        memcpy(out + 3 * y * w, rgb + 3 * ((size_t)y * (size_t)width + (size_t)(k * (w + gap))),
               3 * (size_t)w);
    free(rgb);
}

/* Mean difference of 8-bit images. */
static double difference(const uint8_t *a, const uint8_t *b, int n)
{
    double sum = 0;

    for (int i = 0; i < n; i++)
        sum += abs(a[i] - b[i]);
    return sum / n;
}

static void check_pictures(void)
{
    enum { PW = 80, PH = 45, BYTES = 3 * PW * PH };
    static uint8_t truth[BYTES], panel[3][BYTES], alone[BYTES];
    static float image[BYTES];
    struct spin_eval_options o = {
        .input = trained, .image_scale = 0.5, .device = "cpu", .n_threads = 1};
    struct spin_eval_report r, source;
    char images[700], images2[700];

    snprintf(images, sizeof images, "%s/images", folder);
    snprintf(images2, sizeof images2, "%s/images2", folder);
    o.images = images;
    o.range = (struct spin_range){true, 2, 4, 1};
    if (!ok(spin_evaluate(&o, &r) == SPIN_OK, "draws"))
        return;
    o.images = images2;
    o.source = true;
    if (!ok(spin_evaluate(&o, &source) == SPIN_OK, "draws the source"))
        return;
    if (spin_image_load("fixtures/court-mini/ims/15/000011.jpg", PW, PH, NULL, image) != SPIN_OK)
        exit(1);
    for (int i = 0; i < PW * PH; i++)
        for (int c = 0; c < 3; c++)
            truth[3 * i + c] = (uint8_t)lrintf(255 * image[c * PW * PH + i]);
    for (int k = 0; k < 3; k++)
        read_panel("images", 15, 3, k, 3, PW, PH, panel[k]);
    read_panel("images2", 15, 3, 1, 2, PW, PH, alone);
    ok(difference(panel[0], truth, BYTES) < 0.6, "the truth is on the left");
    ok(difference(panel[1], alone, BYTES) == 0, "then the source");
    ok(difference(panel[2], alone, BYTES) > 0.5, "then what was trained");
    for (size_t i = 0; i < r.n_views; i++)
        if (r.view[i].frame == 3 && r.view[i].camera == 15) {
            double sum = 0;

            for (int k = 0; k < BYTES; k++)
                sum += pow((panel[2][k] - panel[0][k]) / 255.0, 2);
            near(r.view[i].q.psnr, decibels(sum / BYTES), 0.05, "which has the PSNR of that view");
        }
    spin_eval_report_free(&r);
    spin_eval_report_free(&source);
}

/* --panels before, of some frames or of all, gives the same images. */
static void check_before(void)
{
    static const char *const pairs[] = {"panels", "before", NULL};
    struct spin_export_options o = {
        .input = trained, .to = "images", .device = "cpu", .plugin_pairs = pairs};
    struct spin_export_report r;
    uint8_t *rgb[3] = {NULL};
    int w, h;
    char all[700], one[700];

    snprintf(all, sizeof all, "%s/all", folder);
    snprintf(one, sizeof one, "%s/one", folder);
    o.output = all;
    ok(spin_export_clip(&o, &r) == SPIN_OK && r.frames == 6, "draws all frames as imported");
    o.output = one;
    o.range = (struct spin_range){true, 3, 4, 1};
    ok(spin_export_clip(&o, &r) == SPIN_OK && r.frames == 1, "or one of them");
    if (spin_image_read(in("all/cam_15_frame_%05d.png", 3, 0), NULL, &w, &h, &rgb[0]) != SPIN_OK ||
        spin_image_read(in("one/cam_15_frame_%05d.png", 3, 0), NULL, &w, &h, &rgb[1]) != SPIN_OK ||
        spin_image_read(in("all/cam_15_frame_%05d.png", 0, 0), NULL, &w, &h, &rgb[2]) != SPIN_OK)
        exit(1);
    ok(difference(rgb[0], rgb[1], 3 * w * h) == 0, "the same picture");
    ok(difference(rgb[0], rgb[2], 3 * w * h) > 0.1, "which is not that of another frame");
    for (int i = 0; i < 3; i++)
        free(rgb[i]);
}

TAP_MAIN
{
    folder = check_folder();
    if (spin_image_start() != SPIN_OK) {
        skip("measuring", spin_last_error());
        return;
    }
    spin_log_set_level(-2);
    make_clip();
    check_overlays();
    check_quality();
    check_flicker();
    check_tints();
    check_black();
    check_first_loss();
    train();
    check_log();
    check_speed();
    check_pictures();
    check_before();
}
