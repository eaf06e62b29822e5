/* Defaults of a retraining by preset, limits of each option, and the settings that a bundle
 * stores. defaults.json repeats every value, so that any change is noticed.
 * K: retrain defaults presets limits */

#include "train/options.h"
#include "io/file.h"
#include "spin_run.h"
#include "run/run.h"
#include "tests/tap.h"

/* ---- Golden values ------------------------------------------------------------------------------
 */

enum kind { FLAG, SWITCH, INT, GRID, ENUM, UINT64, DOUBLE, COLOUR };
static const size_t width[] = {1, 1, 4, 4, 4, 8, 8, 4}; /* bytes of one value */

static const struct row {
    const char *field;
    size_t offset, size;
    enum kind kind;
} rows[] = {
#define HEADING(text)
#define OPTION(kind, field, ...)                                                                   \
    {#field, offsetof(struct spin_retrain_options, field),                                         \
     sizeof((struct spin_retrain_options *)NULL)->field, kind},
#include "train/options.def"
};
static const size_t n_rows = sizeof rows / sizeof *rows;

static double number(const struct row *row, const char *options, size_t i)
{
    const void *at = options + row->offset + i * width[row->kind];

    switch (row->kind) {
    case FLAG:
    case SWITCH:
        return *(const bool *)at;
    case UINT64:
        return (double)*(const uint64_t *)at;
    case DOUBLE:
        return *(const double *)at;
    case COLOUR:
        return *(const float *)at;
    default:
        return *(const int *)at;
    }
}

static const char *const presets[] = {"quick", "best", "paper", "short"};
static struct spin_retrain_options of_preset[4], o;

/* The values of every option, preset after preset. */
static void print_rows(FILE *to)
{
    for (const struct row *row = rows; row < rows + n_rows; row++) {
        size_t n = row->size / width[row->kind];

        fprintf(to, " \"%s\": [", row->field);
        for (size_t k = 0; k < 4 * n; k++)
            fprintf(to, k ? ", %.10g" : "%.10g", number(row, (char *)&of_preset[k / n], k % n));
        fprintf(to, "],\n");
    }
}

static void print_json(FILE *to, const char *name, enum spin_options_of of, const char *end)
{
    spin_json *j = spin_options_to_json(&o, of);
    char *text = spin_json_text(j, false);

    fprintf(to, " \"%s\": %s%s\n", name, text, end);
    free(text);
    spin_json_free(j);
}

/* An option that affects the result but is missing from the JSON would count as unchanged on
 * resume. */
static void print_stored(FILE *to)
{
    o = of_preset[2];
    print_json(to, "network", SPIN_OPTIONS_OF_NETWORK, ",");
    print_json(to, "refinement", SPIN_OPTIONS_OF_REFINEMENT, ",");
    o.dynamic_weight = 2;
    o.antialias = true;
    o.learn_exposure = SPIN_EXPOSURE_ON;
    o.learn_alpha = true;
    o.sh_increase_every = 5;
    o.tracks = true;
    o.backdrop = SPIN_BACKDROP_ON;
    o.max_points = 7;
    o.refine_start = SPIN_REFINE_FROM_SOURCE;
    o.densify = false;
    o.residual = SPIN_RESIDUAL_SOURCE;
    o.seed = 9007199254740991;
    print_json(to, "changed network", SPIN_OPTIONS_OF_NETWORK, ",");
    print_json(to, "changed refinement", SPIN_OPTIONS_OF_REFINEMENT, "");
}

static void test_golden(void)
{
    struct spin_map want;
    char *text = NULL;
    size_t n = 0;
    FILE *to = open_memstream(&text, &n);

    fprintf(to, "{\n");
    print_rows(to);
    print_stored(to);
    fprintf(to, "}\n");
    fclose(to);
    if (ok(spin_map_open("tests/train/defaults.json", &want) == SPIN_OK, "opens defaults.json")) {
        ok(want.size == n && memcmp(want.data, text, n) == 0, "values are those of defaults.json");
        if (want.size != n || memcmp(want.data, text, n) != 0)
            printf("# they are now:\n%s", text);
        spin_map_close(&want);
    }
    free(text);
}

/* Fields that are not in the table are cleared, except for two. */
static void test_other_fields(struct spin_retrain_options preset, const char *name)
{
    const char *bytes = (const char *)&preset;
    size_t i = 0;

    is_text(preset.device, "auto", "device");
    is_text(preset.preset, name, "preset");
    preset.device = preset.preset = NULL;
    for (const struct row *row = rows; row < rows + n_rows; row++)
        memset((char *)&preset + row->offset, 0, row->size);
    while (i < sizeof preset && bytes[i] == 0)
        i++;
    ok(i == sizeof preset, "%s: all other fields are 0 (byte %zu)", name, i);
}

static void test_presets(void)
{
    for (int p = 0; p < 4; p++) {
        memset(&of_preset[p], 0xff, sizeof *of_preset);
        ok(spin_retrain_preset(presets[p], &of_preset[p]) == SPIN_OK, "preset '%s'", presets[p]);
        test_other_fields(of_preset[p], presets[p]);
    }
    memset(&o, 0xff, sizeof o);
    spin_retrain_defaults(&o);
    ok(memcmp(&o, &of_preset[0], sizeof o) == 0, "the defaults are those of 'quick'");
    ok(spin_retrain_preset("no such", &o) == SPIN_E_USAGE, "there is no other preset");
}

/* ---- Limits of the library call -----------------------------------------------------------------
 */

/* The input does not exist, which is found after the options were checked. */
static void is_refused(bool want, const char *field)
{
    struct spin_retrain_report report;
    spin_status status = spin_train(&o, &report);
    char name[40];

    snprintf(name, sizeof name, "%.*s", (int)strcspn(field, "["), field);
    if (want)
        ok(status == SPIN_E_USAGE && strstr(spin_last_error(), name), "%s is refused: %s", field,
           spin_last_error());
    else
        ok(status != SPIN_OK && status != SPIN_E_USAGE, "%s is allowed: %s", field,
           spin_last_error());
    spin_retrain_preset("paper", &o);
    o.input = "nowhere/in.spin";
    o.output = "nowhere/out.spin";
}

/* One value at the limit, one beyond it. */
#define LIMIT(field, on, beyond)                                                                   \
    do {                                                                                           \
        o.field = on;                                                                              \
        is_refused(false, #field);                                                                 \
        o.field = beyond;                                                                          \
        is_refused(true, #field);                                                                  \
    } while (0)

static void test_limits(void)
{
    spin_retrain_preset("paper", &o);
    is_refused(true, "input");
    LIMIT(image_scale, 0.01, 0.009);
    LIMIT(image_scale, 1, NAN);
    LIMIT(background[2], 1, 1.01f);
    LIMIT(iterations, 1, 0);
    LIMIT(iterations, -1, -2);
    LIMIT(iterations, -3, -4);
    LIMIT(densify_every, -1, -2);
    LIMIT(track_iterations, -1, 0);
    LIMIT(batch, 1024, 1025);
    LIMIT(views_per_frame, 3, 4);
    LIMIT(views_per_frame, 1, 0);
    LIMIT(lambda_dssim, 1, 1.01);
    LIMIT(dynamic_weight, 1e-3, 0);
    LIMIT(warmup, 0, -2);
    LIMIT(lr_table, 0, -1e-3);
    LIMIT(lr_sh, 1, 2);
    LIMIT(lr_scale, 1, NAN);
    LIMIT(lr_rotation, 1, 2);
    LIMIT(lr_opacity, 1, 2);
    LIMIT(lr_position, 0, INFINITY);
    LIMIT(lr_head_factor, 1000, 1001);
    LIMIT(sh_increase_every, 0, -1);
    LIMIT(learn_exposure, SPIN_EXPOSURE_AUTO, SPIN_EXPOSURE_AUTO + 1);
    LIMIT(backdrop, SPIN_BACKDROP_AUTO, SPIN_BACKDROP_AUTO + 1);
    LIMIT(lr_exposure, 1, 2);
    LIMIT(eval_every, 0, -1);
    LIMIT(save_every, 0, -1);
    LIMIT(method, SPIN_METHOD_NETWORK, SPIN_METHOD_4D + 1);
    LIMIT(lr_track, 0, -1);
    LIMIT(average, 1, 2);
    LIMIT(lr_tracked, 1000, 1001);
    LIMIT(lr_displacement, 1, 2);
    LIMIT(densify_threshold, 1, 2);
    LIMIT(densify_until, 1, 1.5);
    LIMIT(refine, 0, -1);
    LIMIT(refine_start, SPIN_REFINE_FROM_SOURCE, SPIN_REFINE_FROM_SOURCE + 1);
    LIMIT(max_points, 0, -1);
    LIMIT(levels, 32, 33);
    LIMIT(features, 8, 0);
    LIMIT(hash_log2, 4, 27);
    LIMIT(hidden, 256, 0);
    LIMIT(sh_degree, 0, 4);
    LIMIT(finest_resolution[0], 65536, 65537);
    LIMIT(normalise, SPIN_NORMALISE_NONE, SPIN_NORMALISE_NONE + 1);
    LIMIT(residual, SPIN_RESIDUAL_SOURCE, SPIN_RESIDUAL_SOURCE + 1);
    LIMIT(lr_residual, 0, 1001);
    o.method = SPIN_METHOD_FRAMES;
    is_refused(true, "--refine");
    o.method = SPIN_METHOD_TRACKS;
    is_refused(true, "--tracks auto");
    o.method = SPIN_METHOD_TRACKS;
    o.tracks = true;
    is_refused(false, "tracks");
    o.method = SPIN_METHOD_TRACKS;
    o.tracks = true;
    o.refine = 1;
    is_refused(true, "does not support --refine");
}

/* ---- Numbers that follow from the clip ---------------------------------------------------------
 */

static void resolves(const char *preset, int n_frames, int most, int iterations, int densify_every)
{
    spin_retrain_preset(preset, &o);
    spin_options_resolve(&o, n_frames, most);
    ok(o.iterations == iterations && o.densify_every == densify_every,
       "%s, %d frames: %d iterations, densified every %d", preset, n_frames, o.iterations,
       o.densify_every);
}

static void test_resolve(void)
{
    resolves("quick", 1, 1000000000, 1600, 80);
    resolves("quick", 18, 1000000000, 3300, 165);
    resolves("quick", 150, 1000000000, 16500, 250);
    resolves("best", 18, 1000000000, 9900, 250);
    resolves("best", 100000000, 1000000000, 1000000000, 250);
    resolves("paper", 18, 1000000000, 40000, 0);
    resolves("short", 18, 1000000000, 1500, 0);
    resolves("quick", 18, 1000, 1000, 50);
    resolves("best", 18, 1000, 1000, 50);
    resolves("paper", 18, 1000, 40000, 0);
    ok(spin_options_most_iterations(30 * 4, 4) == 1000, "four cameras: the least");
    ok(spin_options_most_iterations(30 * 12, 12) == 4320, "twelve: 12 for each image");
    ok(spin_options_most_iterations(1000000, 1000000) == 1000000000, "a limit without overflow");
    spin_retrain_defaults(&o);
    o.iterations = 600;
    spin_options_resolve(&o, 18, 1000000000);
    ok(o.iterations == 600 && o.densify_every == 30,
       "given iterations stay; they are densified by them");
    spin_retrain_defaults(&o);
    o.densify_every = 0;
    spin_options_resolve(&o, 18, 1000000000);
    ok(o.iterations == 3300 && o.densify_every == 0, "a given rhythm stays");
    ok(o.track_iterations == 3300, "tracks learn in all of 3300 iterations");
    spin_retrain_defaults(&o);
    spin_options_resolve(&o, 150, 1000000000);
    ok(o.track_iterations == 5000, "in the first 5000 of 16500");
    o.track_iterations = 20000;
    spin_options_resolve(&o, 150, 1000000000);
    ok(o.track_iterations == 16500, "and never in more than there are");
}

TAP_MAIN
{
    test_presets();
    test_golden();
    test_limits();
    test_resolve();
}
