/* spin-retrain: learn the attributes of a bundle anew. */
#include "cmd/args.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "cmd/print.h"

static struct spin_retrain_options options;
static struct spin_args_common common;
static struct spin_args_ints test_cameras;
static const char *preset = "paper", *residual;
static const char *method = "network", *refine_start = "points", *densify = "on";
static const char *activation = "gelu";

/* ---- Values that only this command has ------------------------------------------------------- */

/* A number, nothing around it. */
static bool parse_number(const char *text, char separator, double *out, const char **next)
{
    char *end;
    double value = strtod(text, &end);

    if (end == text || !strchr("+-.0123456789", *text) || !isfinite(value) ||
        (*end && *end != separator))
        return false;
    *out = value;
    *next = *end ? end + 1 : NULL;
    return true;
}

/* Numbers with commas between; how many there were, 0 when it makes no sense or are more than room. */
static int parse_numbers(const char *text, double *out, int room)
{
    const char *next = text;
    int n = 0;

    while (next) {
        if (n == room || !parse_number(next, ',', &out[n++], &next))
            return 0;
    }
    return n;
}

/* --preset is looked up before all else, so that the other options change it wherever they stand. */
static const char *preset_of(int argc, char **argv)
{
    const char *found = "paper";

    for (int i = 1; i < argc && strcmp(argv[i], "--") != 0; i++)
        if (!strcmp(argv[i], "--preset") && i + 1 < argc)
            found = argv[i + 1];
        else if (!strncmp(argv[i], "--preset=", 9))
            found = argv[i] + 9;
    return found;
}

static bool parse_scale_bias(const char *text, void *into)
{
    if (!strcmp(text, "auto")) {
        *(double *)into = NAN;
        return true;
    }
    return parse_numbers(text, into, 1) == 1;
}

static bool parse_normalise(const char *text, void *into)
{
    struct spin_retrain_options *o = into;
    double value[4];

    o->normalise_radius = 0;
    o->normalise = !strcmp(text, "auto")   ? SPIN_NORMALISE_AUTO
                   : !strcmp(text, "none") ? SPIN_NORMALISE_NONE
                                           : SPIN_NORMALISE_OFF;
    if (!strcmp(text, "auto") || !strcmp(text, "off") || !strcmp(text, "none"))
        return true;
    if (parse_numbers(text, value, 4) != 4 || value[3] <= 0)
        return false;
    memcpy(o->normalise_centre, value, sizeof o->normalise_centre);
    o->normalise_radius = value[3];
    return true;
}

static bool parse_resolution(const char *text, int smallest_time, int *out)
{
    enum { LARGEST = 65536 };
    double value[4];
    int n = parse_numbers(text, value, 4);

    if (n != 1 && n != 4)
        return false;
    for (int axis = 0; axis < n; axis++) {
        int smallest = axis == 3 ? smallest_time : 2;

        if (value[axis] != floor(value[axis]) || value[axis] < smallest || value[axis] > LARGEST)
            return false;
    }
    for (int axis = 0; axis < n; axis++)
        out[axis] = (int)value[axis];
    if (n == 1)
        out[1] = out[2] = out[0];
    return true;
}

/* One number is for all four axes. */
static bool parse_base(const char *text, void *into)
{
    int *out = into;

    if (!parse_resolution(text, 2, out))
        return false;
    if (!strchr(text, ','))
        out[3] = out[0];
    return true;
}

/* One number is for the three axes of space; 0 for time is the automatic choice. */
static bool parse_finest(const char *text, void *into) { return parse_resolution(text, 0, into); }

/* ---- The table ------------------------------------------------------------------------------- */

enum { MANY = 1000000000 };

static const struct spin_args_row rows[] = {
    SPIN_ARG_HEADING("Output"),
    SPIN_ARG("output", 'o', "OUT.spin", "the bundle to write", SPIN_ARG_STRING, &options.output, 0,
             0),
    SPIN_ARG("dry-run", 0, NULL, "print memory and time needed, do no work", SPIN_ARG_FLAG,
             &options.dry_run, 0, 0),
    SPIN_ARG("resume", 0, NULL, "go on from the unfinished state of OUT.spin", SPIN_ARG_FLAG,
             &options.resume, 0, 0),
    SPIN_ARG("preview", 0, "DIR", "write PNGs: ground truth beside render", SPIN_ARG_STRING,
             &options.preview, 0, 0),
    SPIN_ARG("log", 0, "FILE", "write one JSON line a step", SPIN_ARG_STRING, &options.log, 0, 0),
    SPIN_ARG("eval-every", 0, "N", "measure the test views every N iterations (at the end)",
             SPIN_ARG_INT, &options.eval_every, 0, MANY),
    SPIN_ARG("save-every", 0, "N", "keep the state every N iterations (every 5 minutes)",
             SPIN_ARG_INT, &options.save_every, 0, MANY),
    SPIN_ARG_HEADING("Data set"),
    SPIN_ARG("data", 0, "DIR", "the multi-view video (the one named in the bundle)",
             SPIN_ARG_STRING, &options.data, 0, 0),
    SPIN_ARG("data-from", 0, "NAME", "kind of that data set (detected)", SPIN_ARG_STRING,
             &options.data_from, 0, 0),
    SPIN_ARG("pair", 0, "auto|number|order", "how frames find their images (auto)", SPIN_ARG_CHOICE,
             &options.pair, 0, 0),
    SPIN_ARG("range", 0, "A:B[:STEP]", "use frame numbers A to B-1", SPIN_ARG_RANGE, &options.range,
             0, 0),
    SPIN_ARG("scale", 0, "S", "image scale, 0.5 halves both sides (1)", SPIN_ARG_DOUBLE,
             &options.image_scale, 0.01, 1),
    SPIN_ARG("test-cams", 0, "LIST", "camera numbers held out (the data set's own)", SPIN_ARG_INTS,
             &test_cameras, 0, MANY),
    SPIN_ARG("background", 0, "COLOUR", "black, white or R,G,B with each in 0..1 (black)",
             SPIN_ARG_COLOUR, options.background, 0, 0),
    SPIN_ARG_HEADING("Training"),
    SPIN_ARG("preset", 0, "paper|short",
             "where all options start: the paper's settings, or what does best in minutes (paper)",
             SPIN_ARG_CHOICE, &preset, 0, 0),
    SPIN_ARG("iterations", 0, "N", "steps (40000)", SPIN_ARG_INT, &options.iterations, 1, MANY),
    SPIN_ARG("batch", 0, "N", "images a step (3)", SPIN_ARG_INT, &options.batch, 1, 1024),
    SPIN_ARG("views-per-frame", 0, "N", "images of a step taken from one frame (1)", SPIN_ARG_INT,
             &options.views_per_frame, 1, 1024),
    SPIN_ARG("lambda-dssim", 0, "W", "weight of the SSIM part of the loss (0.2)", SPIN_ARG_DOUBLE,
             &options.lambda_dssim, 0, 1),
    SPIN_ARG("dynamic-weight", 0, "W",
             "how often a pixel counts that shows something that moves (1)", SPIN_ARG_DOUBLE,
             &options.dynamic_weight, 1e-3, 1e3),
    SPIN_ARG("lambda-opacity", 0, "W", "weight of the mean opacity, against floaters (0)",
             SPIN_ARG_DOUBLE, &options.lambda_opacity, 0, 1e3),
    SPIN_ARG("lambda-scale", 0, "W", "weight of the mean scale over the scene's extent (0)",
             SPIN_ARG_DOUBLE, &options.lambda_scale, 0, 1e3),
    SPIN_ARG("antialias", 0, NULL,
             "draw small splats fainter, not only wider: for viewers that do so too", SPIN_ARG_FLAG,
             &options.antialias, 0, 0),
    SPIN_ARG("seed", 0, "N", "of the first values and the order of the images (0)", SPIN_ARG_UINT64,
             &options.seed, 0, 0),
    SPIN_ARG("warmup", 0, "N", "steps in which the rates rise (iterations / 40)", SPIN_ARG_INT,
             &options.warmup, 0, MANY),
    SPIN_ARG("lr-table", 0, "R", "rate of the hash table (8e-3)", SPIN_ARG_DOUBLE,
             &options.lr_table, 0, 1),
    SPIN_ARG("lr-sh", 0, "R", "rate of the colour head (1e-3)", SPIN_ARG_DOUBLE, &options.lr_sh, 0,
             1),
    SPIN_ARG("lr-scale", 0, "R", "rate of the scale head (3e-4)", SPIN_ARG_DOUBLE,
             &options.lr_scale, 0, 1),
    SPIN_ARG("lr-rotation", 0, "R", "rate of the rotation head (3e-5)", SPIN_ARG_DOUBLE,
             &options.lr_rotation, 0, 1),
    SPIN_ARG("lr-opacity", 0, "R", "rate of the opacity head (8e-4)", SPIN_ARG_DOUBLE,
             &options.lr_opacity, 0, 1),
    SPIN_ARG("lr-position", 0, "R", "rate of the positions, times the extent (1.6e-4)",
             SPIN_ARG_DOUBLE, &options.lr_position, 0, 1),
    SPIN_ARG("head-lr-factor", 0, "F", "on the rates of the four heads (1)", SPIN_ARG_DOUBLE,
             &options.lr_head_factor, 0, 1000),
    SPIN_ARG("sh-increase-every", 0, "N",
             "iterations until the next degree of SH joins (0: all at once)", SPIN_ARG_INT,
             &options.sh_increase_every, 0, MANY),
    SPIN_ARG("learn-exposure", 0, NULL, "learn a gain and offset of every training camera",
             SPIN_ARG_FLAG, &options.learn_exposure, 0, 0),
    SPIN_ARG("lr-exposure", 0, "R", "rate of these gains and offsets (1e-3)", SPIN_ARG_DOUBLE,
             &options.lr_exposure, 0, 1),
    SPIN_ARG_HEADING("Frame by frame"),
    SPIN_ARG("method", 0, "network|explicit",
             "explicit: every frame on its own, as 3DGS, and no network (network)", SPIN_ARG_CHOICE,
             &method, 0, 0),
    SPIN_ARG("refine", 0, "N",
             "iterations of every frame before the network (0), or instead of it (2000)",
             SPIN_ARG_INT, &options.refine, 0, MANY),
    SPIN_ARG("refine-start", 0, "points|source",
             "from coloured points, or from the source's attributes (points)", SPIN_ARG_CHOICE,
             &refine_start, 0, 0),
    SPIN_ARG("densify", 0, "on|off", "let frames that are refined gain points (on)",
             SPIN_ARG_CHOICE, &densify, 0, 0),
    SPIN_ARG("max-points", 0, "N", "of a frame that is refined; 0: no limit (0)", SPIN_ARG_INT,
             &options.max_points, 0, MANY),
    SPIN_ARG_HEADING("Network"),
    SPIN_ARG("levels", 0, "N", "levels of the hash grid (16)", SPIN_ARG_INT, &options.levels, 1,
             32),
    SPIN_ARG("features", 0, "N", "numbers a level, 1, 2, 4 or 8 (4)", SPIN_ARG_INT,
             &options.features, 1, 8),
    SPIN_ARG("hash-log2", 0, "N", "2^N entries a level (21)", SPIN_ARG_INT, &options.hash_log2, 4,
             26),
    SPIN_ARG("hidden", 0, "N", "width of the heads (64)", SPIN_ARG_INT, &options.hidden, 4, 256),
    SPIN_ARG("sh-degree", 0, "N", "of the colours, 0 to 3 (3)", SPIN_ARG_INT, &options.sh_degree, 0,
             3),
    SPIN_ARG_PARSED("base-resolution", "A[,B,C,D]", "cells of the coarsest level on x, y, z, t (8)",
                    options.base_resolution, parse_base),
    SPIN_ARG_PARSED("finest-resolution", "A[,B,C,D]",
                    "cells of the finest level; one number is for space, and time 0 is one per "
                    "frame, at least 16 (2048,2048,2048,0)",
                    options.finest_resolution, parse_finest),
    SPIN_ARG("hash-init-range", 0, "R", "first values of the table lie in -R to R (1e-4)",
             SPIN_ARG_DOUBLE, &options.hash_init_range, 0, 10),
    SPIN_ARG_PARSED("init-log-scale", "V|auto",
                    "first log scale of all splats; auto: from the distance of neighbours (-5)",
                    &options.init_log_scale, parse_scale_bias),
    SPIN_ARG_PARSED("scene-normalise", "off|auto|none|CX,CY,CZ,R",
                    "move and scale the scene where it enters the network; none: without the "
                    "contraction (off)",
                    &options, parse_normalise),
    SPIN_ARG("residual", 0, "off|points|source",
             "let the network add to values of every splat's own: off, from points' spacing and "
             "colour, from the source's attributes or the refined frame's (off)",
             SPIN_ARG_CHOICE, &residual, 0, 0),
    SPIN_ARG("lr-residual", 0, "F", "on 3DGS's rates for these values; 0: they stay (1)",
             SPIN_ARG_DOUBLE, &options.lr_residual, 0, 1000),
    SPIN_ARG("activation", 0, "gelu|relu", "of the heads (gelu)", SPIN_ARG_CHOICE, &activation, 0,
             0),
    SPIN_ARG_HEADING("Machine"),
    SPIN_ARG("device", 0, "auto|cpu|cuda", "what computes (auto)", SPIN_ARG_CHOICE, &options.device,
             0, 0),
    SPIN_ARG_COMMON_ROWS(common),
};

static const char *const usage[] = {
    "spin-retrain IN.spin -o OUT.spin [--data DIR] [options]",
    "spin-retrain IN.spin --dry-run [options]",
    NULL,
};

static const struct spin_args_command command = {
    .name = "spin-retrain",
    .summary = "learn the attributes of a bundle anew",
    .usage = usage,
    .rows = rows,
    .common = &common,
};

/* ---- Reports --------------------------------------------------------------------------------- */

static void print_quality(const char *key, const struct spin_quality *q)
{
    if (!q->valid) {
        spin_print_null(key);
        return;
    }
    spin_print_open(key, '{');
    spin_print_number("psnr", q->psnr);
    spin_print_number("ssim", q->ssim);
    spin_print_number("psnr_channel_mean", q->psnr_channel_mean);
    spin_print_close('}');
}

static void report_json(const struct spin_retrain_report *r)
{
    spin_print_open(NULL, '{');
    spin_print_string("method", method);
    spin_print_integer("iterations", r->iterations);
    spin_print_integer("refine", options.refine);
    spin_print_integer("frames", r->frames);
    spin_print_number("splats_mean", r->splats_mean);
    spin_print_string("device", r->device);
    spin_print_number("outside_ball", r->outside_ball);
    spin_print_integer("bytes_needed", (long long)r->bytes_needed);
    spin_print_integer("bytes_available", (long long)r->bytes_available);
    if (options.dry_run) {
        spin_print_bool("dry_run", true);
        spin_print_number("seconds_estimated", r->seconds_estimated);
    } else {
        spin_print_number("seconds", r->seconds);
        spin_print_number("seconds_per_iteration", r->seconds_per_iteration);
        spin_print_number("loss", r->loss_last);
        spin_print_integer("bytes_peak", (long long)r->bytes_peak);
        if (options.refine > 0) {
            spin_print_number("refine_seconds", r->refine_seconds);
            print_quality("refined", &r->refined);
        }
        print_quality("test", &r->test);
        print_quality("before", &r->before);
        spin_print_string("output", options.output);
    }
    spin_print_close('}');
}

static void report_plan(const struct spin_retrain_report *r)
{
    char needed[32], available[32], time[32];

    printf("device      %s\n", r->device);
    printf("work        %d iterations, %d frames, %.1f splats each\n", r->iterations, r->frames,
           r->splats_mean);
    printf("memory      %s needed, %s available\n",
           spin_print_bytes((double)r->bytes_needed, needed),
           spin_print_bytes((double)r->bytes_available, available));
    printf("time        about %s\n", spin_print_seconds(r->seconds_estimated, time));
}

static void print_row(const char *name, const struct spin_quality *q)
{
    if (q->valid)
        printf("%-10s  %8.3f  %7.4f\n", name, q->psnr, q->ssim);
    else
        printf("%-10s  %8s  %7s\n", name, "-", "-");
}

static void report_text(const struct spin_retrain_report *r)
{
    char time[32];

    printf("%s: %d iterations in %s (%.3g s each) on %s, %d frames, %.1f splats each\n",
           options.output, r->iterations, spin_print_seconds(r->seconds, time),
           r->seconds_per_iteration, r->device, r->frames, r->splats_mean);
    printf("%-10s  %8s  %7s\n", "test views", "PSNR", "SSIM");
    print_row("before", &r->before);
    if (options.refine > 0 && options.method == SPIN_METHOD_NETWORK)
        print_row("refined", &r->refined);
    print_row("after", &r->test);
}

/* ---- The command ----------------------------------------------------------------------------- */

static int check(const struct spin_args_words *words)
{
    if (words->n == 0)
        return spin_args_misuse(&command, "IN.spin is missing");
    if (!options.output && !options.dry_run)
        return spin_args_misuse(&command, "say where to write with --output");
    if (options.views_per_frame > options.batch)
        return spin_args_misuse(&command, "--views-per-frame %d is more than --batch %d",
                                options.views_per_frame, options.batch);
    return SPIN_EXIT_OK;
}

int main(int argc, char **argv)
{
    struct spin_args_words words;
    struct spin_retrain_report report = {0};
    int code;

    if (spin_retrain_preset(preset_of(argc, argv), &options) != SPIN_OK)
        spin_retrain_defaults(&options); /* parsing says that there is no such */
    if (!spin_args_parse(&command, argc, argv, 1, &words, &code))
        return code;
    code = check(&words);
    if (code != SPIN_EXIT_OK)
        return code;
    options.input = words.word[0];
    if (!strcmp(method, "explicit"))
        options.method = SPIN_METHOD_EXPLICIT;
    if (options.method == SPIN_METHOD_EXPLICIT && options.refine == 0)
        options.refine = 2000;
    if (!strcmp(refine_start, "source"))
        options.refine_start = SPIN_REFINE_FROM_SOURCE;
    options.no_densify = !strcmp(densify, "off");
    if (residual)
        options.residual = !strcmp(residual, "points")   ? SPIN_RESIDUAL_POINTS
                           : !strcmp(residual, "source") ? SPIN_RESIDUAL_SOURCE
                                                         : SPIN_RESIDUAL_OFF;
    options.relu = !strcmp(activation, "relu");
    options.test_cameras = test_cameras.value;
    options.n_test_cameras = test_cameras.n;
    options.n_threads = common.n_threads;
    options.force = common.force;
    spin_status status = spin_retrain(&options, &report);
    if (status != SPIN_OK)
        return spin_args_fail(&command, status);
    if (common.json)
        report_json(&report);
    else if (options.dry_run)
        report_plan(&report);
    else if (!common.quiet)
        report_text(&report);
    return spin_args_finish(&command, SPIN_EXIT_OK);
}
