/* spin-export: writes the frames of a bundle in standard file formats. */
#include "cmd/args.h"

#include <math.h>
#include <string.h>

#include "spin_run.h"
#include "io/json.h"

static struct spin_export_options options = {.device = "auto"};
static bool wants_list;

/* Parses a list of exactly n numbers, where n is at most 7. Returns false if the list is
 * invalid. */
static bool parse_numbers(const struct spin_args_row *row, const char *text, int n)
{
    double value[7];

    if (spin_args_numbers(row, text, value, 7) != n)
        return false;
    memcpy(row->into, value, (size_t)n * sizeof *value);
    return true;
}

static bool parse_crop(const struct spin_args_row *row, const char *text)
{
    options.n_crop = parse_numbers(row, text, 6) ? 6 : parse_numbers(row, text, 4) ? 4 : 0;
    return options.n_crop > 0;
}

static bool parse_translate(const struct spin_args_row *row, const char *text)
{
    return parse_numbers(row, text, 3);
}

static bool parse_min_opacity(const struct spin_args_row *row, const char *text)
{
    return parse_numbers(row, text, 1);
}

/* Parses --max-scale, where 0 means that scales are not limited. */
static bool parse_max_scale(const struct spin_args_row *row, const char *text)
{
    if (!parse_numbers(row, text, 1))
        return false;
    if (options.max_scale == 0)
        options.max_scale = INFINITY;
    return true;
}

/* Parses --bake-antialias: WxH, or "auto" for the size of the training's images. */
static bool parse_bake(const struct spin_args_row *row, const char *text)
{
    int *size = options.bake_size, n = 0;

    (void)row;
    options.bake_antialias = true;
    if (strcmp(text, "auto") == 0)
        return true;
    return sscanf(text, "%5dx%5d%n", &size[0], &size[1], &n) == 2 && text[n] == '\0' &&
           size[0] > 0 && size[0] <= 32768 && size[1] > 0 && size[1] <= 32768;
}

static bool parse_no_background(const struct spin_args_row *row, const char *text)
{
    (void)row;
    options.transparent = strcmp(text, "none") == 0;
    return options.transparent;
}

static const struct spin_args_row rows[] = {
    SPIN_ARG_HEADING("Output"),
    SPIN_ARG("to", 0, "NAME", STRING, options.to, "exporter (default: by the extension of OUT)"),
    SPIN_ARG("output", 'o', "OUT", STRING, options.output,
             "file or folder to write: .ply, .glb, .html, ..."),
    SPIN_ARG("for", 0, "PROGRAM", STRING, options.target,
             "set format and options for unreal, unity, nuke, houdini, omniverse, blender, "
             "supersplat, spark, playcanvas, babylon or visionos, unless they are given"),
    SPIN_ARG("range", 0, "A:B[:STEP]", RANGE, options.range,
             "export frames numbered A to B-1 (all)"),
    SPIN_ARG("source", 0, NULL, FLAG, options.source,
             "write the imported attributes instead of the retrained ones"),
    SPIN_ARG("sound", 0, "FILE|none", STRING, options.sound,
             "sound file that starts with the first frame of IN.spin: WAV, MP3, AAC, M4A, Opus, "
             "Vorbis or FLAC (the sound in IN.spin)"),
    SPIN_ARG("decimate", 0, "N|P%|SIZE|LOSS", STRING, options.decimate,
             "keep the splats that contribute most to the training views: N per frame, a share "
             "(50%), as many as fit an output size (2MB), or the fewest that reach a PSNR against "
             "all splats (40dB)"),
    SPIN_ARG("check", 0, NULL, FLAG, options.check,
             "read the output back and compare it with the bundle"),
    SPIN_ARG("sync", 0, NULL, FLAG, options.sync,
             "flush every file to disk (fsync) before giving it its final name"),
    SPIN_ARG("list", 0, NULL, FLAG, wants_list, "list the exporters"),
    SPIN_ARG_HEADING("Scene, in its own axes and units"),
    SPIN_ARG("crop", 0, "BOX|SPHERE", CUSTOM, options.crop,
             "keep splats inside the bounding box X0,Y0,Z0,X1,Y1,Z1 or the sphere X,Y,Z,RADIUS",
             .parse = parse_crop),
    SPIN_ARG("min-views", 0, "N", INT, options.min_views,
             "drop splats that are visible in fewer than N training views of their frame", .min = 1,
             .max = 100000),
    SPIN_ARG("floaters", 0, "F", DOUBLE, options.floaters,
             "drop isolated splats, whose RMS distance to their three nearest neighbours exceeds "
             "both F times the median over all splats and three times their own largest scale",
             .min = 1, .max = 1e6),
    SPIN_ARG("backdrop", 0, "auto|off", ENUM, options.backdrop,
             "off: drop the backdrop that spin-retrain added behind the scene (auto)"),
    SPIN_ARG(
        "max-scale", 0, "F", CUSTOM, options.max_scale,
        "drop splats larger than F times the diagonal of the frame's bounding box; 0: no limit "
        "(1; no limit for images and video)",
        .parse = parse_max_scale, .max = 1e30),
    SPIN_ARG("min-opacity", 0, "V", CUSTOM, options.min_opacity,
             "drop splats whose opacity is below V, 0 to 1", .parse = parse_min_opacity,
             .max = 0.999999),
    SPIN_ARG("scale", 0, "S", DOUBLE, options.scale,
             "scale the scene by S, after the filters above (1)", .min = 1e-6, .max = 1e6),
    SPIN_ARG("translate", 0, "X,Y,Z", CUSTOM, options.translate,
             "move the scene, after --scale and before --up and --rotate of an exporter",
             .parse = parse_translate),
    SPIN_ARG("bake-antialias", 0, "auto|WxH", CUSTOM, options.bake_size,
             "for programs without antialiasing: lower opacities for images of W x H pixels; auto: "
             "the size of the training's images",
             .parse = parse_bake),
    SPIN_ARG("relative", 0, NULL, FLAG, options.relative,
             "do not add back the offset that the import subtracted from all positions"),
    SPIN_ARG_HEADING("Data set, for exporters that render"),
    SPIN_ARG_DATA_ROWS(options),
    SPIN_ARG("background", 0, "COLOUR", COLOUR, options.background,
             "colour behind the splats: black, white or R,G,B with each in 0..1; none: write "
             "images with alpha (black)",
             .min = 0, .max = 1, .parse = parse_no_background),
    SPIN_ARG_HEADING("Machine"),
    SPIN_ARG_DEVICE_ROW(options),
    SPIN_ARG_END,
};

static const char *const usage[] = {
    "spin-export IN.spin [--to NAME] -o OUT [options]",
    "spin-export --list [--json]",
    NULL,
};

static const char *const examples[] = {
    "spin-export better.spin -o clip.html                 write a page for the browser",
    "spin-export better.spin --to ply -o frames/          write one PLY file per frame",
    "spin-export better.spin -o frame.spz --range 12:13   write one frame",
    NULL,
};

static const char *const main_options[] = {"output", "to",   "for",  "range",      "source",
                                           "check",  "list", "data", "background", "force",
                                           "json",   "help", NULL};

static const struct spin_args_command command = {
    .name = "spin-export",
    .summary = "export the frames of a bundle to standard file formats",
    .usage = usage,
    .examples = examples,
    .main = main_options,
    .rows = rows,
    .plugin_kind = "exporter",
    .plugin_selector = "to",
    .lists_exporters = true,
};

static char *list_exporters(void)
{
    spin_json *list = spin_json_array();
    char *text;

    for (const struct spin_exporter *const *i = spin_exporter_list(); *i; i++)
        spin_json_push(list,
                       json_pack("{s:o, s:o, s:b, s:o}", "name", spin_json_text_value((*i)->name),
                                 "summary", spin_json_text_value((*i)->summary), "draws",
                                 (*i)->needs_renderer, "plugin",
                                 spin_json_text_value(spin_plugin_origin(*i))));
    return spin_json_finish(list, &text) == SPIN_OK ? text : NULL;
}

/* ---- Templates of the reports ---------------------------------------------------------------- */

static const char list_text[] = "{{#.}}{{name %-16s}} {{summary}}\n"
                                "{{#plugin}}                 plug-in {{plugin}}\n{{/}}{{/}}";

static const char text[] =
    "{{output}}: {{frames %N frame}} as {{to}}{{#images}} ({{images %N image}}){{/}}, "
    "{{splats_mean %N splat}} each"
    "{{#bytes}}, {{bytes %B}}{{/}}{{#filtered}}, {{filtered %N splat}} filtered out{{/}}"
    "{{#left_out}}, {{left_out %N splat}} left out{{/}}\n"
    "{{#decimated}}decimated: {{after %M}} of {{before %N splat}} {{unit}}, by {{by}}{{#merged}}; "
    "{{merged %N splat}} merged into these{{/}}; "
    "{{#pictures}}{{#psnr}}{{psnr %.2f}} dB{{/}}{{^psnr}}no difference{{/}} against all splats in "
    "{{pictures %N image}} from {{cameras}}{{/}}{{^pictures}}no image shows a splat{{/}}\n"
    "{{#tries}}          {{reached %B}} in total, found in {{tries %N attempt}}\n{{/}}{{/}}"
    "{{#check}}read back: {{frames %N frame}}, {{splats %N splat}}; "
    "bounding boxes differ by {{bounds %.3g}} at most\n"
    "  position             error {{place.rms %.3g}} rms, {{place.largest %.3g}} at most\n"
    "{{#place_sizes}}                       {{place_sizes %.3g}} of the splat's size at most"
    "{{#place_pixels}}, {{place_pixels %.3g}} pixels of the data set's cameras{{/}}\n{{/}}"
    "  log scale            error {{log_scale.rms %.3g}} rms, {{log_scale.largest %.3g}} at most\n"
    "  rotation (degrees)   error {{rotation_deg.rms %.3g}} rms, {{rotation_deg.largest %.3g}} at "
    "most\n"
    "  opacity              error {{opacity.rms %.3g}} rms, {{opacity.largest %.3g}} at most\n"
    "  colour               error {{colour.rms %.3g}} rms, {{colour.largest %.3g}} at most\n"
    "  sh                   error {{sh.rms %.3g}} rms, {{sh.largest %.3g}} at most\n"
    "{{#sh_lost}}  sh                   lost in {{sh_lost}} of {{splats %N splat}}, which {{to}} "
    "does not store\n{{/}}"
    "{{^rendered=}}frame {{rendered}} rendered from the file: {{#psnr}}{{psnr %.2f}} dB against "
    "{{/}}the bundle's own render\n{{/}}{{/}}";

/* Reports that no exporter has the extension of the output. */
static int misuse_output(const char *output)
{
    const char *name = strrchr(output, '/'), *ending = strrchr(name ? name : output, '.'), *near;

    near = ending && ending[1] ? spin_exporter_nearest(ending) : NULL;
    if (near)
        return spin_args_misuse(&command, "no exporter writes '%s'; the nearest format is %s",
                                ending, near);
    return spin_args_misuse(
        &command, "choose a format with --to (see --list) or by the extension of --output");
}

static int check_arguments(void)
{
    if (!options.to && options.output && !options.target)
        options.to = spin_exporter_for(options.output);
    if (!spin_args.word)
        return spin_args_misuse(&command, "IN.spin is missing");
    if (!options.to && options.output && !options.target)
        return misuse_output(options.output);
    if (!options.to && !options.target)
        return spin_args_misuse(
            &command, "choose a format with --to (see --list) or by the extension of --output");
    if (!options.output)
        return spin_args_misuse(&command, "--output is missing");
    return SPIN_EXIT_OK;
}

int main(int argc, char **argv)
{
    char *report;
    int code;

    if (!spin_args_parse(&command, argc, argv, &code))
        return code;
    if (wants_list && spin_args.word)
        return spin_args_misuse(&command, "--list takes no IN.spin");
    if (wants_list)
        return spin_args_report(&command, list_exporters(), list_text);
    code = check_arguments();
    if (code != SPIN_EXIT_OK)
        return code;
    options.input = spin_args.word;
    options.force = spin_args.force;
    options.n_threads = spin_args.n_threads;
    options.plugin_pairs = spin_args.plugin_pairs;
    if (!spin_args_begin(&command, &code) ||
        !spin_args_ended(&command, spin_export(&options, &report), &code))
        return code;
    return spin_args_report(&command, report, spin_args.quiet ? NULL : text);
}
