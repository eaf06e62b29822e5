/* spin4d: converts a run to a clip in one call. It also runs the other four commands: `spin4d
 * import` runs spin-import, and so on. */
#include "cmd/args.h"

#include <errno.h>
#include <string.h>
#include <unistd.h>

#include "base/program.h"
#include "base/text.h"
#include "spin_run.h"

static struct spin_convert_options options = {.device = "auto", .lod = -1};

/* Options for the exporter, alternating names and values; NULL-terminated. */
static const char *export_pairs[2 * 3 + 1];

static bool parse_crop(const struct spin_args_row *row, const char *text)
{
    const double *box = options.crop;
    int n = spin_args_numbers(row, text, options.crop, 6);

    if (n == 6 ? box[0] < box[3] && box[1] < box[4] && box[2] < box[5] : n == 4 && box[3] > 0)
        options.n_crop = n;
    return options.n_crop > 0;
}

/* Keeps an option for the exporter; the caller has checked the value. If an option is repeated, its
 * last value is used. */
static bool keep_pair(const struct spin_args_row *row, const char *text)
{
    const char **pair = export_pairs;

    while (*pair && *pair != row->name)
        pair += 2;
    pair[0] = row->name;
    pair[1] = text;
    options.export_pairs = export_pairs;
    return true;
}

static bool parse_size(const struct spin_args_row *row, const char *text)
{
    int width, height, end = 0;

    return sscanf(text, "%5dx%5d%n", &width, &height, &end) == 2 && !text[end] && width >= 16 &&
           height >= 16 && width <= 16384 && height <= 16384 && keep_pair(row, text);
}

static bool parse_fps(const struct spin_args_row *row, const char *text)
{
    double fps;

    return spin_args_numbers(row, text, &fps, 1) == 1 && keep_pair(row, text);
}

static bool parse_up(const struct spin_args_row *row, const char *text)
{
    return spin_args_choice(text, row->arg) >= 0 && keep_pair(row, text);
}

static const struct spin_args_row rows[] = {
    SPIN_ARG_HEADING("Input"),
    SPIN_ARG("data", 0, "DIR", STRING, options.data,
             "multi-view video that the run was trained on (found in or beside RUN)"),
    SPIN_ARG("data-from", 0, "NAME", STRING, options.data_from,
             "format of the data set (detected)"),
    SPIN_ARG("from", 0, "NAME", STRING, options.from, "importer (detected)"),
    SPIN_ARG("frames", 0, "N", INT, options.n_frames,
             "continuous methods: sample N frames over the whole time range", .min = 1,
             .max = 1000000),
    SPIN_ARG("lod", 0, "N", INT, options.lod,
             "streamed SOG: level of detail, 0 is the finest (the finest whose files exist)",
             .min = 0, .max = 63),
    SPIN_ARG_HEADING("Retraining"),
    SPIN_ARG("no-retrain", 0, NULL, FLAG, options.no_retrain,
             "convert the splats as they are, even if there are images"),
    SPIN_ARG("preset", 0, SPIN_PRESETS, CHOICE, options.preset,
             "same as spin-retrain --preset (quick)"),
    SPIN_ARG("iterations", 0, "N", INT, options.iterations,
             "stop after N iterations, for a quick preview (set by the preset)", .min = 1,
             .max = 1e9),
    SPIN_ARG("splats", 0, "N|SHARE%|auto", STRING, options.splats,
             "frames without images: splats per frame to begin with, for a smaller clip (all)"),
    SPIN_ARG("device", 0, "auto|cpu|cuda", CHOICE, options.device, "device to compute on (auto)"),
    SPIN_ARG_HEADING("Output"),
    SPIN_ARG("output", 'o', "OUT", STRING, options.output,
             "file or folder to write: .html, .mp4, .ply, ... (RUN.html)"),
    SPIN_ARG("to", 0, "NAME", STRING, options.to, "exporter (default: by the extension of OUT)"),
    SPIN_ARG("for", 0, "PROGRAM", STRING, options.target,
             "set format and options for a program, see spin-export --for"),
    SPIN_ARG(
        "sound", 0, "FILE|none", STRING, options.sound,
        "sound file that starts with the first frame: WAV, MP3, AAC, M4A, Opus, Vorbis or FLAC "
        "(the sound in RUN)"),
    SPIN_ARG("crop", 0, "BOX|SPHERE", CUSTOM, options.crop,
             "keep splats inside the bounding box X0,Y0,Z0,X1,Y1,Z1 or the sphere X,Y,Z,RADIUS",
             .parse = parse_crop),
    SPIN_ARG("floaters", 0, "F", DOUBLE, options.floaters,
             "drop isolated splats, same as spin-export --floaters", .min = 1, .max = 1e6),
    SPIN_ARG("size", 0, "WxH", CUSTOM, export_pairs, "video and images: size in pixels",
             .parse = parse_size),
    SPIN_ARG("fps", 0, "F", CUSTOM, export_pairs, "frames per second (those of the run)",
             .min = 0.001, .max = 1000, .parse = parse_fps),
    SPIN_ARG("up", 0, "x|y|z|-x|-y|-z", CUSTOM, export_pairs, "axis of the source that points up",
             .parse = parse_up),
    SPIN_ARG_END,
};

static const char *const usage[] = {
    "spin4d RUN [--data DIR] [-o clip.html] [options]",
    "spin4d import|retrain|eval|export ...    run spin-import(1), spin-retrain(1), ...",
    NULL,
};

static const char *const commands[] = {"import", "retrain", "eval", "export", NULL};

static const char *const examples[] = {
    "spin4d output/balls --data data/balls -o balls.html   retrain on the images, write a page",
    "spin4d output/balls --data data/balls --no-retrain    write the splats as they are to "
    "balls.html",
    "spin4d eval balls.spin                                measure the quality of the retrained "
    "clip",
    NULL,
};

static const char *const main_options[] = {"output", "data", "no-retrain", "preset", "iterations",
                                           "frames", "from", "to",         "for",    "device",
                                           "force",  "json", "help",       NULL};

static const struct spin_args_command command = {
    .name = "spin4d",
    .summary = "convert a run of a 4D Gaussian Splatting method to a clip for viewing",
    .usage = usage,
    .examples = examples,
    .main = main_options,
    .rows = rows,
    .several = "for a clip of several files, give the folder that contains them",
    .words = commands,
};

static const char text[] =
    "{{#retrain}}{{#test}}held-out views: {{#before.psnr}}{{before.psnr %.2f}} dB before, {{/}}"
    "{{psnr %.2f}} dB{{#before.psnr}} after{{/}}\n{{/}}{{/}}"
    "{{#rows}}{{#test}}as 4D splats: {{psnr %.2f}} dB\n{{/}}{{/}}"
    "{{#eval}}against renders from held-out viewpoints: {{psnr %.2f}} dB"
    "{{#psnr_dynamic}}, {{psnr_dynamic %.2f}} dB in dynamic regions{{/}}\n"
    "{{#flicker_images}}flicker in static regions: {{flicker_images %.3f}}/255 before, "
    "{{flicker %.3f}}/255 after\n{{/}}{{/}}"
    "{{output}}: {{export.frames %N frame}} as {{to}}, {{export.splats_mean %N splat}} each"
    "{{#export.bytes}}, {{export.bytes %B}}{{#input_bytes}} from {{input_bytes %B}}{{/}}{{/}}\n"
    "{{bundle}}: the bundle, for spin4d eval and spin4d export\n"
    "{{#to=html}}Open {{output}} in a browser.\n{{/}}";

/* Replaces this process by spin-`name` from the folder of this program, or from PATH if that folder
 * is unknown. Returns only on failure. */
static int exec_command(const char *name, char **argv)
{
    char own[4096], path[4200];
    char *slash;

    if (!spin_program_path(own))
        own[0] = '\0';
    slash = strrchr(own, '/');
    snprintf(path, sizeof path, "%.*sspin-%s", slash ? (int)(slash - own) + 1 : 0, own, name);
    execvp(path, argv);
    spin_text_tidy(path, false);
    fprintf(stderr, "spin4d: cannot run '%s': %s\n", path, strerror(errno));
    return SPIN_EXIT_FAILED;
}

/* Returns the command whose name is nearest to the mistyped `word`. NULL: no name is near, or
 * `word` is an existing path. */
static const char *nearest_command(const char *word)
{
    const char *best = NULL;
    int least = 3;

    for (const char *const *name = commands; *name && access(word, F_OK) != 0; name++) {
        int d = spin_text_distance(word, strlen(word), *name);

        best = d < least ? *name : best;
        least = d < least ? d : least;
    }
    return best;
}

/* Replaces `spin4d help` by `spin4d --help`, `spin4d help import` by `spin4d import --help`, and
 * `spin4d version` by `spin4d --version`. */
static void read_help(int *argc, char **argv)
{
    static char help[] = "--help", version[] = "--version";
    bool asks = *argc > 1 && strcmp(argv[1], "help") == 0;

    if (*argc < 2 || access(argv[1], F_OK) == 0)
        return;
    if (asks && *argc == 3) {
        argv[1] = argv[2];
        argv[2] = help;
    } else if (asks || strcmp(argv[1], "version") == 0) {
        argv[1] = asks ? help : version;
        *argc = 2;
    }
}

int main(int argc, char **argv)
{
    /* Index of the argument that may be the name of a command. */
    int at = argc > 3 && strcmp(argv[1], "--complete") == 0 ? 2 : 1;
    char *report;
    int code;

    read_help(&argc, argv);
    for (const char *const *name = commands; *name && at < argc; name++)
        if (strcmp(argv[at], *name) == 0) {
            argv[at] = argv[at - 1]; /* replaces the name by argv[0] or --complete */
            return exec_command(*name, argv + 1);
        }
    if (argc > 1 && nearest_command(argv[1]))
        return spin_args_misuse(&command, "'%s' is neither a run nor a command, did you mean '%s'?",
                                argv[1], nearest_command(argv[1]));
    if (!spin_args_parse(&command, argc, argv, &code))
        return code;
    if (!spin_args.word)
        return spin_args_misuse(&command, "RUN is missing");
    options.input = spin_args.word;
    options.n_threads = spin_args.n_threads;
    options.force = spin_args.force;
    if (!spin_args_begin(&command, &code) ||
        !spin_args_ended(&command, spin_convert(&options, &report), &code))
        return code;
    return spin_args_report(&command, report, spin_args.quiet ? NULL : text);
}
