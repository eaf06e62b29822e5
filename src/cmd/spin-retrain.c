/* spin-retrain: retrains the splats of a bundle on the images of its data set. */
#include "cmd/args.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "spin_run.h"

static struct spin_retrain_options options;
static struct spin_args_list test_cameras;
static const char *preset;

/* ---- Parsers of option values ---------------------------------------------------------------- */

/* Parses either four numbers, for the axes x, y, z and time, or a single number for x, y and z. */
static bool parse_grid(const struct spin_args_row *row, const char *text)
{
    double value[4];
    int *out = row->into, n = spin_args_numbers(row, text, value, 4);

    if (n != 1 && n != 4)
        return false;
    for (int axis = 0; axis < 3; axis++)
        out[axis] = (int)value[0];
    for (int axis = 0; axis < n; axis++) {
        if (value[axis] != floor(value[axis]))
            return false;
        out[axis] = (int)value[axis];
    }
    return true;
}

/* ---- The table ------------------------------------------------------------------------------- */

#define SPIN_ARG_GRID SPIN_ARG_CUSTOM, .parse = parse_grid

/* Macros that convert the rows of options.def to options. The help texts end with the default. */
#define HEADING(text) SPIN_ARG_HEADING(text),
#define UNSET ""
#define ALL(...) " (" #__VA_ARGS__ ")"
#define ALL_SHOWN(text, ...) " (" text ")"
#define ALL_NAMED(name) " (" #name ")"
#define PAPER(paper, rest) " (" #rest "; paper: " #paper ")"
#define PAPER_NAMED(paper, rest) PAPER(paper, rest)
#define SHORT(shorter, rest) " (" #rest "; short: " #shorter ")"
#define NETWORK(network, rest) " (" #rest "; paper, short: " #network ")"
#define NETWORK_NAMED(network, rest) NETWORK(network, rest)
#define THREE(paper, shorter, rest) " (" #rest "; paper: " #paper "; short: " #shorter ")"
#define EACH(text, quick, best, paper, shorter) " (" text ")"
#define OPTION(k, field, long_name, argument, low, high, fallback, network, refinement, sentence)  \
    {.name = long_name,                                                                            \
     .arg = argument,                                                                              \
     .help = sentence fallback,                                                                    \
     .into = &options.field,                                                                       \
     .min = low,                                                                                   \
     .max = high,                                                                                  \
     .kind = SPIN_ARG_##k},

static const struct spin_args_row rows[] = {
    SPIN_ARG_HEADING("Output"),
    SPIN_ARG("output", 'o', "OUT.spin", STRING, options.output, "bundle to write"),
    SPIN_ARG("dry-run", 0, NULL, FLAG, options.dry_run,
             "print the memory and time needed, then exit"),
    SPIN_ARG("resume", 0, NULL, FLAG, options.resume,
             "continue an interrupted training from the checkpoint beside OUT.spin"),
    SPIN_ARG("cache", 0, "DIR", STRING, options.cache,
             "keep refined frames in this folder and reuse those already there; several trainings "
             "can share the folder"),
    SPIN_ARG("preview", 0, "DIR", STRING, options.preview,
             "write PNGs of ground truth and render, side by side, to this folder"),
    SPIN_ARG(
        "watch", 0, "DIR", STRING, options.watch,
        "write a page with curves, images and the clip so far to this folder; it refreshes itself"),
    SPIN_ARG("log", 0, "FILE", STRING, options.log, "write one line of JSON per iteration"),
    SPIN_ARG_HEADING("Preset"),
    SPIN_ARG("preset", 0, SPIN_PRESETS, CHOICE, preset,
             "defaults of all other options: quick takes minutes; best takes three times as long, "
             "for higher quality; paper has the paper's settings; short is the paper's method in "
             "minutes on a CPU (quick; paper with --refine, --method network or --method frames)"),
    SPIN_ARG_HEADING("Data set"),
    SPIN_ARG("data", 0, "DIR", STRING, options.data,
             "multi-view video (the one named in the bundle)"),
    SPIN_ARG("data-from", 0, "NAME", STRING, options.data_from,
             "format of the data set (detected)"),
    SPIN_ARG("pair", 0, "auto|number|order", CHOICE, options.pair,
             "match frames to images by frame number or by order (auto)"),
    SPIN_ARG("range", 0, "A:B[:STEP]", RANGE, options.range,
             "use only frames numbered A to B-1 (all)"),
    SPIN_ARG("test-cams", 0, "LIST", INTS, test_cameras,
             "numbers of the held-out cameras (those of the input's training, or of the data set)",
             .min = 0, .max = 1e9),
    SPIN_ARG("test-outer", 0, "N", INT, options.test_outer,
             "hold out the N outermost cameras as well, for spin-eval --split outer (0)", .min = 0,
             .max = 1e6),
#include "train/options.def"
    SPIN_ARG_HEADING("Machine"),
    SPIN_ARG("device", 0, "auto|cpu|cuda", CHOICE, options.device, "device to compute on (auto)"),
    SPIN_ARG("deterministic", 0, NULL, FLAG, options.deterministic,
             "make results on a GPU bit-identical between runs, at some cost in speed; results on "
             "the CPU always are"),
    SPIN_ARG("scratch", 0, "DIR|off", STRING, options.scratch,
             "folder of temporary files for the values of frames that do not fit into memory; off: "
             "end with an error instead (the folder of the output)"),
    SPIN_ARG_END,
};

static const char *const usage[] = {
    "spin-retrain IN.spin -o OUT.spin [--data DIR] [options]",
    "spin-retrain IN.spin --dry-run [options]",
    NULL,
};

static const char *const examples[] = {
    "spin-retrain balls.spin -o better.spin               print the plan and the time, then train",
    "spin-retrain balls.spin -o best.spin --preset best   three times as long, for higher quality",
    "spin-retrain balls.spin -o better.spin --dry-run     print the plan and the time only",
    NULL,
};

static const char *const main_options[] = {
    "output",    "data",   "preset",  "iterations", "max-points", "range", "scale",
    "test-cams", "resume", "dry-run", "watch",      "preview",    "log",   "device",
    "threads",   "force",  "json",    "help",       NULL};

static const struct spin_args_command command = {
    .name = "spin-retrain",
    .summary = "retrain the splats of a bundle on the images of its data set",
    .usage = usage,
    .examples = examples,
    .main = main_options,
    .rows = rows,
};

/* ---- Templates of the reports ---------------------------------------------------------------- */

static const char plan_text[] =
    "device      {{device}}\npreset      {{preset}}\n"
    "work        {{iterations %N iteration}}{{#method=frames}} on each frame{{/}}, "
    "{{frames %N frame}}, {{splats_mean %N splat}} each\n"
    "{{#densify_every}}densify     every {{densify_every}} iterations"
    "{{#full}}, pruning only: --max-points is reached{{/}}\n{{/}}"
    "memory      {{bytes_needed %B}} needed, {{#bytes_available}}{{bytes_available %B}}{{/}}"
    "{{^bytes_available}}an unknown amount{{/}} available\n"
    "{{#bytes_scratch}}            and {{bytes_scratch %B}} in temporary files (--scratch), since "
    "memory is short{{^fits_disk}}; the disk has less space free{{/}}\n{{/}}"
    "{{^fits}}            it does not fit: {{#fitting}}{{fitting}} would fit{{/}}{{^fitting}}no "
    "smaller setting was found that would{{/}}\n{{/}}"
    "{{^ranks=1}}processes   {{ranks}}; each needs this amount of memory; together they send up to "
    "{{bytes_sent %B}} per iteration{{#densify_every}}, more as densification adds "
    "splats{{/}}\n{{/}}"
    "time        {{#seconds_estimated}}about {{seconds_estimated %T}}{{/}}"
    "{{^seconds_estimated}}not known on a GPU{{/}}\n";

static const char text[] =
    "{{output}}: {{iterations %N iteration}} in {{#seconds}}{{seconds %T}}{{/}}"
    "{{^seconds}}unknown{{/}}{{#seconds_per_iteration}} ({{seconds_per_iteration %.3g}} s "
    "each){{/}} "
    "on {{device}}, {{frames %N frame}}, {{splats_mean %N splat}} each\n"
    "test views      PSNR     SSIM\n"
    "before    {{before.psnr %10.3f}}{{before.ssim %9.4f}}\n"
    "{{#method=network}}{{#refine}}"
    "refined   {{refined.psnr %10.3f}}{{refined.ssim %9.4f}}\n"
    "{{/}}{{/}}"
    "after     {{test.psnr %10.3f}}{{test.ssim %9.4f}}\n";

/* ---- Options without effect ------------------------------------------------------------------ */

static const char *const of_network[] = {
    "levels",          "features",   "hash-log2",      "hidden", "finest-resolution",
    "scene-normalise", "activation", "lr-table",       "lr-sh",  "lr-scale",
    "lr-rotation",     "lr-opacity", "head-lr-factor", NULL};
static const char *const of_sh[] = {"sh-degree", "sh-increase-every", NULL};
static const char *const of_clip[] = {"tracks",      "iterations", "batch",       "views-per-frame",
                                      "warmup",      "eval-every", "save-every",  "watch",
                                      "lr-position", "residual",   "lr-residual", NULL};
static const char *const of_tracks[] = {"lr-track",          "lr-displacement",  "lr-tracked",
                                        "track-iterations",  "dynamic-residual", "densify-every",
                                        "densify-threshold", "densify-until",    NULL};
/* With --method 4d, only the first CLIP_OF_4D options of of_clip and the first TRACKS_OF_4D options
 * of of_tracks have an effect. */
enum { CLIP_OF_4D = 8, TRACKS_OF_4D = 2 };
static const char *const of_refinement[] = {"refine-start", "densify", "cache", NULL};
static const char *const of_densification[] = {"max-points", NULL};
static const char *const of_residual[] = {"residual", NULL};
static const char *const of_average[] = {"average", NULL};
static const char *const of_exposure[] = {"lr-exposure", NULL};

/* If have_effect is false, warns in one line about the options in `name` that were given. lacking:
 * the reason why they have no effect. */
static void warn_unused(int argc, char **argv, const char *const *name, bool have_effect,
                        const char *lacking)
{
    char given[600] = "";
    int n = 0;

    for (; *name && !have_effect; name++)
        if (spin_args_find(argc, argv, *name))
            snprintf(given + strlen(given), sizeof given - strlen(given), "%s--%s", n++ ? ", " : "",
                     *name);
    if (n > 0 && spin_ranks_env_rank() <= 0)
        spin_warn("%s %s no effect %s", given, n > 1 ? "have" : "has", lacking);
}

static void warn_without_effect(int argc, char **argv)
{
    bool clip = options.method != SPIN_METHOD_FRAMES;
    bool of_4d = options.method == SPIN_METHOD_4D;
    bool points = !clip && options.refine_start == SPIN_REFINE_FROM_POINTS;
    bool tracks = clip && !of_4d && options.tracks, own = options.residual != SPIN_RESIDUAL_OFF;
    int pace = options.sh_increase_every > 0 ? options.sh_increase_every : SPIN_SH_INCREASE_EVERY;

    warn_unused(argc, argv, of_network, options.method == SPIN_METHOD_NETWORK, "without a network");
    warn_unused(argc, argv, of_sh, options.method != SPIN_METHOD_TRACKS, "with --method tracks");
    warn_unused(argc, argv, of_sh, !of_4d, "with --method 4d");
    warn_unused(argc, argv, of_sh, !points || options.refine > pace,
                "if --refine ends before the first increase of the SH degree");
    warn_unused(argc, argv, of_sh + 1, clip || points, "with --refine-start source");
    warn_unused(argc, argv, of_clip, clip, "with --method frames");
    warn_unused(argc, argv, of_clip + CLIP_OF_4D, !of_4d, "with --method 4d");
    warn_unused(argc, argv, of_tracks + TRACKS_OF_4D, !of_4d, "with --method 4d");
    warn_unused(argc, argv, of_tracks, of_4d || (clip && options.tracks), "without tracks");
    warn_unused(argc, argv, of_average, options.method == SPIN_METHOD_TRACKS || of_4d,
                "without --method tracks or 4d");
    warn_unused(argc, argv, of_refinement, options.refine > 0, "without --refine");
    warn_unused(argc, argv, of_densification,
                (options.refine > 0 && options.densify) ||
                    (tracks && options.refine == 0 && options.densify_every != 0),
                "without densification");
    warn_unused(argc, argv, of_residual, !tracks || own,
                "with tracks, which have their own values");
    warn_unused(argc, argv, of_exposure, options.learn_exposure != SPIN_EXPOSURE_OFF,
                "without --learn-exposure");
}

/* ---- The command ----------------------------------------------------------------------------- */

static int check_arguments(void)
{
    if (!spin_args.word)
        return spin_args_misuse(&command, "IN.spin is missing");
    if (!options.output && !options.dry_run)
        return spin_args_misuse(&command, "--output is missing");
    if (options.batch > 0 && options.views_per_frame > options.batch)
        return spin_args_misuse(&command, "--views-per-frame %d is more than --batch %d",
                                options.views_per_frame, options.batch);
    return SPIN_EXIT_OK;
}

/* Returns the preset that applies if --preset is not given: "paper" with --refine, --method network
 * or --method frames, otherwise "quick". */
static const char *implied_preset(int argc, char **argv)
{
    const char *method = spin_args_find(argc, argv, "method");
    const char *refine = spin_args_find(argc, argv, "refine");

    bool other = method && strcmp(method, "tracks") != 0 && strcmp(method, "4d") != 0;

    return other || (refine && atoi(refine) > 0) ? "paper" : "quick";
}

int main(int argc, char **argv)
{
    char *report;
    int code;

    /* Apply the preset before parsing, since other options override its values. If the name of the
     * preset is invalid, the parser reports that later. */
    preset = spin_args_find(argc, argv, "preset");
    spin_retrain_preset(preset ? preset : implied_preset(argc, argv), &options);
    if (!spin_args_parse(&command, argc, argv, &code))
        return code;
    code = check_arguments();
    if (code != SPIN_EXIT_OK)
        return code;
    options.input = spin_args.word;
    if (options.method == SPIN_METHOD_TRACKS && !spin_args_find(argc, argv, "tracks"))
        options.tracks = true;
    if (options.method == SPIN_METHOD_FRAMES && options.refine == 0)
        options.refine = 2000;
    warn_without_effect(argc, argv);
    options.test_cameras = test_cameras.ints;
    options.n_test_cameras = test_cameras.n;
    options.n_threads = spin_args.n_threads;
    options.force = spin_args.force;
    if (!spin_args_begin(&command, &code) ||
        !spin_args_ended(&command, spin_retrain(&options, &report), &code))
        return code;
    return spin_args_report(&command, report,
                            options.dry_run   ? plan_text
                            : spin_args.quiet ? NULL
                                              : text);
}
