/* spin-export: standard files out of a bundle. */
#include "cmd/args.h"

#include <string.h>

#include "spin_run.h"
#include "io/json.h"

static struct spin_export_options options = {.device = "auto"};
static bool wants_list;

static const struct spin_args_row rows[] = {
    SPIN_ARG_HEADING("Output"),
    SPIN_ARG("to", 0, "NAME", STRING, options.to,
             "the exporter; otherwise what the ending of OUT says"),
    SPIN_ARG("output", 'o', "OUT", STRING, options.output, "the folder or file to write"),
    SPIN_ARG("range", 0, "A:B[:STEP]", RANGE, options.range, "export frame numbers A to B-1"),
    SPIN_ARG("source", 0, NULL, FLAG, options.source,
             "write the imported attributes instead of the retrained ones"),
    SPIN_ARG("check", 0, NULL, FLAG, options.check,
             "read back what was written and compare it with the bundle"),
    SPIN_ARG("sync", 0, NULL, FLAG, options.sync,
             "wait until every file is on the disk before it gets its name"),
    SPIN_ARG("list", 0, NULL, FLAG, wants_list, "list the exporters"),
    SPIN_ARG_HEADING("Data set, for exporters that draw"),
    SPIN_ARG_DATA_ROWS(options),
    SPIN_ARG("background", 0, "COLOUR", COLOUR, options.background,
             "black, white or R,G,B with each in 0..1 (black)", .min = 0, .max = 1),
    SPIN_ARG_HEADING("Machine"),
    SPIN_ARG_DEVICE_ROW(options),
    SPIN_ARG_END,
};

static const char *const usage[] = {
    "spin-export IN.spin [--to NAME] -o OUT [options]",
    "spin-export --list [--json]",
    NULL,
};

static const struct spin_args_command command = {
    .name = "spin-export",
    .summary = "write the frames of a bundle as standard files",
    .usage = usage,
    .rows = rows,
    .plugin_kind = "exporter",
    .plugin_selector = "to",
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

/* ---- For people ------------------------------------------------------------------------------ */

static const char list_text[] = "{{#.}}{{name %-16s}} {{summary}}\n"
                                "{{#plugin}}                 plug-in {{plugin}}\n{{/}}{{/}}";

static const char text[] =
    "{{output}}: {{frames %N frame}} as {{to}}, {{splats_mean %M}} splats each"
    "{{#bytes}}, {{bytes %B}}{{/}}{{#left_out}}, {{left_out}} splats left out{{/}}\n"
    "{{#check}}read back: {{frames %N frame}}, {{splats}} splats; "
    "boxes differ by {{bounds %.3g}} at most\n"
    "  place                error {{place.rms %.3g}} rms, {{place.largest %.3g}} at most\n"
    "  log scale            error {{log_scale.rms %.3g}} rms, {{log_scale.largest %.3g}} at most\n"
    "  rotation (degrees)   error {{rotation_deg.rms %.3g}} rms, {{rotation_deg.largest %.3g}} at "
    "most\n"
    "  opacity              error {{opacity.rms %.3g}} rms, {{opacity.largest %.3g}} at most\n"
    "  colour               error {{colour.rms %.3g}} rms, {{colour.largest %.3g}} at most\n"
    "  sh                   error {{sh.rms %.3g}} rms, {{sh.largest %.3g}} at most\n"
    "{{^rendered=}}frame {{rendered}} rendered from the file: {{#psnr}}{{psnr %.2f}} dB against "
    "{{/}}the bundle's own picture\n{{/}}{{/}}";

/* The exporter of files with that ending, or NULL. */
static const char *exporter_of(const char *output)
{
    static const char *const endings[][2] = {{".compressed.ply", "compressed-ply"},
                                             {".ftgs.ply", "ftgs"},
                                             {".ply", "ply"},
                                             {".glb", "gltf"},
                                             {".sog", "sog"},
                                             {".sogst", "sogst"},
                                             {".splat", "splat"},
                                             {".spz", "spz"},
                                             {".tsog", "tsog"},
                                             {".usda", "usd"},
                                             {".html", "html"},
                                             {".mp4", "video"},
                                             {".webm", "video"}};
    size_t n = strlen(output);

    for (size_t i = 0; i < sizeof endings / sizeof *endings; i++) {
        size_t n_ending = strlen(endings[i][0]);

        if (n > n_ending && strcmp(output + n - n_ending, endings[i][0]) == 0)
            return endings[i][1];
    }
    return NULL;
}

static int check(void)
{
    if (!options.to && options.output)
        options.to = exporter_of(options.output);
    if (!spin_args.word)
        return spin_args_misuse(&command, "IN.spin is missing");
    if (!options.to)
        return spin_args_misuse(&command,
                                "say what to write with --to, or by the ending of --output; --list "
                                "shows what there is");
    if (!options.output)
        return spin_args_misuse(&command, "say where to write with --output");
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
    code = check();
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
