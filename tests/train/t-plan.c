/* The estimates of time and memory: each term, with the options that change it.
 * K: retrain plan estimates */
#include "base/base.h"
#include "spin_run.h"
#include "io/image.h"
#include "train/photos.h"
#include "train/plan.h"
#include "tests/check.h"
#include "tests/tap.h"

static char bundle[700], output[700];
static struct spin_device *device;
static struct spin_retrain_report report;

static void open_plan(struct spin_plan *plan, const struct spin_retrain_options *o, double edges,
                      double empty)
{
    memset(plan, 0, sizeof *plan);
    memset(&report, 0, sizeof report);
    if (spin_plan_open(plan, o, &report) != SPIN_OK) {
        ok(0, "%s", spin_last_error());
        exit(1);
    }
    spin_plan_set_device(plan, device);
    spin_plan_set_content(plan, edges, empty, 0);
}

static struct spin_retrain_options options(const char *preset)
{
    struct spin_retrain_options o;

    spin_retrain_preset(preset, &o);
    o.input = bundle;
    o.output = output;
    o.n_threads = 1;
    return o;
}

/* ---- Time ------------------------------------------------------------------------------------ */

enum {
    SPLATS = 2940,
    PIXELS = 160 * 90,
    FRAMES = 6,
    ITERATIONS = 1000,
    TRAIN = 6 * FRAMES,
    TEST = 2 * FRAMES
};

struct row {
    const char *name;
    enum spin_method method;
    int batch, densify_every, max_points, eval_every, refine, n_threads;
    double empty;
    double grown;      /* factor of the number of splats at the end */
    double mean_grown; /* and on average over the iterations */
    int frames;        /* evaluated by an iteration */
    int tests;         /* measurements of all test views */
};

/* The estimate by the constants of src/train/plan.c, which are fitted to measurements. */
static double seconds_of(const struct row *r, size_t n_table, double refined)
{
    double pixels = PIXELS * (1 - 0.5 * r->empty) * 0.1e-6, splats = SPLATS * r->mean_grown;
    double each = r->batch * (splats * 0.13e-6 + pixels), seconds;

    each += r->frames * splats * 0.05e-6;
    if (r->method == SPIN_METHOD_NETWORK)
        each += r->frames * splats * 2.7e-6 + (double)n_table * 1.1e-9;
    seconds = ITERATIONS * each;
    splats = SPLATS * r->grown;
    seconds += FRAMES * splats * 4e-6 + (double)TRAIN * PIXELS * 0.045e-6 +
               r->tests * TEST * 0.06e-6 * (splats + PIXELS);
    if (r->method == SPIN_METHOD_NETWORK)
        seconds += (double)n_table * 0.18e-6;
    if (r->method == SPIN_METHOD_FRAMES)
        seconds = 0;
    if (r->refine > 0)
        seconds += FRAMES * r->refine * (SPLATS * (1 + refined) / 2 * 2 * 0.13e-6 + 0.4 * pixels);
    return seconds / r->n_threads;
}

static void check_times(void)
{
    /* 400 edges: densification adds 415 * 20 = 8300 splats, 2.823 times as many as there are. */
    const double many = 1 + 8300.0 / SPLATS, some = 4000.0 / SPLATS;
    const enum spin_method tracks = SPIN_METHOD_TRACKS, net = SPIN_METHOD_NETWORK,
                           frames = SPIN_METHOD_FRAMES;
    const struct row rows[] = {
        {"not densified", tracks, 6, 0, 0, 0, 0, 1, 0, 1, 1, 1, 2},
        {"seven images an iteration, half empty", tracks, 7, 0, 0, 0, 0, 1, 0.5, 1, 1, 2, 2},
        {"three threads", tracks, 6, 0, 0, 0, 0, 3, 0, 1, 1, 1, 2},
        {"measured every 300 iterations", tracks, 6, 0, 0, 300, 0, 1, 0, 1, 1, 1, 5},
        {"densified", tracks, 6, 50, 0, 0, 0, 1, 0, many, 1 + (many - 1) * 0.8, 1, 2},
        {"densified to 4000", tracks, 6, 50, 4000, 0, 0, 1, 0, some, 1 + (some - 1) * 0.8, 1, 2},
        {"more splats than the limit", tracks, 6, 50, 2000, 0, 0, 1, 0, 1, 1, 1, 2},
        {"a network", net, 8, 0, 0, 0, 0, 1, 0, 1, 1, 2, 2},
        {"a network of refined frames", net, 8, 0, 0, 0, 50, 1, 0, 1, 1, 2, 2},
        {"frames", frames, 8, 0, 0, 0, 600, 1, 0.25, 1, 1, 2, 2},
        {"frames to 4000 splats", frames, 8, 0, 4000, 0, 600, 1, 0, 1, 1, 2, 2},
    };

    for (size_t i = 0; i < sizeof rows / sizeof *rows; i++) {
        const struct row *r = &rows[i];
        struct spin_retrain_options o = options(r->method == net ? "short" : "quick");
        struct spin_plan plan;
        double refined = SPLATS, slower;

        o.method = r->method;
        o.tracks = r->method == tracks;
        o.iterations = o.track_iterations = ITERATIONS;
        o.batch = r->batch;
        o.views_per_frame = 6;
        o.densify_every = r->densify_every;
        o.densify_until = 0.5;
        o.densify = true;
        o.max_points = r->max_points;
        o.eval_every = r->eval_every;
        o.refine = r->refine;
        o.n_threads = r->n_threads;
        open_plan(&plan, &o, 400, r->empty);
        slower = strcmp(device->path, "base") == 0 ? 2 : strcmp(device->path, "v3") == 0 ? 1.3 : 1;
        /* Every 100 iterations after a fifth of them, until three quarters: adds 210 * 20 splats,
         * but not more than three fifths. */
        for (int at = 100; at < 3 * o.refine / 4; at += 100)
            if (at > o.refine / 5)
                refined += fmin(0.6 * refined, 210 * 20.0);
        if (r->max_points > 0)
            refined = fmin(refined, r->max_points);
        near(report.seconds_estimated / slower /
                 seconds_of(r, plan.field.n_table, refined / SPLATS),
             1, 1e-9, r->name);
        spin_plan_close(&plan);
    }
}

/* ---- Memory ---------------------------------------------------------------------------------- */

/* Bytes that the estimate counts for frames of these sizes. */
static size_t bytes_of(struct spin_plan *plan, struct spin_frame_size each, size_t n_tracks)
{
    static struct spin_frame_size size[FRAMES];

    for (int f = 0; f < FRAMES; f++)
        size[f] = each;
    spin_plan_set_sizes(plan, size, n_tracks, 0);
    return report.bytes_needed;
}

static void check_memory(void)
{
    static const char *const names[] = {"a splat", "a splat without a track", "a position",
                                        "residual values", "a track"};
    /* Numbers of 4 bytes: in 6 frames, a position of 3 or 11 residual values are stored with two
     * moments and an average; a track has 14 values with a gradient, too. */
    static const double floats[] = {117, 6 * 3 * 4, 6 * 3 * 4, 6 * 11 * 4, 14 * 5};
    struct spin_retrain_options o = options("quick");
    struct spin_plan plan;
    size_t n = SPLATS, more = 1000, before, images, plain = 0;

    o.densify_every = 0;
    open_plan(&plan, &o, 0, 0);
    ok(plan.n_train == TRAIN && plan.n_test == TEST && plan.max_pixels == PIXELS,
       "%zu and %zu images", plan.n_train, plan.n_test);
    before = bytes_of(&plan, (struct spin_frame_size){n, n, n, n}, n);
    for (int k = 0; k < 5; k++) {
        struct spin_frame_size size = {n + (k == 0 ? more : 0), n + (k == 1 ? more : 0),
                                       n + (k == 2 ? more : 0), n + (k == 3 ? more : 0)};

        near((double)(bytes_of(&plan, size, n + (k == 4 ? more : 0)) - before) / 4 / (double)more,
             floats[k], 2, names[k]);
    }
    images = report.bytes_available / 3;
    ok(plan.pixels_budget == images, "a third of the memory is for images");
    spin_plan_set_sizes(&plan, NULL, 0, (size_t)1 << 50);
    ok(plan.pixels_budget == (size_t)1 << 50, "or as much as they have");
    report.bytes_available = report.bytes_needed;
    ok(!spin_plan_is_short(&plan) && spin_plan_check_memory(&plan) == SPIN_OK, "just enough");
    report.bytes_needed++;
    snprintf(report.fitting, sizeof report.fitting, "--some");
    ok(spin_plan_is_short(&plan) && spin_plan_check_memory(&plan) == SPIN_E_MEMORY &&
           strstr(spin_last_error(), "use --some, which fits"),
       "a byte too little: %s", spin_last_error());
    report.fitting[0] = '\0';
    ok(spin_plan_check_memory(&plan) == SPIN_E_MEMORY && strstr(spin_last_error(), "no smaller"),
       "%s", spin_last_error());
    report.bytes_available = 0;
    ok(!spin_plan_is_short(&plan) && spin_plan_check_memory(&plan) == SPIN_OK, "not known");
    spin_plan_close(&plan);
    for (int k = 0; k < 3; k++) {
        static const double bytes[] = {0, 3 * PIXELS, 6 * PIXELS / 8};

        o.batch = k == 1 ? 7 : 6;
        o.dynamic_weight = k == 2 ? 2 : 1;
        open_plan(&plan, &o, 0, 0);
        plain = k == 0 ? report.bytes_needed : plain;
        near((double)(report.bytes_needed - plain), bytes[k], 64,
             k == 1 ? "one more image at once" : "a mask of each image");
        spin_plan_close(&plan);
    }
}

/* ---- Content of images ----------------------------------------------------------------------- */

/* Eight images: pixels that differ by more than 24 of 255 from their neighbours on the right and
 * below, in the mean of all channels, and pixels within 16 of the background, in all channels. */
static void check_content(void)
{
    struct spin_retrain_options o = options("quick");
    const float background[3] = {0.41f, 0.35f, 0.3f};
    struct spin_photos photos = {0};
    struct spin_plan plan;
    double edges = 0, empty = 0;

    memcpy(o.background, background, sizeof background);
    open_plan(&plan, &o, 0, 0);
    for (int i = 0; i < 8; i++) {
        size_t view = plan.train[(2 * i + 1) * TRAIN / 16].view;
        const int to[2] = {3, 3 * 160};
        uint8_t *rgb = NULL;
        int width, height;

        if (spin_image_read(plan.clip.views.view[view].path, background, &width, &height, &rgb) !=
            SPIN_OK)
            exit(1);
        for (int k = 0; k < 89 * 160; k++) {
            int off = 0, near_it = 0;

            for (int c = 0; c < 6; c++)
                off += abs(rgb[3 * k + c % 3 + to[c / 3]] - rgb[3 * k + c % 3]);
            for (int c = 0; c < 3; c++)
                near_it += fabs(rgb[3 * k + c] - 255.0 * (double)background[c]) <= 16;
            edges += k % 160 < 159 && off > 6 * 24;
            empty += k % 160 < 159 && near_it == 3;
        }
        free(rgb);
    }
    ok(spin_photos_open(&photos, &plan) == SPIN_OK &&
           spin_photos_measure_content(&photos, &plan) == SPIN_OK && empty > 1000,
       "measures images");
    near(plan.edges, edges / 8, 1e-9, "edges");
    near(plan.empty, empty / 8 / PIXELS, 1e-9, "background");
    spin_photos_close(&photos);
    spin_plan_close(&plan);
}

/* ---- Options that fit ------------------------------------------------------------------------ */

static size_t free_bytes;

static size_t memory_available(struct spin_device *d)
{
    (void)d;
    return free_bytes;
}

static void check_fitting(void)
{
    struct spin_device small = *device;
    struct spin_device_ops op = *device->op;
    static const struct {
        enum spin_method method;
        int hash_log2, batch, step;
        double scale, share; /* of the needed memory that is free */
        const char *fitting;
    } rows[] = {
        {SPIN_METHOD_TRACKS, 12, 6, 1, 1, 1, ""},
        {SPIN_METHOD_TRACKS, 12, 6, 1, 1, 0.99, "--scale 0.5"},
        {SPIN_METHOD_TRACKS, 12, 6, 1, 1, 0.82, "--scale 0.5 --range 0:3"},
        {SPIN_METHOD_TRACKS, 12, 6, 1, 1, 0.5, ""},
        {SPIN_METHOD_TRACKS, 12, 6, 2, 1, 0.99, "--scale 0.5"},
        {SPIN_METHOD_TRACKS, 12, 6, 2, 1, 0.82, ""},
        {SPIN_METHOD_TRACKS, 12, 6, 1, 0.5, 0.99, "--scale 0.25"},
        {SPIN_METHOD_TRACKS, 12, 24, 1, 1, 0.99, "--batch 6"},
        {SPIN_METHOD_TRACKS, 12, 24, 1, 1, 0.8, "--scale 0.25"},
        {SPIN_METHOD_NETWORK, 18, 8, 1, 1, 0.99, "--hash-log2 17"},
        {SPIN_METHOD_NETWORK, 18, 8, 1, 1, 0.6, "--hash-log2 17"},
        {SPIN_METHOD_NETWORK, 18, 8, 1, 1, 0.2, "--hash-log2 15 --scale 0.5 --range 0:1"},
        {SPIN_METHOD_NETWORK, 18, 8, 2, 0.5, 0.2, ""},
        {SPIN_METHOD_NETWORK, 15, 8, 1, 1, 0.99, "--scale 0.5"},
        {SPIN_METHOD_NETWORK, 14, 8, 1, 1, 0.94, "--scale 0.5 --range 0:3"},
        {SPIN_METHOD_NETWORK, 18, 24, 1, 1, 0.99, "--hash-log2 17"},
        {SPIN_METHOD_NETWORK, 18, 24, 1, 1, 0.2,
         "--hash-log2 15 --batch 6 --scale 0.25 --range 0:3"},
    };
    char what[120];

    op.memory_available = memory_available;
    small.op = &op;
    small.is_host = false;
    for (size_t i = 0; i < sizeof rows / sizeof *rows; i++) {
        bool network = rows[i].method == SPIN_METHOD_NETWORK;
        struct spin_retrain_options o = options(network ? "short" : "quick");
        struct spin_plan plan;

        o.hash_log2 = rows[i].hash_log2;
        o.batch = rows[i].batch;
        o.views_per_frame = 6;
        o.image_scale = rows[i].scale;
        o.densify_every = 0;
        o.refine = 0;
        o.range = (struct spin_range){rows[i].step > 1, 0, FRAMES, rows[i].step};
        open_plan(&plan, &o, 0, 0);
        free_bytes = 0;
        spin_plan_set_device(&plan, &small);
        free_bytes = (size_t)(rows[i].share * (double)report.bytes_needed);
        spin_plan_set_device(&plan, &small);
        snprintf(what, sizeof what, "row %zu fits %g of the memory: '%s'", i, rows[i].share,
                 rows[i].fitting);
        is_text(report.fitting, rows[i].fitting, what);
        ok(isnan(report.seconds_estimated) && report.bytes_available == free_bytes,
           "on a device without an estimate of time");
        spin_plan_close(&plan);
    }
}

/* ---- Single frames --------------------------------------------------------------------------- */

static void check_frame(void)
{
    struct spin_retrain_options o = options("quick");
    struct spin_plan plan, one = {0};
    int wrong = 0;

    o.method = SPIN_METHOD_FRAMES;
    o.refine = 2500;
    o.batch = o.views_per_frame = 6;
    o.sh_degree = 3;
    o.sh_increase_every = 0;
    open_plan(&plan, &o, 400, 0);
    ok(spin_sh_degree_reached(3, 0, 1) == 3 && spin_sh_degree_reached(3, 1000, 1000) == 0 &&
           spin_sh_degree_reached(3, 1000, 1001) == 1 && spin_sh_degree_reached(2, 1000, 9000) == 2,
       "SH degrees that are reached");
    ok(spin_plan_sh_increase_every(&plan) == 1000 && spin_plan_frame_sh_degree(&plan) == 2,
       "of frames from points");
    for (int i = 0; i < SPIN_EXPOSURE * plan.lenses.n; i++)
        plan.exposure[SPIN_EXPOSURE * plan.n_cameras + i] = (float)i + 0.5f;
    if (!ok(spin_plan_of_frame(&plan, 2, device, &one) == SPIN_OK, "the plan of a frame"))
        exit(1);
    ok(one.o->iterations == 2500 && one.o->batch == 1 && one.o->views_per_frame == 1 &&
           one.o->sh_increase_every == 1000 && one.field.sh_degree == 2 && one.n_test == 0,
       "its options");
    ok(one.clip.n_frames == 1 && one.clip.frame[0] == 2 && one.counts[0] == SPLATS &&
           one.n_train == TRAIN / FRAMES && one.n_cameras == TRAIN / FRAMES && plan.lenses.n > 0,
       "its splats, cameras and lenses");
    for (size_t i = 0; i < one.n_train; i++)
        wrong += one.train[i].frame != 0 || one.train[i].view != plan.train[12 + i].view ||
                 plan.train[12 + i].frame != 2 || one.camera[i] != plan.camera[i];
    for (int i = 0; i < SPIN_EXPOSURE * plan.lenses.n; i++)
        wrong += one.exposure[SPIN_EXPOSURE * one.n_cameras + i] != (float)i + 0.5f;
    ok(wrong == 0, "its images, and the falloff of all lenses: %d are wrong", wrong);
    spin_plan_close_frame(&one);
    report.options.refine_start = SPIN_REFINE_FROM_SOURCE;
    ok(spin_plan_sh_increase_every(&plan) == 0 &&
           spin_plan_frame_sh_degree(&plan) == plan.clip.bundle.meta.sh_degree,
       "frames from the source have its degree");
    report.options.method = SPIN_METHOD_TRACKS;
    ok(spin_plan_frame_sh_degree(&plan) == 0, "tracks have none");
    spin_plan_close(&plan);
}

TAP_MAIN
{
    struct spin_import_options i = {
        .input = "fixtures/court-mini/params.npz", .data = "fixtures/court-mini", .output = bundle};

    spin_log_set_level(-2);
    snprintf(bundle, sizeof bundle, "%s/in.spin", check_folder());
    snprintf(output, sizeof output, "%s/out.spin", check_folder());
    if (!ok(spin_import(&i, NULL) == SPIN_OK, "imports"))
        exit(1);
    if (!check_device_is_cpu()) {
        skip("estimates", "they are those of the CPU");
        return;
    }
    device = check_device(1);
    check_times();
    check_memory();
    check_content();
    check_fitting();
    check_frame();
    check_device_free(device);
}
