/* spin-import: imports a run of another method as a bundle. */
#include "cmd/args.h"

#include <stdlib.h>
#include <string.h>
#include <strings.h>

#include "spin_run.h"
#include "io/json.h"

static struct spin_import_options options;
static struct spin_args_list times;
static const char *offsets;
static bool wants_info, wants_list, wants_views;

static const struct spin_args_row rows[] = {
    SPIN_ARG_HEADING("Input"),
    SPIN_ARG("from", 0, "NAME", STRING, options.from, "importer (detected)"),
    SPIN_ARG("data", 0, "DIR", STRING, options.data,
             "multi-view video that the run was trained on"),
    SPIN_ARG("data-from", 0, "NAME", STRING, options.data_from,
             "format of the data set, with options as NAME:KEY=VALUE,... (detected)"),
    SPIN_ARG("offsets", 0, "LIST", STRING, offsets,
             "cameras that start later, in frames or seconds, such as cam01=5,cam02=0.2s"),
    SPIN_ARG("pair", 0, "auto|number|order", CHOICE, options.pair,
             "match frames of the run and of the data set by number or by order (auto)"),
    SPIN_ARG_HEADING("Frames"),
    SPIN_ARG("frames", 0, "N", INT, options.n_frames,
             "continuous methods: sample N frames over the whole time range", .min = 1,
             .max = 1000000),
    SPIN_ARG("times", 0, "T0,T1,...", DOUBLES, times,
             "continuous methods: sample at these times, in the method's unit"),
    SPIN_ARG("frame-times", 0, "auto|data|unit|count", CHOICE, options.frame_times,
             "continuous methods: times of the data set's frames: as stored in it (data), or for "
             "frame i of n at i/(n-1) (unit) or i/n (count) of the time range (auto)"),
    SPIN_ARG("range", 0, "A:B[:STEP]", RANGE, options.range, "keep frames numbered A to B-1"),
    SPIN_ARG_HEADING("Output"),
    SPIN_ARG("output", 'o', "FILE", STRING, options.output, "bundle to write, *.spin"),
    SPIN_ARG("sync", 0, NULL, FLAG, options.sync,
             "flush the bundle to disk (fsync) before giving it its final name"),
    SPIN_ARG("positions-only", 0, NULL, FLAG, options.positions_only,
             "store positions only, without the source's attributes"),
    SPIN_ARG(
        "precision", 0, "full|half|compact", ENUM, options.precision,
        "precision of the rotations, scales, opacities and colours of 4D splats; full: lossless; "
        "half: about that of 16-bit floats; compact: quantised without visible loss (full)"),
    SPIN_ARG("info", 0, NULL, FLAG, wants_info, "describe the input without writing a bundle"),
    SPIN_ARG("full", 0, NULL, FLAG, options.full,
             "with --info: read every frame instead of a sample of 16"),
    SPIN_ARG("views", 0, NULL, FLAG, wants_views,
             "with --info of a bundle: list the images of its data set and their cameras"),
    SPIN_ARG("check-cameras", 0, "DIR", STRING, options.check_cameras,
             "draw the clip's points over the images of --data and write the PNGs to DIR"),
    SPIN_ARG("list", 0, NULL, FLAG, wants_list, "list the importers"),
    SPIN_ARG_END,
};

static const char *const usage[] = {
    "spin-import [--from NAME] INPUT -o OUT.spin [options]",
    "spin-import --info [--from NAME] INPUT|BUNDLE.spin [--json]",
    "spin-import --check-cameras DIR --data DATA INPUT [-o OUT.spin]",
    "spin-import --list [--json]",
    NULL,
};

static const char *const examples[] = {
    "spin-import output/balls --data data/balls -o balls.spin   a run and the images it was "
    "trained on",
    "spin-import --info output/balls                            describe a run or a bundle",
    "spin-import frames/ -o clip.spin                           a folder of splat files",
    NULL,
};

static const char *const main_options[] = {
    "output",         "data", "from",          "data-from", "range", "frames", "times", "pair",
    "positions-only", "info", "check-cameras", "list",      "force", "json",   "help",  NULL};

static const struct spin_args_command command = {
    .name = "spin-import",
    .summary = "import a run of another method as a bundle",
    .usage = usage,
    .examples = examples,
    .main = main_options,
    .rows = rows,
    .several = "for a clip of several files, give the folder that contains them",
    .plugin_kind = "importer",
    .plugin_selector = "from",
};

static char *list_importers(void)
{
    spin_json *list = spin_json_array();
    char *text;

    for (const struct spin_importer *const *i = spin_importer_list(); *i; i++)
        spin_json_push(list, json_pack("{s:o, s:o, s:o, s:b, s:b, s:o}", "name",
                                       spin_json_text_value((*i)->name), "summary",
                                       spin_json_text_value((*i)->summary), "upstream",
                                       spin_json_text_value((*i)->upstream), "tracks",
                                       (*i)->open != NULL, "views", (*i)->views != NULL, "plugin",
                                       spin_json_text_value(spin_plugin_origin(*i))));
    return spin_json_finish(list, &text) == SPIN_OK ? text : NULL;
}

/* ---- Templates of the reports ---------------------------------------------------------------- */

static const char list_text[] =
    "{{#.}}{{name %-16s}} {{#tracks}}tracks{{/}}{{^tracks}}views {{/}} {{summary}}\n"
    "{{#upstream}}                        {{upstream}}\n{{/}}"
    "{{#plugin}}                        plug-in {{plugin}}\n{{/}}{{/}}";

#define VERDICT "{{#verdict}}{{verdict}}\n{{/}}"
#define FROM "from        {{from}}{{#variant}}, {{variant}}{{/}}\n"
#define NUMBERS                                                                                    \
    ", numbers {{numbers.0}} to {{numbers.1}}{{^numbered}} (counted){{/}}, "                       \
    "times {{times.0 %.10g}} to {{times.1 %.10g}}\n"
#define SPLATS                                                                                     \
    "{{splats.min}}{{^splats.min=@splats.max}} to {{splats.max}}{{/}} a frame"                     \
    "{{^splats.min=@splats.max}}, mean {{splats.mean %.1f}}{{/}}"
#define ATTRIBUTES "{{#attributes}} {{.}}{{/}}{{^sh_degree=}} (SH degree {{sh_degree}}){{/}}\n"
#define SPLATS_4D                                                                                  \
    "{{#splats_4d}}4D splats   {{n}}, paths of degree {{degree}}"                                  \
    "{{#arrays.0}}, with{{#arrays}} {{.}}{{/}}{{/}}: frames are their slices\n{{/}}"
#define SOUND "{{#sound}}sound       {{name}}, {{type}}, {{bytes %B}}\n{{/}}"
#define STATIC "{{#static.0}}static     {{#static}} {{.}}{{/}}\n{{/}}"
/* The lines of the report that --info prints but an import does not. */
#define RECOGNISED "recognised  {{recognised}}\nupstream    {{upstream}}\n"

#define REPORT_TO_SPLATS                                                                           \
    "{{#continuous}}time        any from {{time_range.0 %.10g}} to {{time_range.1 %.10g}}, "       \
    "{{#sampled=ends}}read at both ends (choose other times with --frames, --times or "            \
    "--data){{/}}"                                                                                 \
    "{{#sampled=evenly}}sampled evenly{{/}}"                                                       \
    "{{#sampled=times}}sampled at the times of --times{{/}}"                                       \
    "{{#sampled=data}}sampled as the data set's frames are{{/}}\n{{/}}"                            \
    "{{^sampled=ends}}frames      {{frames}}" NUMBERS "{{/}}"                                      \
    "splats      " SPLATS "\nattributes " ATTRIBUTES SPLATS_4D SOUND
#define REPORT_FROM_BOUNDS                                                                         \
    "bounds      [{{bounds.min.0 %g}}, {{bounds.min.1 %g}}, {{bounds.min.2 %g}}] to "              \
    "[{{bounds.max.0 %g}}, {{bounds.max.1 %g}}, {{bounds.max.2 %g}}]\n"                            \
    "{{#ranges}}read        "                                                                      \
    "{{#sampled=ends}}at {{times.0 %.10g}} and {{times.1 %.10g}}{{/}}"                             \
    "{{^sampled=ends}}{{frames_read}} of {{frames %N frame}}"                                      \
    "{{^frames_read=@frames}}, evenly (--full reads all){{/}}{{/}}\n"                              \
    "            attribute               least       median      largest\n{{/}}"                   \
    "{{*ranges}}            {{@ %-16s}} {{min %12.5g}} {{median %12.5g}} {{max %12.5g}}"           \
    "{{#scales.0}}   scales {{scales.0 %.4g}}, {{scales.1 %.4g}}, {{scales.2 %.4g}}{{/}}"          \
    "{{#opacities.0}}   opacities {{opacities.0 %.4g}}, {{opacities.1 %.4g}}, "                    \
    "{{opacities.2 %.4g}}{{/}}"                                                                    \
    "{{^not_finite=0}}   {{not_finite %.3P}} % not finite{{/}}\n{{/}}"                             \
    "{{#finite}}            all values are finite\n{{/}}"                                          \
    "{{#notes}}note        {{.}}\n{{/}}"                                                           \
    "{{#cameras}}check       frame {{frame}}, camera {{camera}}: {{in_front %.1p}} % of the "      \
    "points in front, {{inside %.1p}} % inside, {{folder}}/{{file}}\n{{/}}"                        \
    "{{#shares.cameras}}camera {{camera %-4d}} at least {{least_in_front %.1p}} % of the points "  \
    "in front, {{least_inside %.1p}} % inside{{#apart}}: far fewer than others{{/}}\n{{/}}"        \
    "{{#shares}}median      {{in_front %.1p}} % of the points in front, {{inside %.1p}} % "        \
    "inside, of all views\n{{/}}"                                                                  \
    "{{#output}}written     {{output}}\n{{/}}"

static const char views_text[] =
    " frame  camera  pixels     focal lengths        split  image\n"
    "{{#.}}{{frame %6d}}{{camera %8d}}  {{width}}x{{height}}  {{fx %9.3f}} {{fy %9.3f}}  "
    "{{#test}}test {{/}}{{^test}}train{{/}}  {{image}}\n{{/}}";

#define STAGE                                                                                      \
    "            attributes:" ATTRIBUTES                                                           \
    "{{#before}}            held-out views before: {{psnr %.2f}} dB, SSIM {{ssim %.4f}}\n{{/}}"    \
    "{{#test}}            held-out views after: {{psnr %.2f}} dB, SSIM {{ssim %.4f}}\n{{/}}"       \
    "{{#options}}            settings: {{options}}\n{{/}}{{/}}"
static const char bundle_text[] =
    "bundle      {{bundle}}, by {{generator}}\n" FROM "upstream    {{upstream}}\n"
    "{{#data}}data        {{data}}, {{data_from}}{{^data_there}}: not found{{/}}\n{{/}}"
    "frames      {{frames}} of the source's {{source_frames}}" NUMBERS "splats      " SPLATS
    "\nattributes " ATTRIBUTES SPLATS_4D SOUND STATIC "{{#refined}}refined     " SPLATS
    ", {{options.iterations}} iterations each\n" STAGE "{{#trained}}trained     " SPLATS
    ", {{options.iterations}} iterations on {{device}}"
    "{{^field}}, no network{{/}}{{#field}}; {{levels}} levels of {{features}} features, "
    "{{rows}} rows, hidden width {{hidden}}{{/}}\n" STAGE
    "{{#trained_4d}}trained     4D splats, {{options.iterations}} iterations on {{device}}\n" STAGE
    "size        {{bytes.file %B}}{{#bytes.source}}, source {{bytes.source %B}}{{/}}"
    "{{#bytes.refined}}, refined {{bytes.refined %B}}{{/}}"
    "{{#bytes.positions}}, values of frames {{bytes.positions %B}}{{/}}"
    "{{#bytes.tracks}}, tracks {{bytes.tracks %B}}{{/}}"
    "{{#bytes.table}}, table {{bytes.table %B}}{{/}}"
    "{{#bytes.heads}}, heads {{bytes.heads %B}}{{/}}"
    "{{^bytes_unpacked.file=@bytes.file}}; unpacked {{bytes_unpacked.file %B}}{{/}}\n";

/* Finds an importer by its name. Options of a data set may follow the name, as in
 * "dynerf:time=unit". */
static const struct spin_importer *find_importer(const char *name)
{
    size_t length = name ? strcspn(name, ":") : 0;

    if (!name)
        return NULL;
    for (const struct spin_importer *const *i = spin_importer_list(); *i; i++)
        if (strlen((*i)->name) == length && !strncasecmp((*i)->name, name, length))
            return *i;
    return NULL;
}

/* Reports usage errors that can be detected without opening a file. Returns an exit code. */
static int check_arguments(void)
{
    const struct spin_importer *from = find_importer(options.from);
    const struct spin_importer *data_from = find_importer(options.data_from);

    if (!spin_args.word)
        return spin_args_misuse(&command, "INPUT is missing");
    if (wants_info && options.output)
        return spin_args_misuse(&command,
                                "--info and --output exclude each other: --info writes nothing");
    if (!wants_info && !options.output && !options.check_cameras)
        return spin_args_misuse(&command,
                                "--output is missing; to describe the input only, use --info");
    if (wants_views && !wants_info)
        return spin_args_misuse(&command, "--views requires --info");
    if (options.full && !wants_info)
        return spin_args_misuse(&command,
                                "--full requires --info: an import always reads every frame");
    if (from && !from->open)
        return spin_args_misuse(
            &command, "importer '%s' reads data sets, not runs: use --data-from", from->name);
    if (options.data_from &&
        (data_from ? !data_from->views : !spin_plugin_fault(options.data_from)))
        return spin_args_misuse(&command,
                                "unknown data set format '%s'; --list shows those available",
                                options.data_from);
    if (offsets && !options.data)
        return spin_args_misuse(&command, "--offsets requires --data");
    if (options.n_frames && times.n)
        return spin_args_misuse(&command, "--frames and --times exclude each other");
    return SPIN_EXIT_OK;
}

/* Appends the option `offsets` of data sets to --data-from. */
static const char *join_offsets(const char *from)
{
    size_t n = (from ? strlen(from) : 0) + strlen(offsets) + 16;
    char *text = malloc(n);

    if (!text)
        return from;
    snprintf(text, n, "%s%soffsets=%s", from ? from : "", from && strchr(from, ':') ? "," : ":",
             offsets);
    for (char *at = text + (from ? strlen(from) : 0) + 1; (at = strchr(at, ','));)
        *at = ';';
    return text;
}

static spin_status describe_or_import(char **report, const char **text)
{
    spin_status status = SPIN_E_NOT_RECOGNISED;

    *text = bundle_text;
    if (wants_info && !options.from && !options.check_cameras)
        status = spin_bundle_describe(options.input, report);
    if (status != SPIN_E_NOT_RECOGNISED)
        return status;
    *text = wants_info        ? VERDICT FROM RECOGNISED REPORT_TO_SPLATS STATIC REPORT_FROM_BOUNDS
            : spin_args.quiet ? NULL
                              : VERDICT FROM REPORT_TO_SPLATS REPORT_FROM_BOUNDS;
    return spin_import(&options, report);
}

int main(int argc, char **argv)
{
    spin_status status;
    const char *text = NULL;
    char *report = NULL;
    int code;

    if (!spin_args_parse(&command, argc, argv, &code))
        return code;
    if (wants_list && spin_args.word)
        return spin_args_misuse(&command, "--list takes no INPUT");
    if (wants_list)
        return spin_args_report(&command, list_importers(), list_text);
    code = check_arguments();
    if (code != SPIN_EXIT_OK)
        return code;
    if (offsets)
        options.data_from = join_offsets(options.data_from);
    options.input = spin_args.word;
    options.times = times.doubles;
    options.n_times = times.n;
    options.force = spin_args.force;
    options.plugin_pairs = spin_args.plugin_pairs;
    if (!spin_args_begin(&command, &code))
        return code;
    if (wants_views) {
        status = spin_bundle_views(options.input, options.data, options.data_from, &report);
        text = views_text;
    } else {
        status = describe_or_import(&report, &text);
    }
    if (!spin_args_ended(&command, status, &code)) {
        free(report);
        return code;
    }
    return spin_args_report(&command, report, text);
}
