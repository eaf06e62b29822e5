/* gaussianflow: settings from YAML files and options, and malformed files. t-golden.c compares the
 * values.
 * K: gaussianflow import */
#include "tests/importers/edits.h"

#define FROM "gaussianflow"
#define HOOK "chkpnt00501.pth"

static const char *const own[] = {"rescale-value", "1.2", "offset-value", "-0.25", NULL};

static bool opens(const char *path, const char *const *pairs, struct run *run)
{
    bool good = model_open(NULL, path, pairs, run) == SPIN_OK && !strcmp(run->importer->name, FROM);

    if (!good)
        printf("# %s\n", spin_last_error());
    return good;
}

/* A copy of the checkpoint without the YAML file. */
static const char *copy_alone(const char *model)
{
    const char *copy = path_in(new_folder(), HOOK);

    copy_file(path_in(model, HOOK), copy);
    return copy;
}

/* The largest difference of the positions of two runs, each at a time of its own. */
static double differ(struct run *a, double at, struct run *b, double time)
{
    struct spin_splats one = {0}, other = {0};
    double worst = HUGE_VAL;

    if (a->importer->frame(a->self, 0, at, SPIN_COL_MEANS, &one) == SPIN_OK &&
        b->importer->frame(b->self, 0, time, SPIN_COL_MEANS, &other) == SPIN_OK && one.n == other.n)
        worst = 0;
    for (size_t i = 0; worst < HUGE_VAL && i < 3 * one.n; i++)
        worst = larger(worst, fabs((double)one.means[i] - (double)other.means[i]));
    spin_splats_free(&one);
    spin_splats_free(&other);
    return worst;
}

static void test_settings(const char *model, const char *dnerf)
{
    static const char *const half[] = {"offset-value", "0.5", NULL};
    const char *alone = copy_alone(model), *off = copy_of(model);
    struct run run, plain;
    double same;

    ok(opens(dnerf, NULL, &run) && run.sequence.sh_degree == 1 && !run.sequence.half_open &&
           strstr(run.sequence.notes,
                  "rescale_value is 0.7 and offset_value is 0.1, from 'dnerf.yaml'") &&
           strstr(run.sequence.notes, "i/(n-1)") && !strstr(run.sequence.notes, "option"),
       "the only YAML file that fits is read, and SH up to the degree that was drawn");
    run_close(&run);
    ok(opens(model, NULL, &run) && run.sequence.sh_degree == 0 && run.sequence.half_open &&
           strstr(run.sequence.notes, "i/n") &&
           strstr(run.sequence.variant, "20 Gaussians, 4, 1 and 3 orders"),
       "frames of CustomDataset are at i/n");
    run_close(&run);
    golden_as(FROM, alone, own, model, 0, "options instead of a YAML file");
    ok(opens(alone, own, &run) && !strstr(run.sequence.notes, "rescale_value") &&
           strstr(run.sequence.notes, "--frame-times count"),
       "nothing is assumed then, except for the times of frames");
    ok(opens(alone, NULL, &plain) && !plain.sequence.half_open &&
           strstr(plain.sequence.notes, "rescale_value is 1 and offset_value is 0: no YAML"),
       "the method's defaults are assumed, with a note");
    same = differ(&plain, 0.35, &run, 0.5);
    ok(same < 1e-5 && differ(&plain, 0.5, &run, 0.5) > 1e-3, "they are 1 and 0 (%g)", same);
    run_close(&run);
    ok(opens(alone, half, &run) && strstr(run.sequence.notes, "is 1 and offset_value is 0.5: no"),
       "one option leaves the other value to the defaults");
    run_close(&run);
    ok(opens(model, half, &run) &&
           strstr(run.sequence.notes, "1.2 and offset_value is 0.5, from 'custom.yaml' and from"),
       "an option overrides the YAML file");
    same = differ(&plain, 0.8, &run, 0.25);
    ok(same < 1e-5, "as it says (%g)", same);
    run_close(&run);
    edit_file(path_in(off, "custom.yaml"),
              "text rescale_value=>rescale_t: false\n      offset_t: False\n      rescale_value");
    ok(opens(off, NULL, &run) && differ(&plain, 0.3, &run, 0.3) == 0,
       "rescale_t and offset_t turn both values off");
    run_close(&run);
    edit_file(path_in(off, "custom.yaml"), "text rescale_t: false=>x: 0;text offset_t: False=>y: "
                                           "0;text rescale_value=>a;text offset_value=>b");
    ok(opens(off, NULL, &run) && differ(&plain, 0.3, &run, 0.3) == 0 &&
           strstr(run.sequence.notes, "rescale_value is 1 and offset_value is 0, from"),
       "a YAML file without the values leaves both to the defaults");
    run_close(&run);
    run_close(&plain);
    ok(opens(model, NULL, &run) && run.importer->frame(run.self, 0, NAN, SPIN_COL_MEANS,
                                                       &(struct spin_splats){0}) == SPIN_E_USAGE,
       "a time must be finite");
    run_close(&run);
}

static void test_files(const char *model, const char *dnerf)
{
    static const struct lie lies[] = {
        {"custom.yaml", "text 1.2=>ten", "rescale_value is 'ten'", "a word for a number"},
        {"custom.yaml", "text -0.25=>1e999", "offset_value is '1e999'", "an infinite number"},
        {"custom.yaml", "text 1.2=>1.2\n      offset_t: maybe", "offset_t is 'maybe'", "no bool"},
        {"custom.yaml", "text 1.2=>1.2\n      normalize_timestamp: true", "normalize_timestamp",
         "times divided by an unknown number"},
    };
    const char *copy = copy_of(model), *copies = path_in(copy, "project_file");
    const char *yaml = path_in(model, "custom.yaml"), *second = path_in(copies, "second.yml");
    const char *config[] = {"config", yaml, NULL}, *wrong[] = {"config", NULL, NULL};
    static const char *const word[] = {"rescale-value", "x", NULL};
    static const char *const infinite[] = {"offset-value", "1e999", NULL};
    static const char *const vast[] = {"rescale-value", "1e999", NULL};
    struct run run;

    write_text(copies, "no folder");
    if (spin_folder_make(path_in(copy, "a.yaml")) != SPIN_OK)
        exit(1);
    ok(opens(copy, NULL, &run), "neither a folder for a file nor a file for a folder is read");
    run_close(&run);
    remove(copies);
    refuse_lies(NULL, model, NULL, lies, sizeof lies / sizeof *lies);
    if (spin_folder_make(copies) != SPIN_OK)
        exit(1);
    copy_file(yaml, second);
    ok(opens(copy, NULL, &run), "two files that agree");
    run_close(&run);
    edit_file(second, "text 1.2=>x;text GaussianFlowPointCloud=>GaussianPointCloud");
    ok(opens(copy, NULL, &run), "values of another method's file do not matter");
    run_close(&run);
    copy_file(yaml, second);
    edit_file(second, "text 1.2=>1.3");
    model_fails(NULL, copy, NULL, "second.yml", "--config", "two files that differ in the factor");
    ok(opens(copy, config, &run) &&
           strstr(run.sequence.notes, "1.2 and offset_value is -0.25, from 'custom.yaml';"),
       "--config chooses");
    run_close(&run);
    copy_file(yaml, second);
    edit_file(second, "text -0.25=>-0.2");
    model_fails(NULL, copy, NULL, "second.yml", "--config", "two files that differ in the shift");
    copy_file(yaml, second);
    edit_file(second, "text CustomDataset=>DNeRFDataset");
    model_fails(NULL, copy, NULL, "second.yml", "--config", "two files that differ in the times");
    wrong[1] = path_in(dnerf, "project_file/dnerf.yaml");
    model_fails(NULL, model, wrong, "dnerf.yaml", "4, 1 and 3 orders", "a file with other orders");
    wrong[1] = path_in(dnerf, "project_file/other.yaml");
    model_fails(NULL, model, wrong, "other.yaml", "GaussianFlowPointCloud", "another method's");
    wrong[1] = path_in(model, "none.yaml");
    model_fails(NULL, model, wrong, "none.yaml", "--config", "a file that does not exist");
    model_fails(NULL, model, word, NULL, "--rescale-value", "a word for an option");
    model_fails(NULL, model, infinite, NULL, "--offset-value", "an infinite option");
    model_fails(NULL, model, vast, NULL, "--rescale-value", "an infinite factor");
    model_fails(FROM, new_folder(), NULL, NULL, "chkpnt<N>.pth", "a folder without checkpoints");
}

static void load(const char *path, struct pth *pth)
{
    struct spin_torch torch;

    memset(pth, 0, sizeof *pth);
    if (spin_torch_open(path, &torch) != SPIN_OK)
        exit(1);
    pth_load_dict(&torch, spin_value_get(torch.root, "point_cloud"), 0, pth);
    pth->within = "point_cloud";
    spin_torch_close(&torch);
}

static void test_lies(const char *from)
{
    static const char *const names[] = {"position",    "features",   "features_rest", "scaling",
                                        "rotation",    "opacity",    "pos_params",    "rot_params",
                                        "feat_params", "time_center"};
    static const struct {
        const char *put;
        int n_dims;
        uint64_t shape[4];
        const char *word, *what;
    } lies[] = {
        {"position", 2, {19, 3}, "pos_params", "a row too few"},
        {"position", 2, {0, 3}, "0 Gaussians", "no rows"},
        {"position", 2, {20, 4}, "position", "four coordinates"},
        {"features", 3, {20, 2, 3}, "features", "two coefficients of degree 0"},
        {"features_rest", 3, {20, 4, 3}, "4 coefficients", "SH of no degree"},
        {"features_rest", 3, {20, 24, 3}, "24 coefficients", "SH of degree 4"},
        {"features_rest", 2, {20, 9}, "features_rest", "SH of two dimensions"},
        {"scaling", 2, {20, 1}, "scaling", "one scale"},
        {"rotation", 2, {20, 16}, "rotation", "quaternions with their series"},
        {"opacity", 1, {20}, "opacity", "opacities of one dimension"},
        {"pos_params", 4, {20, 0, 3, 3}, "0 orders", "no orders"},
        {"rot_params", 4, {20, 65, 4, 3}, "65 orders", "too many orders"},
        {"feat_params", 4, {20, 3, 3, 2}, "feat_params", "a Fourier series without powers"},
        {"time_center", 2, {21, 1}, "time_center", "a row too many"},
        {"velocity", 2, {20, 3}, "velocity", "an attribute of another method"},
    };
    const char *path = path_in(new_folder(), "chkpnt1.pth");
    struct run run;
    struct pth pth;

    for (size_t i = 0; i < sizeof lies / sizeof *lies; i++) {
        load(from, &pth);
        pth_put(&pth, lies[i].put, lies[i].n_dims, lies[i].shape);
        pth_save(&pth, path);
        model_fails(FROM, path, NULL, "chkpnt1.pth", lies[i].word, lies[i].what);
        pth_free(&pth);
    }
    for (size_t i = 0; i < sizeof names / sizeof *names; i++) {
        load(from, &pth);
        pth_drop(&pth, names[i]);
        pth_save(&pth, path);
        model_fails(FROM, path, NULL, "chkpnt1.pth", names[i], names[i]);
        pth_free(&pth);
        load(from, &pth);
        if (pth_find(&pth, names[i])->count > 0) {
            pth_find(&pth, names[i])->values[1] = NAN;
            pth_save(&pth, path);
            model_fails(FROM, path, NULL, names[i], "not finite", "a value that is not finite");
        }
        pth_free(&pth);
    }
    load(from, &pth);
    pth_put(&pth, "features_rest", 3, (uint64_t[3]){20, 15, 3});
    memset(pth_put(&pth, "rotation", 2, (uint64_t[2]){20, 4})->values, 0, 80 * sizeof(float));
    memset(pth_put(&pth, "rot_params", 4, (uint64_t[4]){20, 1, 4, 3})->values, 0,
           240 * sizeof(float));
    pth_save(&pth, path);
    ok(opens(path, own, &run) && run.sequence.sh_degree == 3 && read_all(NULL, path) == SPIN_OK,
       "quaternions of zeros are not divided by zero; without sh_degree, all SH are read");
    run_close(&run);
    for (int i = 0; i < pth.n; i++) {
        char name[50];

        snprintf(name, sizeof name, "%s", pth.tensor[i].name);
        snprintf(pth.tensor[i].name, sizeof pth.tensor[i].name, "point_cloud.%s", name);
    }
    pth.within = "model";
    pth_put(&pth, "camera.velocity", 1, (uint64_t[1]){4});
    pth_save(&pth, path);
    ok(opens(path, own, &run), "other parts of the model are not read");
    run_close(&run);
    pth.zero = "sh_degree";
    pth_save(&pth, path);
    ok(opens(path, own, &run) && run.sequence.sh_degree == 0, "SH that were not drawn are dropped");
    run_close(&run);
    pth_put(&pth, "point_cloud.velocity", 1, (uint64_t[1]){4});
    pth_save(&pth, path);
    model_fails(FROM, path, NULL, "chkpnt1.pth", "'point_cloud.velocity'", "unlike its attributes");
    pth_drop(&pth, "point_cloud.velocity");
    pth_drop(&pth, "point_cloud.opacity");
    pth_save(&pth, path);
    model_fails(FROM, path, NULL, "chkpnt1.pth", "'point_cloud.opacity'", "a part that lacks");
    pth.within = "cloud";
    pth_save(&pth, path);
    model_fails(FROM, path, NULL, "chkpnt1.pth", "'point_cloud'", "another dict");
    pth_free(&pth);
    ok(read_truncations(FROM, from) == 0, "no truncation can be read");
    survive_flips(FROM, from);
}

TAP_MAIN
{
    const char *model = check_fixture("gaussianflow/custom_hook");
    const char *dnerf = check_fixture("gaussianflow/dnerf_like");

    spin_log_set_level(-2);
    if (!model || !dnerf) {
        skip("gaussianflow fixtures", "there are none here");
        return;
    }
    test_settings(model, dnerf);
    test_files(model, dnerf);
    test_lies(path_in(model, HOOK));
}
