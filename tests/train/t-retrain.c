/* Retraining does not fail silently: nonfinite values, times in any order, a scene seen from a
 * single position, a checkpoint that must not be resumed.
 * K: retrain sound d3dgs */
#include <sys/statvfs.h>

#include "base/log.h"
#include "spin_run.h"
#include "run/run.h"
#include "scene/clip.h"
#include "model/field_eval.h"
#include "render/raster.h"
#include "tests/check.h"
#include "tests/tap.h"

static char from[400], input[500], output[500], part[600];

/* No permitted rate overflows, so this one is set after the options were checked, when the free
 * disk space is queried. Replaces the C library's function. */
static struct spin_retrain_report report;
static double *late_rate, late_value;

int statvfs(const char *restrict path, struct statvfs *restrict fs)
{
    (void)path;
    *fs = (struct statvfs){.f_bavail = (uint64_t)1 << 40, .f_frsize = 1};
    if (late_rate)
        *late_rate = late_value;
    late_rate = NULL;
    return 0;
}

static void set_late(size_t rate, double value)
{
    late_rate = (double *)((char *)&report.options + rate);
    late_value = value;
}

/* Two frames of the court at a quarter of the size, on a small network. */
static struct spin_retrain_options small(int iterations)
{
    struct spin_retrain_options o;

    spin_retrain_preset("paper", &o);
    o.input = input;
    o.output = output;
    o.range = (struct spin_range){.given = true, .first = 0, .last = 2};
    o.image_scale = 0.25;
    o.iterations = iterations;
    o.batch = 1;
    o.levels = 2;
    o.hash_log2 = 8;
    o.hidden = 8;
    o.device = "cpu";
    o.n_threads = 2;
    o.force = true;
    for (int d = 0; d < 4; d++)
        o.finest_resolution[d] = 16;
    return o;
}

static bool run(const struct spin_retrain_options *o, spin_status want, const char *word)
{
    spin_status status = spin_train(o, &report);
    bool good = status == want && (status == SPIN_OK || strstr(spin_last_error(), word));

    if (!good)
        printf("#   status %d: %s\n", status, status == SPIN_OK ? "done" : spin_last_error());
    return good;
}

/* ---- Values that are not finite -----------------------------------------------------------------
 */

/* A rate that makes an array overflow in the first step. The loss, computed before the step,
 * does not show it; the check before a checkpoint does. */
static void test_array(const char *array, size_t rate, bool colour)
{
    struct spin_retrain_options o = small(3);

    o.residual = SPIN_RESIDUAL_POINTS;
    o.learn_exposure = colour ? SPIN_EXPOSURE_ON : SPIN_EXPOSURE_OFF;
    o.save_every = 1;
    set_late(rate, 1e45);
    ok(run(&o, SPIN_E_MALFORMED, array) && strstr(spin_last_error(), "iteration 1:") != NULL,
       "%s is looked at before it is kept: %s", array, spin_last_error());
    ok(!spin_path_exists(output) && !spin_path_exists(part), "neither output nor state is left");
    remove(output);
    remove(part);
}

/* Splats at nonfinite positions are invisible, so the loss stays finite: they are found at the
 * next check, or at the end. */
static void test_when(int iterations, const char *when)
{
    struct spin_retrain_options o = small(iterations);

    set_late(offsetof(struct spin_retrain_options, lr_position), 1e45);
    ok(run(&o, SPIN_E_MALFORMED, when) && strstr(spin_last_error(), "array 'frames/") != NULL,
       "of %d iterations: %s", iterations, spin_last_error());
    ok(!spin_path_exists(output), "no output");
    remove(output);
}

/* Every array of the checkpoint is finite. */
static bool state_is_finite(const char *path, size_t *n_arrays)
{
    struct spin_npz npz;
    bool good = true;

    *n_arrays = 0;
    if (spin_npz_open(path, &npz) != SPIN_OK)
        return false;
    for (size_t i = 0; i < npz.zip.n; i++) {
        struct spin_array info;
        char name[100];
        float *v;

        snprintf(name, sizeof name, "%.*s", (int)strlen(npz.zip.member[i].name) - 4,
                 npz.zip.member[i].name);
        if (strcmp(npz.zip.member[i].name, "state.json") == 0)
            continue;
        v = check_load_f32(&npz, name, &info);
        for (size_t k = 0; v && k < info.count; k++)
            good = good && isfinite(v[k]);
        free(v);
        ++*n_arrays;
    }
    spin_npz_close(&npz);
    return good;
}

/* Rates rise until positions overflow; each earlier iteration has saved a checkpoint. */
static void test_last_good(void)
{
    struct spin_retrain_options o = small(200);
    size_t n = 0;
    bool good;

    set_late(offsetof(struct spin_retrain_options, lr_position), 1e39);
    o.lr_table = o.lr_head_factor = 0;
    o.warmup = 100;
    o.save_every = 1;
    ok(run(&o, SPIN_E_MALFORMED, "finite"), "positions run away: %s", spin_last_error());
    ok(strstr(spin_last_error(), "the checkpoint of iteration") && strstr(spin_last_error(), part),
       "the error says where the last good state is");
    good = state_is_finite(part, &n);
    ok(good && n >= 15, "which is finite, all of its %zu arrays", n);
    ok(!spin_path_exists(output), "no output");
    remove(part);
}

/* ---- Times --------------------------------------------------------------------------------------
 */

/* The bundle with other times of its first three frames. */
static void write_times(double a, double b, double c)
{
    struct spin_bundle in;
    struct spin_bundle_writer w;
    struct spin_splats s = {0};
    struct spin_bundle_meta *meta = &in.meta;
    const double times[3] = {a, b, c};

    if (spin_bundle_open(from, &in) != SPIN_OK ||
        spin_bundle_writer_open(input, true, false, &w) != SPIN_OK)
        exit(1);
    for (int f = 0; f < meta->n_frames; f++) {
        if (f < 3)
            meta->frame[f].time = times[f];
        if (spin_bundle_frame(&in, f, meta->columns, &s) != SPIN_OK ||
            spin_bundle_write_frame(&w, f, meta->columns, meta->static_columns, &s) != SPIN_OK)
            exit(1);
    }
    if (spin_bundle_writer_finish(&w, meta, NULL) != SPIN_OK)
        exit(1);
    spin_splats_free(&s);
    spin_bundle_close(&in);
}

static double of_field(const char *key)
{
    struct spin_bundle b;
    double value = NAN;

    if (spin_bundle_open(output, &b) != SPIN_OK)
        return NAN;
    spin_json_number(spin_json_get(spin_json_get(spin_json_get(b.json, "trained"), "field"), key),
                     &value);
    spin_bundle_close(&b);
    return value;
}

static void test_times(void)
{
    struct spin_retrain_options o = small(2);

    o.range.last = 3;
    write_times(7, 4, 5.5);
    ok(run(&o, SPIN_OK, NULL), "retrains frames in any order of time");
    near(of_field("time_first"), 4, 0, "the network's times begin with the earliest");
    near(of_field("time_last"), 7, 0, "and end with the latest");
    remove(output);
    write_times(4, 7, 4);
    ok(run(&o, SPIN_E_MALFORMED, "frames 0 and 2 have the same time, 4"),
       "two frames at one time are refused: %s", spin_last_error());
    ok(!spin_path_exists(output), "without output");
    o.range.last = 2;
    ok(run(&o, SPIN_OK, NULL), "unless one of them is left out");
    remove(output);
    write_times(0, 1, 2);
}

static void test_check_times(void)
{
    struct spin_frame_info info[4] = {
        {.number = 3, .time = 1}, {.number = 4, .time = 0}, {.number = 5, .time = 1}, {0}};
    const int index[2] = {0, 1};

    ok(spin_times_check(info, NULL, 3) == SPIN_E_MALFORMED &&
           strstr(spin_last_error(), "frames 3 and 5"),
       "the frames of one time are named");
    ok(spin_times_check(info, NULL, 2) == SPIN_OK && spin_times_check(info, index, 2) == SPIN_OK,
       "others may come in any order");
    info[3].time = NAN;
    ok(spin_times_check(info + 3, NULL, 1) == SPIN_E_MALFORMED, "a time is a number");
}

/* ---- Seeds --------------------------------------------------------------------------------------
 */

/* From 2^53 on a JSON number cannot represent every integer. */
static void test_seeds(void)
{
    struct spin_retrain_options o = small(2);

    o.seed = ((uint64_t)1 << 53) - 1;
    ok(run(&o, SPIN_OK, NULL), "retrains with a seed of 2^53 - 1");
    o.force = false;
    o.resume = true;
    ok(run(&o, SPIN_OK, NULL), "--resume finds it finished");
    o.seed--;
    ok(run(&o, SPIN_E_IO, "exists"), "with 2^53 - 2 it is another run: %s", spin_last_error());
    o.seed += 2;
    ok(run(&o, SPIN_E_USAGE, "seed 9007199254740992 is not in the range 0 to 9007199254740991"),
       "2^53 is refused: %s", spin_last_error());
    remove(output);
}

/* ---- Memory -------------------------------------------------------------------------------------
 */

static size_t no_memory(struct spin_device *d)
{
    (void)d;
    return 0;
}

/* A splat in front of the camera, on a device without memory for the lists. */
static void test_pairs(void)
{
    struct spin_camera camera = {.width = 64,
                                 .height = 64,
                                 .fx = 60,
                                 .fy = 60,
                                 .cx = 32,
                                 .cy = 32,
                                 .w2c = {1, 0, 0, 0, 0, 1}};
    struct spin_device *d = check_device(1), poor;
    struct spin_device_ops ops;
    float pos[3] = {0, 0, 3}, attr[SPIN_ATTR] = {0}, black[3] = {0};
    struct spin_frame_batch frames = spin_one_frame(1, pos, 0, NULL);
    struct spin_raster raster;

    if (!d)
        return;
    camera.w2c[10] = 1;
    attr[SPIN_ATTR_SCALE] = attr[SPIN_ATTR_SCALE + 1] = attr[SPIN_ATTR_SCALE + 2] = 1;
    attr[SPIN_ATTR_ROTATION] = attr[SPIN_ATTR_OPACITY] = 1;
    for (int k = 0; k < 2; k++) {
        struct spin_view_batch views;

        poor = *d;
        ops = *d->op;
        poor.op = &ops;
        if (k == 1)
            ops.memory_available = no_memory;
        if (!ok(spin_raster_open(&raster, &poor, 1, 64 * 64, 16, 1, true) == SPIN_OK, "opens"))
            return;
        views = spin_raster_batch(&raster, black);
        spin_raster_add_view(&raster, &views, 0, 1, &camera, false);
        if (k == 0)
            ok(spin_raster_forward(&raster, &views, &frames, attr, 0) == SPIN_OK &&
                   raster.tiles.n_intersections == 16,
               "a splat over 16 tiles");
        else
            ok(spin_raster_forward(&raster, &views, &frames, attr, 0) == SPIN_E_MEMORY &&
                   strstr(spin_last_error(), "16 pairs of splats and tiles") != NULL,
               "is refused where memory has no room for its pairs: %s", spin_last_error());
        spin_raster_close(&raster);
    }
    check_device_free(d);
}

TAP_MAIN
{
    const char *run_of = check_fixture("court-mini/params.npz"),
               *data = check_fixture("court-mini");
    struct spin_import_options o = {.input = run_of, .output = from, .data = data};

    spin_log_set_level(-1);
    test_pairs();
    if (!run_of) {
        skip("retraining", "no fixture court-mini");
        return;
    }
    snprintf(from, sizeof from, "%s/from.spin", check_folder());
    snprintf(input, sizeof input, "%s/in.spin", check_folder());
    snprintf(output, sizeof output, "%s/out.spin", check_folder());
    snprintf(part, sizeof part, "%s.part", output);
    ok(spin_import(&o, NULL) == SPIN_OK, "imports the court");
    write_times(0, 1, 2);
    test_array("table/p", offsetof(struct spin_retrain_options, lr_table), false);
    test_array("heads/p", offsetof(struct spin_retrain_options, lr_head_factor), false);
    test_array("frames/", offsetof(struct spin_retrain_options, lr_position), false);
    test_array("residual/", offsetof(struct spin_retrain_options, lr_residual), false);
    test_array("exposure/p", offsetof(struct spin_retrain_options, lr_exposure), true);
    test_when(2, "iteration 2:");
    test_when(150, "iteration 100:");
    test_last_good();
    test_times();
    test_check_times();
    test_seeds();
}
