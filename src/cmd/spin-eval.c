/* spin-eval: measures a bundle against the images of its data set. */
#include "cmd/args.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "spin_run.h"
#include "base/text.h"
#include "io/json.h"

static struct spin_eval_options options = {.image_scale = 1, .device = "auto"};
static struct spin_args_list test_cameras;
static const char *table, *figures;

static const struct spin_args_row rows[] = {
    SPIN_ARG_HEADING("What to measure"),
    SPIN_ARG("source", 0, NULL, FLAG, options.source,
             "measure the imported attributes instead of the retrained ones"),
    SPIN_ARG("split", 0, "test|train|all|outer", ENUM, options.split,
             "cameras to measure; outer: held-out cameras outside the training cameras (test)"),
    SPIN_ARG("test-cams", 0, "LIST", INTS, test_cameras,
             "numbers of the held-out cameras (those of the training, or of the data set)",
             .min = 0, .max = 1e9),
    SPIN_ARG("range", 0, "A:B[:STEP]", RANGE, options.range,
             "measure frames numbered A to B-1 (all)"),
    SPIN_ARG("scale", 0, "S", DOUBLE, options.image_scale,
             "scale of the images; 0.5 halves width and height (1)", .min = 0.01, .max = 1),
    SPIN_ARG("background", 0, "COLOUR", COLOUR, options.background,
             "colour behind the splats: black, white or R,G,B with each in 0..1 (black)", .min = 0,
             .max = 1),
    SPIN_ARG("dynamic", 0, "auto|masks|images|off", ENUM, options.dynamic,
             "find dynamic regions by the data set's masks, or by changes in its images (auto)"),
    SPIN_ARG("mask", 0, NULL, FLAG, options.mask,
             "measure the subject only, given by the data set's masks or the images' alpha"),
    SPIN_ARG("temporal", 0, NULL, FLAG, options.temporal,
             "measure flicker: the differences between successive frames of static cameras"),
    SPIN_ARG("lpips", 0, "DIR", STRING, options.lpips,
             "measure LPIPS with the network weights in DIR; see the manual"),
    SPIN_ARG("lpips-backbone", 0, "FILE", STRING, options.lpips_backbone,
             "LPIPS backbone, as published by torchvision"),
    SPIN_ARG("lpips-lin", 0, "FILE", STRING, options.lpips_lin,
             "LPIPS linear heads, as in the lpips package"),
    SPIN_ARG("images", 0, "DIR", STRING, options.images,
             "write one PNG per view: ground truth | source | render"),
    SPIN_ARG("report", 0, "FILE.html", STRING, options.report,
             "write a page with curves, tables and images; several bundles are compared"),
    SPIN_ARG("figures", 0, "DIR", STRING, figures,
             "write the report's curves as SVG, and its images of fast motion as PNG and SVG"),
    SPIN_ARG("table", 0, "md|csv|latex", CHOICE, table,
             "print a table with one row per bundle, as Markdown, CSV or LaTeX"),
    SPIN_ARG("log", 0, "FILE", STRING, options.log,
             "training log written by spin-retrain --log, for the report"),
    SPIN_ARG_HEADING("Data set"),
    SPIN_ARG_DATA_ROWS(options),
    SPIN_ARG_HEADING("Machine"),
    SPIN_ARG_DEVICE_ROW(options),
    SPIN_ARG_END,
};

static const char *const usage[] = {
    "spin-eval IN.spin [--data DIR] [--split test|train|all] [--source] [options]",
    "spin-eval A.spin B.spin ... [--table md|csv|latex] [--report FILE.html] [options]",
    NULL,
};

static const char *const examples[] = {
    "spin-eval better.spin                        measure the held-out views",
    "spin-eval better.spin --report report.html   write a page with curves, tables and images",
    "spin-eval ball.spin better.spin --table md   compare two bundles in a table",
    NULL,
};

static const char *const main_options[] = {
    "report",  "figures", "table", "images", "split", "test-cams", "source",  "range", "scale",
    "dynamic", "mask",    "lpips", "data",   "force", "json",      "verbose", "help",  NULL};

static const struct spin_args_command command = {
    .name = "spin-eval",
    .summary = "measure PSNR, SSIM and LPIPS of a bundle against its data set",
    .usage = usage,
    .examples = examples,
    .main = main_options,
    .rows = rows,
    .takes_many = true,
};

/* ---- Templates of the reports ---------------------------------------------------------------- */

#define MEASURES                                                                                   \
    "{{psnr %10.3f}}{{ssim %9.4f}}{{^dynamic_from=off}}{{psnr_dynamic %10.3f}}{{/}}"               \
    "{{#lpips_vgg}}{{lpips_vgg %12.4f}}{{/}}{{#lpips_alex}}{{lpips_alex %12.4f}}{{/}}"
#define HEAD                                                                                       \
    " frame  camera      PSNR     SSIM{{^dynamic_from=off}}   dynamic{{/}}"                        \
    "{{#lpips_vgg}}   LPIPS VGG{{/}}{{#lpips_alex}}  LPIPS Alex{{/}}\n"
#define VIEWS "{{#views}}{{frame %6d}}{{camera %8d}}" MEASURES "\n{{/}}"
#define MEANS                                                                                      \
    "{{#frames}}{{frame %6d}}     all" MEASURES "\n{{/}}"                                          \
    "{{#cameras}}   all{{id %8d}}" MEASURES "\n{{/}}"
#define ALL "   all     all" MEASURES "   {{views %N view}}, {{attributes}} attributes\n"
#define FOOT                                                                                       \
    "{{#mask}}mask     subject only, from {{mask}} of the data set\n{{/}}"                         \
    "{{^dynamic_from=off}}dynamic  {{dynamic %.2p}} % of the pixels, from "                        \
    "{{#dynamic_from=masks}}foreground masks{{/}}{{#dynamic_from=images}}the images{{/}}: "        \
    "PSNR {{psnr_dynamic %.3f}} there, {{psnr_static %.3f}} elsewhere\n{{/}}"                      \
    "{{#flicker}}flicker  {{flicker %.3f}} of 255 in static regions ({{flicker_images %.3f}} in "  \
    "the "                                                                                         \
    "images){{#flicker_dynamic}}; error of the differences in dynamic regions {{flicker_dynamic "  \
    "%.3f}}{{/}}\n{{/}}"                                                                           \
    "{{#background_shows}}{{^alpha_known}}holes    {{/}}{{#alpha_known}}alpha    {{/}}"            \
    "PSNR {{psnr_opposite %.3f}} over the opposite background: "                                   \
    "{{^alpha_known}}the splats are transparent in places{{/}}"                                    \
    "{{#alpha_known}}the alpha of the splats differs from that of the images{{/}}\n{{/}}"          \
    "speed    {{fps %.2f}} frames per second with decoding, {{fps_draw %.2f}} without\n"           \
    "size     {{storage.file %B}} on disk, {{storage_unpacked.file %B}} unpacked; "                \
    "{{storage.measured %B}} for the measured attributes, "                                        \
    "{{storage.measured_per_frame %B}} per frame\n"

/* Tables with a row per bundle. The first bundle determines the columns. */
#define EACH(text) "{{#runs}}" text "{{/}}"
#define IF_DYNAMIC(text) "{{#runs.0.psnr_dynamic}}" text "{{/}}"
#define IF_VGG(text) "{{#runs.0.lpips_vgg}}" text "{{/}}"
#define IF_FLICKER(text) "{{#runs.0.flicker}}" text "{{/}}"
#define IF_ALEX(text) "{{#runs.0.lpips_alex}}" text "{{/}}"

static const char plain_text[] =
    "      PSNR     SSIM" IF_DYNAMIC("   dynamic") IF_FLICKER("   flicker") IF_VGG("   LPIPS VGG")
        IF_ALEX("  LPIPS Alex") "        file  attributes  run\n" EACH(
            "{{psnr %10.3f}}{{ssim %9.4f}}" IF_DYNAMIC("{{psnr_dynamic %10.3f}}")
                IF_FLICKER("{{flicker %10.3f}}") IF_VGG("{{lpips_vgg %12.4f}}") IF_ALEX(
                    "{{lpips_alex %12.4f}}") "{{file_megabytes %9.2f}} MB{{megabytes %9.2f}} "
                                             "MB  {{name}}\n");

static const char md_text[] = "| run | PSNR | SSIM |" IF_DYNAMIC(" PSNR, dynamic |")
    IF_FLICKER(" flicker |") IF_VGG(" LPIPS VGG |") IF_ALEX(
        " LPIPS Alex |") " file, MB | attributes, MB |\n|---|---:|---:|" IF_DYNAMIC("---:|")
        IF_FLICKER("---:|") IF_VGG("---:|") IF_ALEX("---:|") "---:|---:|\n" EACH(
            "| {{escaped}} | {{psnr %.2f}} | {{ssim %.4f}} |" IF_DYNAMIC(" {{psnr_dynamic %.2f}} |")
                IF_FLICKER(" {{flicker %.3f}} |") IF_VGG(" {{lpips_vgg %.4f}} |") IF_ALEX(
                    " {{lpips_alex %.4f}} |") " {{file_megabytes %.2f}} | {{megabytes %.2f}} |\n");

static const char csv_text[] = "run,psnr,ssim" IF_DYNAMIC(",psnr_dynamic") IF_FLICKER(",flicker")
    IF_VGG(",lpips_vgg") IF_ALEX(",lpips_alex") ",megabytes,file_megabytes\n" EACH(
        "{{escaped}},{{psnr %.6f}},{{ssim %.6f}}" IF_DYNAMIC(",{{psnr_dynamic %.6f}}")
            IF_FLICKER(",{{flicker %.6f}}") IF_VGG(",{{lpips_vgg %.6f}}")
                IF_ALEX(",{{lpips_alex %.6f}}") ",{{megabytes %.6f}},{{file_megabytes %.6f}}\n");

static const char latex_text[] = "\\begin{tabular}{lrr" IF_DYNAMIC("r") IF_FLICKER("r") IF_VGG("r")
    IF_ALEX("r") "rr}\n"
                 "run & PSNR & SSIM" IF_DYNAMIC(" & PSNR, dynamic") IF_FLICKER(" & flicker") IF_VGG(
                     " & LPIPS VGG")
                     IF_ALEX(" & LPIPS Alex") " & file, MB & attributes, MB \\\\\n\\hline\n" EACH(
                         "{{escaped}} & {{psnr %.2f}} & {{ssim %.4f}}" IF_DYNAMIC(
                             " & {{psnr_dynamic %.2f}}") IF_FLICKER(" & {{flicker %.3f}}")
                             IF_VGG(" & {{lpips_vgg %.4f}}")
                                 IF_ALEX(" & {{lpips_alex %.4f}}") " & {{file_megabytes %.2f}} & "
                                                                   "{{megabytes %.2f}} "
                                                                   "\\\\\n") "\\end{tabular}\n";

/* Writes a run's name, escaped for the format of the table. */
static void write_escaped(const char *name, FILE *to)
{
    bool csv = table && *table == 'c', latex = table && *table == 'l';

    if (csv)
        putc('"', to);
    for (; *name; name++) {
        if (csv && *name == '"')
            putc('"', to);
        if (latex && *name == '\\')
            fputs("\\textbackslash ", to);
        else if (latex && (*name == '~' || *name == '^'))
            fprintf(to, "\\%c{}", *name);
        else if ((latex && strchr("&%$#_{}", *name)) || (!csv && !latex && strchr("|\\", *name)))
            fprintf(to, "\\%c", *name);
        else
            putc(*name, to);
    }
    if (csv)
        putc('"', to);
}

/* Adds values that only tables contain to each run of the report: the escaped name, and sizes in
 * megabytes. Takes ownership of `report`. */
static char *add_table_values(char *report)
{
    spin_json *document = NULL, *runs;
    char *text = report;

    if (!report || spin_json_parse("report", report, strlen(report), &document) != SPIN_OK)
        return report;
    runs = spin_json_get(document, "runs");
    for (size_t i = 0; i < spin_json_length(runs); i++) {
        spin_json *run = spin_json_at(runs, i);
        double bytes = NAN;
        char *name = NULL;
        size_t n;
        FILE *to = spin_text_open(&name, &n);

        spin_json_number(spin_json_get(spin_json_get(run, "storage"), "measured"), &bytes);
        spin_json_set_number(run, "megabytes", bytes / 1e6);
        spin_json_number(spin_json_get(spin_json_get(run, "storage"), "file"), &bytes);
        spin_json_set_number(run, "file_megabytes", bytes / 1e6);
        if (to) {
            write_escaped(spin_json_string(spin_json_get(run, "name")), to);
            fclose(to);
        }
        spin_json_set_string(run, "escaped", name ? name : "");
        free(name);
    }
    free(report);
    return spin_json_finish(document, &text) == SPIN_OK ? text : NULL;
}

/* Measures and compares several bundles. It also measures a single bundle if --table or --figures
 * is given. */
static int compare_bundles(void)
{
    const char *form = !table          ? plain_text
                       : *table == 'm' ? md_text
                       : *table == 'c' ? csv_text
                                       : latex_text;
    char *report;
    int code;

    if (options.images || options.log)
        return spin_args_misuse(
            &command,
            "--images and --log cannot be combined with --table, --figures or several bundles");
    if (table && spin_args.json)
        return spin_args_misuse(&command, "--table and --json exclude each other");
    if (!spin_args_begin(&command, &code) ||
        !spin_args_ended(
            &command,
            spin_compare(&options, spin_args.all_words, spin_args.n_words, figures, &report),
            &code))
        return code;
    return spin_args_report(&command, spin_args.json ? report : add_table_values(report), form);
}

int main(int argc, char **argv)
{
    char *report;
    int code;

    if (!spin_args_parse(&command, argc, argv, &code))
        return code;
    if (!spin_args.word)
        return spin_args_misuse(&command, "IN.spin is missing");
    options.input = spin_args.word;
    options.test_cameras = test_cameras.ints;
    options.n_test_cameras = test_cameras.n;
    options.n_threads = spin_args.n_threads;
    options.force = spin_args.force;
    if (spin_args.n_words > 1 || table || figures)
        return compare_bundles();
    if (!spin_args_begin(&command, &code) ||
        !spin_args_ended(&command, spin_eval(&options, &report), &code))
        return code;
    return spin_args_report(&command, report,
                            spin_args.quiet     ? HEAD ALL
                            : spin_args.verbose ? HEAD VIEWS MEANS ALL FOOT
                                                : HEAD MEANS ALL FOOT);
}
