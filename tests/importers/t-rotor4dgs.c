/* rotor4dgs: every fixture at every time against the method's own numbers, what is left out, and
 * files that lie.
 * K: rotor4dgs import */
#include "tests/importers/slices.h"

#define FROM "rotor4dgs"

/* Rows that a rule keeps: the mask alone, and opacity or weight above a bound. */
static size_t kept_rows(const struct table *mask, const struct table *value, double least,
                        size_t block, size_t *row)
{
    size_t n = 0;

    for (size_t i = 0; i < mask->n_rows; i++) {
        size_t at = block * mask->n_rows + i;

        if (mask->value[at] != 0 && value->value[at] >= least)
            row[n++] = i;
    }
    return n;
}

struct tables {
    struct table mask, mean, cov, weight, opacity, dc, times, rgb, eye;
};

static void compare_time(struct run *run, const struct tables *t, size_t index, const char *rule,
                         const char *name)
{
    const struct table *by = strcmp(rule, "time") == 0 ? &t->weight : &t->opacity;
    double least = strcmp(rule, "none") == 0 ? 0 : strcmp(rule, "time") == 0 ? 0.05 : 1.0 / 255;
    size_t *row = malloc(t->mask.n_rows * sizeof *row);
    size_t n = kept_rows(&t->mask, by, least, index, row);
    struct spin_splats s = {0};
    char what[200];

    snprintf(what, sizeof what, "%s at %g, cull %s", name, t->times.value[index], rule);
    if (run->importer->frame(run->self, 0, t->times.value[index], run->sequence.columns, &s) !=
        SPIN_OK) {
        ok(0, "%s: %s", what, spin_last_error());
    } else if (ok(s.n == n, "%s: %zu Gaussians are seen", what, n)) {
        compare_rows(&t->mean, index, row, n, s.means, 3, bound("mean").abs, bound("mean").rel,
                     what);
        compare_covariances(&t->cov, 0, row, &s, what);
        compare_opacities(&t->opacity, index, row, &s, bound("opacity").abs, what);
        compare_rows(&t->dc, 0, row, n, s.sh, 48, 0, 0, what);
        compare_colours(&t->rgb, &t->eye, index, row, &s, bound("rgb").abs, what);
        check_sane(&s, run->sequence.columns, what);
    }
    spin_splats_free(&s);
    free(row);
}

static void compare_fixture(const char *folder, const char *name)
{
    static const char *const rules[] = {"none", "opacity", "time"};
    struct tables t;
    struct spin_npz npz;
    struct run run;

    bounds_of = folder;
    if (spin_npz_open(path_in(folder, "expected.npz"), &npz) != SPIN_OK) {
        ok(0, "%s: %s", name, spin_last_error());
        return;
    }
    t = (struct tables){
        table_load(&npz, "mask", 1),    table_load(&npz, "mean", 1),
        table_load(&npz, "cov6", 1),    table_load(&npz, "marginal", 1),
        table_load(&npz, "opacity", 1), table_load(&npz, "raw_features_dc", 0),
        table_load(&npz, "times", 0),   table_load(&npz, "rgb_dir_from_sliced_mean", 1),
        table_load(&npz, "campos", 0)};
    for (int r = 0; r < 3; r++) {
        const char *pairs[] = {"cull", rules[r], NULL};

        if (!ok(open_with(r ? FROM : NULL, folder, pairs, &run) == SPIN_OK &&
                    !strcmp(run.importer->name, FROM) && run.sequence.continuous &&
                    run.sequence.sh_degree == 3,
                "%s: the folder is recognised and opens", name)) {
            printf("#   %s\n", spin_last_error());
            continue;
        }
        ok(strstr(run.sequence.notes, "own times run") != NULL && !strstr(run.sequence.notes, "moves"),
           "%s: the range of times is a guess, and the notes say so", name);
        for (size_t i = 0; i < t.times.n_rows; i++)
            compare_time(&run, &t, i, rules[r], name);
        run_close(&run);
    }
    free(t.mask.value);
    free(t.mean.value);
    free(t.cov.value);
    free(t.weight.value);
    free(t.opacity.value);
    free(t.dc.value);
    free(t.times.value);
    free(t.rgb.value);
    free(t.eye.value);
    spin_npz_close(&npz);
}

static void test_options(const char *root)
{
    const char *path = path_in(root, "old_names"), *folder, *file;
    const char *range[] = {"time-range", "0,5", NULL}, *odd[] = {"time-range", "x", NULL};
    const char *cull[] = {"cull", "some", NULL};
    struct spin_map map;
    FILE *out;
    struct run run;

    ok(open_with(FROM, path, range, &run) == SPIN_OK && run.sequence.time_first == 0 &&
           run.sequence.time_last == 5 && !strstr(run.sequence.notes, "own times run"),
       "the range of times may be given");
    ok(strstr(run.sequence.variant, "step 2000") != NULL, "the step inside is told");
    run_close(&run);
    fails_with(FROM, path, odd, "expected A,B", "a range that is none");
    fails_with(FROM, path, cull, "expected opacity, time or none", "a rule that is none");

    folder = new_folder();
    spin_folder_make(path_in(folder, "nerfstudio_models"));
    file = path_in(folder, "nerfstudio_models/step-000002000.ckpt");
    if (spin_map_open(path_in(path, "nerfstudio_models/step-000002000.ckpt"), &map) != SPIN_OK ||
        !(out = fopen(file, "wb")))
        exit(1);
    fwrite(map.data, 1, map.size, out);
    fclose(out);
    spin_map_close(&map);
    out = fopen(path_in(folder, "dataparser_transforms.json"), "w");
    fputs("{\"transform\": [[1,0,0,0.5],[0,1,0,0],[0,0,1,0]], \"scale\": 1.0}", out);
    fclose(out);
    ok(run_open(NULL, folder, &run) == SPIN_OK && strstr(run.sequence.notes, "moves and scales"),
       "a data parser's transform is noted");
    run_close(&run);
    ok(run_open(NULL, file, &run) == SPIN_OK && !strcmp(run.importer->name, FROM),
       "the file alone is recognised");
    run_close(&run);
    ok(read_truncations(FROM, file) == 0, "no truncation of a checkpoint can be read");
    survive_flips(FROM, file);
}

static void test_refused(void)
{
    const char *other = check_fixture("realtime4dgs/dim3_static/chkpnt7000.pth");

    fails(FROM, new_folder(), "holds no step-<N>.ckpt", "a folder without checkpoints");
    fails(FROM, "no/such.ckpt", "no/such.ckpt", "a missing file");
    if (other)
        fails(FROM, other, "no dict 'pipeline'", "a checkpoint of another method");
}

TAP_MAIN
{
    const char **names = check_cases("rotor4dgs", "expected.npz");
    const char *root = check_fixture("rotor4dgs");

    spin_log_set_level(-2);
    test_refused();
    if (!root) {
        skip("rotor4dgs fixtures", "there are none here");
        return;
    }
    for (size_t i = 0; names[i]; i++)
        compare_fixture(path_in(root, names[i]), names[i]);
    free(names);
    test_options(root);
}
