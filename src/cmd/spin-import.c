/* spin-import: another method's run to a bundle. */
#include "cmd/args.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "spin_run.h"
#include "cmd/print.h"

static struct spin_import_options options;
static struct spin_args_list times;
static bool wants_info, wants_list;

static const struct spin_args_row rows[] = {
    SPIN_ARG_HEADING("Input"),
    SPIN_ARG("from", 0, "NAME", STRING, options.from, "the importer (detected)"),
    SPIN_ARG("data", 0, "DIR", STRING, options.data,
             "the multi-view video that the run was trained on"),
    SPIN_ARG("data-from", 0, "NAME", STRING, options.data_from,
             "kind of that data set (detected); with options NAME:KEY=VALUE,..."),
    SPIN_ARG(
        "pair", 0, "auto|number|order", CHOICE, options.pair,
        "match frames of the run and of the data set by their numbers or by their order (auto)"),
    SPIN_ARG_HEADING("Frames"),
    SPIN_ARG("frames", 0, "N", INT, options.n_frames,
             "continuous methods: sample N frames over the whole time range", .min = 1,
             .max = 1000000),
    SPIN_ARG("times", 0, "T0,T1,...", DOUBLES, times,
             "continuous methods: sample at these times, in the unit of the method"),
    SPIN_ARG("frame-times", 0, "auto|data|unit|count", CHOICE, options.frame_times,
             "continuous methods: the times of the data set's frames: its own, i/(n-1) or i/n of "
             "the range (auto)"),
    SPIN_ARG("range", 0, "A:B[:STEP]", RANGE, options.range, "keep frame numbers A to B-1"),
    SPIN_ARG_HEADING("Output"),
    SPIN_ARG("output", 'o', "FILE", STRING, options.output, "the bundle to write, *.spin"),
    SPIN_ARG("sync", 0, NULL, FLAG, options.sync,
             "wait until the bundle is on the disk before it gets its name"),
    SPIN_ARG("positions-only", 0, NULL, FLAG, options.positions_only,
             "leave the source's attributes out"),
    SPIN_ARG("info", 0, NULL, FLAG, wants_info, "describe the input and write nothing"),
    SPIN_ARG("full", 0, NULL, FLAG, options.full,
             "with --info: read every frame instead of 16 of them"),
    SPIN_ARG("check-cameras", 0, "DIR", STRING, options.check_cameras,
             "draw the clip's points over the images of --data, as PNGs in DIR"),
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

static const struct spin_args_command command = {
    .name = "spin-import",
    .summary = "read a run of another method into a bundle",
    .usage = usage,
    .rows = rows,
    .plugin_kind = "importer",
    .plugin_selector = "from",
};

static void list_json(void)
{
    spin_print_open(NULL, '[');
    for (const struct spin_importer *const *i = spin_importer_list(); *i; i++) {
        spin_print_open(NULL, '{');
        spin_print_string("name", (*i)->name);
        spin_print_string("summary", (*i)->summary);
        spin_print_string("upstream", (*i)->upstream);
        spin_print_bool("tracks", (*i)->open != NULL);
        spin_print_bool("views", (*i)->views != NULL);
        spin_print_string("plugin", spin_plugin_origin(*i));
        spin_print_close('}');
    }
    spin_print_close(']');
}

static void list_text(void)
{
    for (const struct spin_importer *const *i = spin_importer_list(); *i; i++) {
        const struct spin_importer *importer = *i;
        const char *origin = spin_plugin_origin(importer);

        printf("%-16s %-6s %s\n", importer->name, importer->open ? "tracks" : "views",
               importer->summary);
        if (importer->upstream)
            printf("%-16s %-6s %s\n", "", "", importer->upstream);
        if (origin)
            printf("%-16s %-6s plug-in %s\n", "", "", origin);
    }
}

static const struct {
    enum spin_column column;
    const char *name;
} columns[] = {
    {SPIN_COL_MEANS, "means"},
    {SPIN_COL_QUATS, "quats"},
    {SPIN_COL_LOG_SCALES, "log_scales"},
    {SPIN_COL_LOGIT_OPACITIES, "logit_opacities"},
    {SPIN_COL_SH, "sh"},
    {SPIN_COL_RGB, "rgb"},
};
enum { N_COLUMNS = sizeof columns / sizeof columns[0] };

static void print_vector(const char *key, const float v[3])
{
    spin_print_open(key, '[');
    for (int axis = 0; axis < 3; axis++)
        spin_print_number(NULL, (double)v[axis]);
    spin_print_close(']');
}

/* The notes come as lines. */
static void print_notes(const char *notes)
{
    spin_print_open("notes", '[');
    while (*notes) {
        char line[sizeof((struct spin_import_report *)NULL)->notes];
        size_t length = strcspn(notes, "\n");

        if (length > 0 && length < sizeof line) {
            memcpy(line, notes, length);
            line[length] = '\0';
            spin_print_string(NULL, line);
        }
        notes += length + (notes[length] == '\n');
    }
    spin_print_close(']');
}

static void print_columns(const char *key, unsigned held)
{
    spin_print_open(key, '[');
    for (int i = 0; i < N_COLUMNS; i++)
        if (held & columns[i].column)
            spin_print_string(NULL, columns[i].name);
    spin_print_close(']');
}

static void print_ranges(const struct spin_import_report *r)
{
    spin_print_open("ranges", '{');
    for (int i = 0; i < r->n_ranges; i++) {
        spin_print_open(r->range[i].name, '{');
        spin_print_number("min", r->range[i].min);
        spin_print_number("median", r->range[i].median);
        spin_print_number("max", r->range[i].max);
        spin_print_number("not_finite", r->range[i].not_finite);
        spin_print_close('}');
    }
    spin_print_close('}');
}

static void print_cameras(const struct spin_import_report *r)
{
    spin_print_open("cameras", '[');
    for (int i = 0; i < r->n_cameras; i++) {
        spin_print_open(NULL, '{');
        spin_print_integer("frame", r->camera[i].frame);
        spin_print_integer("camera", r->camera[i].camera);
        spin_print_number("in_front", r->camera[i].in_front);
        spin_print_number("inside", r->camera[i].inside);
        spin_print_string("file", r->camera[i].file);
        spin_print_close('}');
    }
    spin_print_close(']');
    spin_print_open("shares", '{');
    spin_print_number("in_front", r->median_in_front);
    spin_print_number("inside", r->median_inside);
    spin_print_open("cameras", '[');
    for (int i = 0; i < r->n_shares; i++) {
        const struct spin_import_share *s = &r->share[i];

        spin_print_open(NULL, '{');
        spin_print_integer("camera", s->camera);
        spin_print_integer("frame", s->frame);
        spin_print_number("least_in_front", s->in_front);
        spin_print_number("least_inside", s->inside);
        spin_print_bool("apart", s->apart);
        spin_print_close('}');
    }
    spin_print_close(']');
    spin_print_close('}');
}

/* By enum spin_sampling. */
static const char *const samplings[] = {"stored", "ends", "evenly", "times", "data"};

static void report_json(const struct spin_import_report *r)
{
    spin_print_open(NULL, '{');
    spin_print_string("from", r->from);
    spin_print_string("variant", r->variant);
    spin_print_string("upstream", r->upstream);
    spin_print_string("recognised", r->recognised);
    spin_print_integer("frames", r->frames);
    spin_print_integer("frames_read", r->frames_read);
    spin_print_open("splats", '{');
    spin_print_integer("min", (long long)r->splats_min);
    spin_print_number("mean", r->splats_mean);
    spin_print_integer("max", (long long)r->splats_max);
    spin_print_close('}');
    spin_print_open("times", '[');
    spin_print_number(NULL, r->time_first);
    spin_print_number(NULL, r->time_last);
    spin_print_close(']');
    spin_print_bool("continuous", r->continuous);
    if (r->continuous) {
        spin_print_open("time_range", '[');
        spin_print_number(NULL, r->range_first);
        spin_print_number(NULL, r->range_last);
        spin_print_close(']');
        spin_print_string("sampled", samplings[r->sampling]);
    }
    spin_print_bool("numbered", r->numbered);
    spin_print_open("numbers", '[');
    spin_print_integer(NULL, r->number_first);
    spin_print_integer(NULL, r->number_last);
    spin_print_close(']');
    if (r->sh_degree < 0)
        spin_print_null("sh_degree");
    else
        spin_print_integer("sh_degree", r->sh_degree);
    print_columns("attributes", r->columns);
    print_columns("static", r->static_columns);
    spin_print_open("bounds", '{');
    print_vector("min", r->bounds_min);
    print_vector("max", r->bounds_max);
    spin_print_close('}');
    if (r->n_ranges > 0)
        print_ranges(r);
    print_notes(r->notes);
    if (options.check_cameras)
        print_cameras(r);
    if (options.output)
        spin_print_string("output", options.output);
    spin_print_close('}');
}

/* What people think in, beside what is stored. */
static void text_finished(const struct spin_import_range *x)
{
    if (!strcmp(x->name, "log_scales"))
        printf("   scales %.4g, %.4g, %.4g", exp(x->min), exp(x->median), exp(x->max));
    if (!strcmp(x->name, "logit_opacities"))
        printf("   opacities %.4g, %.4g, %.4g", 1 / (1 + exp(-x->min)), 1 / (1 + exp(-x->median)),
               1 / (1 + exp(-x->max)));
}

static void text_ranges(const struct spin_import_report *r)
{
    double worst = 0;

    if (r->n_ranges == 0)
        return;
    if (r->sampling == SPIN_SAMPLED_ENDS)
        printf("read        at %.10g and %.10g\n", r->time_first, r->time_last);
    else
        printf("read        %d of %d frames%s\n", r->frames_read, r->frames,
               r->frames_read < r->frames ? ", evenly (--full reads all)" : "");
    printf("            %-16s %12s %12s %12s\n", "attribute", "least", "median", "largest");
    for (int i = 0; i < r->n_ranges; i++) {
        const struct spin_import_range *x = &r->range[i];

        printf("            %-16s %12.5g %12.5g %12.5g", x->name, x->min, x->median, x->max);
        text_finished(x);
        if (x->not_finite > 0)
            printf("   %.3g %% not finite", 100 * x->not_finite);
        printf("\n");
        worst = x->not_finite > worst ? x->not_finite : worst;
    }
    if (worst == 0)
        printf("            all values are finite\n");
}

static void text_cameras(const struct spin_import_report *r)
{
    char path[4096];

    for (int i = 0; i < r->n_cameras; i++)
        printf("check       frame %d, camera %d: %.1f %% of the points in front, %.1f %% inside, "
               "%s/%s\n",
               r->camera[i].frame, r->camera[i].camera, 100 * r->camera[i].in_front,
               100 * r->camera[i].inside, spin_print_path(options.check_cameras, path),
               r->camera[i].file);
    for (int i = 0; i < r->n_shares; i++)
        printf("camera %-4d at least %.1f %% of the points in front, %.1f %% inside%s\n",
               r->share[i].camera, 100 * r->share[i].in_front, 100 * r->share[i].inside,
               r->share[i].apart ? ": far fewer than others" : "");
    if (r->n_shares > 0)
        printf("median      %.1f %% of the points in front, %.1f %% inside, of all views\n",
               100 * r->median_in_front, 100 * r->median_inside);
}

/* Frames, or when a method that is defined at any time was looked at. */
static void text_frames(const struct spin_import_report *r)
{
    static const char *const how[] = {
        [SPIN_SAMPLED_ENDS] = "read at both ends (--frames, --times or --data say where else)",
        [SPIN_SAMPLED_EVENLY] = "sampled evenly",
        [SPIN_SAMPLED_TIMES] = "sampled at the times of --times",
        [SPIN_SAMPLED_DATA] = "sampled as the data set's frames are"};

    if (r->continuous) {
        printf("time        any from %.10g to %.10g, %s\n", r->range_first, r->range_last,
               how[r->sampling]);
        if (r->sampling == SPIN_SAMPLED_ENDS)
            return;
    }
    printf("frames      %d, numbers %d to %d%s, times %.10g to %.10g\n", r->frames, r->number_first,
           r->number_last, r->numbered ? "" : " (counted)", r->time_first, r->time_last);
}

static void text_splats(size_t least, double mean, size_t most)
{
    if (least == most)
        printf("%zu a frame", most);
    else
        printf("%zu to %zu a frame, mean %.1f", least, most, mean);
}

static void text_columns(const char *what, unsigned held, int sh_degree)
{
    printf("%s", what);
    for (int i = 0; i < N_COLUMNS; i++)
        if (held & columns[i].column)
            printf(" %s", columns[i].name);
    if (sh_degree >= 0)
        printf(" (SH degree %d)", sh_degree);
}

static void report_text(const struct spin_import_report *r)
{
    char path[4096];

    printf("from        %s%s%s\n", r->from, *r->variant ? ", " : "", r->variant);
    if (wants_info) {
        printf("recognised  %s\n", r->recognised);
        printf("upstream    %s\n", r->upstream);
    }
    text_frames(r);
    printf("splats      ");
    text_splats(r->splats_min, r->splats_mean, r->splats_max);
    text_columns("\nattributes ", r->columns, r->sh_degree);
    if (wants_info && r->static_columns)
        text_columns("\nstatic     ", r->static_columns, -1);
    printf("\nbounds      [%g, %g, %g] to [%g, %g, %g]\n", (double)r->bounds_min[0],
           (double)r->bounds_min[1], (double)r->bounds_min[2], (double)r->bounds_max[0],
           (double)r->bounds_max[1], (double)r->bounds_max[2]);
    text_ranges(r);
    for (const char *note = r->notes; *note;) {
        size_t length = strcspn(note, "\n");

        printf("note        %.*s\n", (int)length, note);
        note += length + (note[length] == '\n');
    }
    text_cameras(r);
    if (options.output)
        printf("written     %s\n", spin_print_path(options.output, path));
}

/* A data set's options follow its name: "dynerf:time=unit". */
static const struct spin_importer *find_importer(const char *name)
{
    size_t length = name ? strcspn(name, ":") : 0;

    if (!name)
        return NULL;
    for (const struct spin_importer *const *i = spin_importer_list(); *i; i++)
        if (strlen((*i)->name) == length && !strncmp((*i)->name, name, length))
            return *i;
    return NULL;
}

/* What can be said to be asked wrongly without opening anything. */
static int check(void)
{
    const struct spin_importer *from = find_importer(options.from);
    const struct spin_importer *data_from = find_importer(options.data_from);

    if (!spin_args.word)
        return spin_args_misuse(&command, "INPUT is missing");
    if (wants_info && options.output)
        return spin_args_misuse(&command, "--info writes nothing, but --output was given");
    if (!wants_info && !options.output && !options.check_cameras)
        return spin_args_misuse(&command, "say where to write with --output, or use --info");
    if (options.full && !wants_info)
        return spin_args_misuse(&command, "--full goes with --info: an import reads every frame");
    if (from && !from->open)
        return spin_args_misuse(&command, "'%s' reads data sets: use --data-from", from->name);
    if (options.data_from &&
        (data_from ? !data_from->views : !spin_plugin_fault(options.data_from)))
        return spin_args_misuse(&command, "no data set is called '%s'; --list shows them",
                                options.data_from);
    if (options.n_frames && times.n)
        return spin_args_misuse(&command, "--frames and --times exclude each other");
    return SPIN_EXIT_OK;
}

int main(int argc, char **argv)
{
    struct spin_import_report report = {0};
    int code;

    if (!spin_args_parse(&command, argc, argv, &code))
        return code;
    if (wants_list) {
        if (spin_args.word)
            return spin_args_misuse(&command, "--list takes no INPUT");
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
    options.times = times.doubles;
    options.n_times = times.n;
    options.force = spin_args.force;
    options.plugin_pairs = spin_args.plugin_pairs;
    if (!spin_args_begin(&command, &code))
        return code;
    char *description = NULL;
    spin_status status = SPIN_E_NOT_RECOGNISED;
    if (wants_info && !options.from && !options.check_cameras)
        status = spin_bundle_describe(options.input, spin_args.json, &description);
    if (status == SPIN_E_NOT_RECOGNISED)
        status = spin_import(&options, &report);
    bool speaks = spin_args_ended(&command, status, &code);
    if (speaks && description)
        fputs(description, stdout);
    free(description);
    if (!speaks)
        return code;
    if (description)
        return spin_args_finish(&command, SPIN_EXIT_OK);
    if (spin_args.json)
        report_json(&report);
    else if (wants_info || !spin_args.quiet)
        report_text(&report);
    return spin_args_finish(&command, SPIN_EXIT_OK);
}
