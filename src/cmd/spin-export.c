/* spin-export: standard files out of a bundle. */
#include "cmd/args.h"

#include <math.h>
#include <string.h>

#include "spin_run.h"
#include "cmd/print.h"

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

static void list_json(void)
{
    spin_print_open(NULL, '[');
    for (const struct spin_exporter *const *i = spin_exporter_list(); *i; i++) {
        spin_print_open(NULL, '{');
        spin_print_string("name", (*i)->name);
        spin_print_string("summary", (*i)->summary);
        spin_print_bool("draws", (*i)->needs_renderer);
        spin_print_string("plugin", spin_plugin_origin(*i));
        spin_print_close('}');
    }
    spin_print_close(']');
}

static void list_text(void)
{
    for (const struct spin_exporter *const *i = spin_exporter_list(); *i; i++) {
        const char *origin = spin_plugin_origin(*i);

        printf("%-16s %s\n", (*i)->name, (*i)->summary);
        if (origin)
            printf("%-16s plug-in %s\n", "", origin);
    }
}

static const char *const parts[] = {"place",   "log scale", "rotation (degrees)",
                                    "opacity", "colour",    "sh"};
static const char *const part_keys[] = {"place",   "log_scale", "rotation_deg",
                                        "opacity", "colour",    "sh"};

static void check_json(const struct spin_export_check *c)
{
    if (c->frames == 0) {
        spin_print_null("check");
        return;
    }
    spin_print_open("check", '{');
    spin_print_integer("frames", c->frames);
    spin_print_integer("splats", (long long)c->splats);
    spin_print_number("bounds", c->bounds);
    for (int p = 0; p < 6; p++) {
        spin_print_open(part_keys[p], '{');
        spin_print_number("rms", c->rms[p]);
        spin_print_number("largest", c->largest[p]);
        spin_print_close('}');
    }
    if (c->rendered < 0)
        spin_print_null("rendered");
    else
        spin_print_integer("rendered", c->rendered);
    spin_print_number("psnr", c->psnr); /* null: infinite, or none was */
    spin_print_close('}');
}

static void check_text(const struct spin_export_check *c)
{
    printf("read back: %d %s, %llu splats; boxes differ by %.3g at most\n", c->frames,
           c->frames == 1 ? "frame" : "frames", (unsigned long long)c->splats, c->bounds);
    for (int p = 0; p < 6; p++)
        printf("  %-20s error %.3g rms, %.3g at most\n", parts[p], c->rms[p], c->largest[p]);
    if (isinf(c->psnr))
        printf("frame %d rendered from the file: the bundle's own picture\n", c->rendered);
    else if (c->psnr > 0)
        printf("frame %d rendered from the file: %.2f dB against the bundle's own picture\n",
               c->rendered, c->psnr);
}

static void report_json(const struct spin_export_report *r)
{
    spin_print_open(NULL, '{');
    spin_print_string("to", options.to);
    spin_print_string("output", options.output);
    spin_print_integer("frames", r->frames);
    spin_print_number("splats_mean", r->splats_mean);
    if (r->bytes)
        spin_print_integer("bytes", (long long)r->bytes);
    else
        spin_print_null("bytes");
    spin_print_integer("left_out", (long long)r->left_out);
    check_json(&r->check);
    spin_print_close('}');
}

static void report_text(const struct spin_export_report *r)
{
    char bytes[32], mean[32], frames[48], path[4096];

    printf("%s: %s as %s, %s splats each", spin_print_path(options.output, path),
           spin_print_count(r->frames, "frame", frames), options.to,
           spin_print_mean(r->splats_mean, mean));
    if (r->bytes)
        printf(", %s", spin_print_bytes((double)r->bytes, bytes));
    if (r->left_out)
        printf(", %llu splats left out", (unsigned long long)r->left_out);
    printf("\n");
    if (r->check.frames > 0)
        check_text(&r->check);
}

/* The exporter of files with that ending, or NULL. */
static const char *exporter_of(const char *output)
{
    static const char *const endings[][2] = {{".compressed.ply", "compressed-ply"},
                                             {".ply", "ply"},
                                             {".glb", "gltf"},
                                             {".sog", "sog"},
                                             {".splat", "splat"},
                                             {".spz", "spz"},
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
    struct spin_export_report report = {0};
    int code;

    if (!spin_args_parse(&command, argc, argv, &code))
        return code;
    if (wants_list) {
        if (spin_args.word)
            return spin_args_misuse(&command, "--list takes no IN.spin");
        if (spin_args.json)
            list_json();
        else
            list_text();
        return spin_args_finish(&command, SPIN_EXIT_OK);
    }
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
    if (spin_args.json)
        report_json(&report);
    else if (!spin_args.quiet)
        report_text(&report);
    return spin_args_finish(&command, SPIN_EXIT_OK);
}
