/* The altered runs of fixtures, whose manifests list the expected result of each: an error of
 * one line that names the file, or the splats of the unaltered run, except for a few rows.
 * TAP_PART is a folder of fixtures.
 * K: variants import malformed freetimegspp scgs shapeofmotion stglite usd gifstream */
#include "tests/importers/models.h"

#define MOST_ALTERED 4 /* rows that an alteration may change or drop */

static const struct altered {
    const char *fixtures, *importer, *base; /* below <fixtures>/variants; NULL: the cases are in
                                              <fixtures>, and none is compared */
} altered[] = {
    {"freetimegspp", "freetimegspp", "base"},
    {"scgs", "scgs", "base/model"},
    {"shapeofmotion", "shapeofmotion", "base/checkpoints/last.ckpt"},
    {"4dgs/more_variants", "4dgs", NULL},
    {"4dgs/conformance", "4dgs", NULL},
    {"stglite", "stglite", "base/scene.ply"},
    {"usd", "usd", "base.usdc"},
    {"gifstream", "gifstream", "base"},
};

struct slice {
    struct spin_splats s;
    struct run run;
};

static bool same(const float *a, const float *b, size_t n, double tolerance)
{
    for (size_t i = 0; i < n; i++)
        if (!(fabs((double)a[i] - (double)b[i]) <= tolerance * (1 + fabs((double)b[i]))))
            return false;
    return true;
}

static bool same_row(const struct spin_splats *a, size_t i, const struct spin_splats *b, size_t k,
                     double tolerance)
{
    return same(a->means + 3 * i, b->means + 3 * k, 3, tolerance) &&
           same(a->quats + 4 * i, b->quats + 4 * k, 4, tolerance) &&
           same(a->log_scales + 3 * i, b->log_scales + 3 * k, 3, tolerance) &&
           same(a->logit_opacities + i, b->logit_opacities + k, 1, 10 * tolerance) &&
           same(a->sh + 3 * i * (size_t)((a->sh_degree + 1) * (a->sh_degree + 1)),
                b->sh + 3 * k * (size_t)((b->sh_degree + 1) * (b->sh_degree + 1)), 3, tolerance);
}

/* The number of rows of either slice that the other lacks, in order. */
static size_t n_differ(const struct spin_splats *a, const struct spin_splats *b, double tolerance)
{
    size_t i = 0, k = 0, n = 0;

    while (i < a->n && k < b->n) {
        if (same_row(a, i, b, k, tolerance)) {
            i++;
            k++;
        } else if (k + 1 < b->n && same_row(a, i, b, k + 1, tolerance)) {
            k++;
            n++;
        } else {
            k += b->n - k >= a->n - i;
            i++;
            n++;
        }
    }
    return n + (a->n - i) + (b->n - k);
}

static spin_status read_slice(struct slice *slice, double time)
{
    return slice->run.importer->frame(slice->run.self, (int)time, time,
                                      SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES, &slice->s);
}

/* Compares the run opened in `one` with the unaltered one. */
static bool is_like_base(struct slice *one, struct slice *base, const spin_json *times,
                         double tolerance)
{
    for (size_t i = 0; i < spin_json_length(times); i++) {
        double time = 0;
        size_t n;

        spin_json_number(spin_json_at(times, i), &time);
        if (read_slice(one, time) != SPIN_OK || read_slice(base, time) != SPIN_OK) {
            printf("#   at %g: %s\n", time, spin_last_error());
            return false;
        }
        n = n_differ(&one->s, &base->s, tolerance);
        if (n > MOST_ALTERED) {
            printf("#   at %g: %zu rows differ\n", time, n);
            return false;
        }
    }
    return true;
}

/* An error is one line with the path of a file of the input. */
static bool is_good_error(const char *path)
{
    const char *said = spin_last_error();
    bool good = strstr(said, path) && !strchr(said, '\n');

    printf("# %s\n", said);
    return good;
}

/* Animated objects and scenes without splats are not read. */
static bool is_read(const char *name) { return !strstr(name, "Object") && !strstr(name, "NoData"); }

static void check_case(const struct altered *a, const spin_json *one, const spin_json *manifest,
                       struct slice *base)
{
    const spin_json *file = spin_json_get(one, "file");
    const char *name = spin_json_string(file ? file : spin_json_get(one, "folder"));
    const char *expect = spin_json_string(spin_json_get(one, "expect"));
    const char *why = spin_json_string(spin_json_get(one, "why")), *within = strstr(why, "within ");
    const char *root = check_fixture(a->fixtures);
    const char *path = path_in(a->base ? path_in(root, "variants") : root, name);
    double tolerance = within ? atof(within + 7) : 1e-6;
    struct slice now = {0};
    spin_status status = run_open(NULL, path, &now.run);
    bool good, names;

    if (status != SPIN_OK)
        status = run_open(a->importer, path, &now.run);
    names = status == SPIN_OK || is_good_error(path);
    if (strcmp(expect, "error") == 0)
        good = status != SPIN_OK;
    else if (status != SPIN_OK)
        good = strncmp(expect, "load", 5) != 0 || expect[4] != '\0';
    else
        good = strcmp(expect, "load") != 0 || !a->base ||
               is_like_base(&now, base, spin_json_get(manifest, "times"), tolerance);
    if (status == SPIN_OK && strcmp(now.run.importer->name, a->importer) != 0)
        good = false;
    ok(good && names, "%s/%s: %s: %s", a->fixtures, name, expect, why);
    if (!good)
        printf("#   %s\n", status == SPIN_OK ? "it opens" : spin_last_error());
    run_close(&now.run);
    spin_splats_free(&now.s);
}

static void check_variants(const struct altered *a)
{
    const char *root = check_fixture(a->fixtures);
    const char *folder = root && a->base ? path_in(root, "variants") : root;
    struct slice base = {0};
    const spin_json *cases;
    spin_json *manifest;

    if (!folder || !spin_path_exists(folder)) {
        skip(a->fixtures, "no altered runs");
        return;
    }
    manifest = load_manifest(folder);
    cases = spin_json_get(manifest, "cases");
    if (!a->base || ok(run_open(NULL, path_in(folder, a->base), &base.run) == SPIN_OK,
                       "%s/%s opens", a->fixtures, a->base))
        for (size_t i = 0; i < spin_json_length(cases); i++) {
            const char *file = spin_json_string(spin_json_get(spin_json_at(cases, i), "file"));

            if (!file || is_read(file))
                check_case(a, spin_json_at(cases, i), manifest, &base);
        }
    else
        printf("#   %s\n", spin_last_error());
    run_close(&base.run);
    spin_splats_free(&base.s);
    spin_json_free(manifest);
}

TAP_MAIN
{
    const char *part = getenv("TAP_PART");

    spin_log_set_level(-2);
    for (size_t i = 0; i < sizeof altered / sizeof *altered; i++)
        if (!part || strcmp(part, altered[i].fixtures) == 0)
            check_variants(&altered[i]);
}
