/* ed3dgs: the effect of a run's iteration and options, other shapes of the same network, and
 * malformed files.
 * K: ed3dgs import threads */
#include "tests/importers/edits.h"

#define FROM "ed3dgs"
#define SAVE "point_cloud/*"
#define CLOUD SAVE "/point_cloud.ply"
#define NETWORK SAVE "/deformation.pth"
#define DEGREE_2 "drop f_rest_ 24 44"

/* A model with one option changed. */
static const char *make_with(const char *model, const char *word, const char *by)
{
    const char *copy = copy_of(model);

    replace_text(path_in(copy, "cfg_args"), word, by);
    return copy;
}

static void read_at(const char *path, double time, struct spin_splats *out, unsigned *still)
{
    struct run run;

    if (model_open(FROM, path, NULL, &run) != SPIN_OK ||
        run.importer->frame(run.self, 0, time, run.sequence.columns, out) != SPIN_OK) {
        printf("# %s\n", spin_last_error());
        exit(1);
    }
    if (still)
        *still = run.sequence.static_columns;
    run_close(&run);
}

static void same(const struct spin_splats *a, const struct spin_splats *b, double abs,
                 const char *what)
{
    const struct {
        const float *a, *b;
        size_t width;
    } part[] = {{a->means, b->means, 3},
                {a->quats, b->quats, 4},
                {a->log_scales, b->log_scales, 3},
                {a->logit_opacities, b->logit_opacities, 1},
                {a->sh, b->sh, 48}};
    double worst = a->n == b->n ? 0 : INFINITY;

    for (size_t i = 0; i < 5 && a->n == b->n; i++) {
        for (size_t k = 0; k < part[i].width * a->n; k++) {
            double error = fabs((double)part[i].a[k] - part[i].b[k]);

            worst = error <= worst ? worst : error; /* NaN stays */
        }
    }
    near(worst, 0, abs, what);
}

static void test_same(const char *one, const char *other, const char *what)
{
    struct spin_splats a = {0}, b = {0};

    read_at(one, 0.37, &a, NULL);
    read_at(other, 0.37, &b, NULL);
    same(&a, &b, 0, what);
    spin_splats_free(&a);
    spin_splats_free(&b);
}

/* The number in the folder's name is part of the model. */
static void test_iteration(const char *fixture)
{
    const char *model = path_in(fixture, "model");
    const char *early = copy_of(model), *named = copy_of(model),
               *save = path_in(early, "point_cloud");
    const char *cfg;
    const char *number[] = {"iteration", "5400", NULL}, *other[] = {"iteration", "5300", NULL};
    const char *settings[] = {"iteration", "5400", "cfg-args", NULL, NULL};
    struct spin_splats a = {0};
    struct cloud cloud;
    const float *scale, *x;
    double worst = 0, moved = 0;

    if (rename(golden_path(early, SAVE), path_in(save, "iteration_4000")) != 0 ||
        rename(golden_path(named, SAVE), path_in(named, "point_cloud/last")) != 0)
        exit(1);
    cloud_load(golden_path(model, CLOUD), &cloud);
    read_at(early, 0.5, &a, NULL);
    scale = cloud_find(&cloud, "scale_1");
    x = cloud_find(&cloud, "x");
    for (size_t i = 0; i < a.n; i++) {
        worst = larger(worst, fabs((double)a.log_scales[3 * i + 1] - scale[i]));
        moved = larger(moved, fabs((double)a.means[3 * i] - x[i]));
    }
    ok(worst == 0 && moved > 0.01, "before deform_from_iter only positions and rotations move");
    spin_splats_free(&a);
    cloud_free(&cloud);

    save = path_in(named, "point_cloud/last");
    model_fails(FROM, save, NULL, "last", "--iteration", "a save without its number");
    golden_as(FROM, save, number, fixture, 0, "the number by --iteration");
    model_fails(FROM, golden_path(model, SAVE), other, "5300", "iteration_5400",
                "--iteration of another save than the one given");
    model_fails(FROM, model, other, "model", "iteration_5300", "a save that is not there");
    cfg = path_in(new_folder(), "kept");
    copy_file(path_in(named, "cfg_args"), cfg);
    unlink(path_in(named, "cfg_args"));
    model_fails(FROM, save, number, "last", "--cfg-args", "no cfg_args");
    settings[3] = cfg;
    golden_as(FROM, save, settings, fixture, 0, "settings by --cfg-args");
}

/* The rows of the table that are used, shown by equivalent options. */
static void test_rows(const char *model)
{
    const char *late = make_with(model, "c2f_temporal_iter=10000", "c2f_temporal_iter=5400");
    const char *whole =
        make_with(model, "no_c2f_temporal_embedding=False", "no_c2f_temporal_embedding=True");
    const char *both = make_with(model, "use_coarse_temporal_embedding=True",
                                 "use_coarse_temporal_embedding=False");
    const char *few = make_with(model, "min_embeddings=6", "min_embeddings=18"), *one;
    struct spin_splats a = {0}, b = {0};

    test_same(late, whole, "the whole table from c2f_temporal_iter on");
    replace_text(path_in(whole, "cfg_args"), "min_embeddings=6", "min_embeddings=30");
    replace_text(path_in(both, "cfg_args"), "no_c2f_temporal_embedding=False",
                 "no_c2f_temporal_embedding=True");
    test_same(both, whole, "the coarse stage with as many rows as the fine one");
    replace_text(path_in(few, "cfg_args"), "c2f_temporal_iter=10000", "c2f_temporal_iter=1e12");
    both = make_with(model, "use_coarse_temporal_embedding=True",
                     "use_coarse_temporal_embedding=False");
    read_at(few, 0.37, &a, NULL);  /* coarse 18, fine 18 */
    read_at(both, 0.37, &b, NULL); /* 6 + 24 * 0.54 = 18.96, both */
    same(&a, &b, 0, "rows grow with the iteration and are cut to a whole number");
    one = make_with(model, "min_embeddings=6", "min_embeddings=1");
    read_at(one, 0.2, &a, NULL);
    ok(a.n > 0, "one row is enough");
    spin_splats_free(&a);
    spin_splats_free(&b);
}

/* Times are shifted by the nonzero offsets, and reflected at 0 and at 1. */
static void test_times(const char *fixture)
{
    const char *model = path_in(fixture, "model"), *still;
    struct spin_splats a = {0}, b = {0};
    struct pth_tensor *offsets;
    struct pth pth;
    double shift = 0, n = 0;
    struct run run;

    pth_load(golden_path(model, NETWORK), &pth);
    offsets = pth_find(&pth, "offsets");
    for (uint64_t i = 0; i < offsets->count; i++) {
        shift += offsets->values[i];
        n += offsets->values[i] != 0;
    }
    shift /= n;
    still = edited(model, NETWORK, "set offsets * 0");
    golden_as(FROM, still, NULL, fixture, shift, "without offsets, at times shifted by them");
    pth_free(&pth);
    read_at(model, 0.1 - shift, &a, NULL);
    read_at(model, -0.1 - shift, &b, NULL);
    same(&a, &b, 1e-5, "time is reflected at 0");
    read_at(model, 0.9 - shift, &a, NULL);
    read_at(model, 1.1 - shift, &b, NULL);
    same(&a, &b, 1e-5, "and at 1");
    read_at(model, 0.2 - shift, &a, NULL);
    read_at(model, -2.2 - shift, &b, NULL);
    same(&a, &b, 1e-5, "and again");
    if (model_open(FROM, model, NULL, &run) != SPIN_OK)
        exit(1);
    ok(run.sequence.continuous && run.sequence.time_first == 0 &&
           fabs(run.sequence.time_last - 299.0 / 300) < 1e-12 && !run.sequence.half_open,
       "any time to that of the last frame may be asked for");
    ok(strstr(run.sequence.notes, "offsets of 2 training cameras") &&
           strstr(run.sequence.notes, "i/300"),
       "the notes tell the shift and the times of frames");
    ok(run.importer->frame(run.self, 0, NAN, SPIN_COL_MEANS, &a) == SPIN_E_USAGE,
       "there is no time NaN");
    run_close(&run);
    model = make_with(model, "total_num_frames=300, ", "");
    if (model_open(FROM, model, NULL, &run) != SPIN_OK)
        exit(1);
    ok(run.sequence.time_last == 1 && run.sequence.half_open,
       "of an unknown number of frames: to 1");
    run_close(&run);
    spin_splats_free(&a);
    spin_splats_free(&b);
}

/* Both stages add to the same attributes; disabled heads and stages leave them unchanged. */
static void test_switches(const char *model)
{
    static const struct {
        const char *word;
        unsigned column;
    } heads[] = {{"no_ds", SPIN_COL_LOG_SCALES},
                 {"no_dr", SPIN_COL_QUATS},
                 {"no_do", SPIN_COL_LOGIT_OPACITIES},
                 {"no_dc", SPIN_COL_SH}};
    const char *whole = copy_of(model);
    const char *fine = make_with(model, "no_coarse_deform=False", "no_coarse_deform=True");
    const char *coarse = make_with(model, "no_fine_deform=False", "no_fine_deform=True"), *none;
    struct spin_splats a = {0}, c = {0}, f = {0}, canonical = {0};
    unsigned still = 0;
    double worst = 0;

    none = make_with(model, "no_fine_deform=False", "no_fine_deform=True");
    replace_text(path_in(none, "cfg_args"), "no_coarse_deform=False", "no_coarse_deform=True");
    read_at(whole, 0.6, &a, &still);
    ok(still == 0, "nothing is still");
    read_at(coarse, 0.6, &c, NULL);
    read_at(fine, 0.6, &f, NULL);
    read_at(none, 0.6, &canonical, &still);
    ok(still == (SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES), "without stages everything is still");
    for (size_t i = 0; i < 3 * a.n; i++)
        worst =
            larger(worst, fabs((double)c.means[i] + f.means[i] - canonical.means[i] - a.means[i]));
    near(worst, 0, 1e-5, "the stages' residuals add up");
    for (size_t h = 0; h < 4; h++) {
        char word[32], by[32];

        snprintf(word, sizeof word, "%s=False", heads[h].word);
        snprintf(by, sizeof by, "%s=True", heads[h].word);
        read_at(make_with(model, word, by), 0.6, &f, &still);
        ok(still == heads[h].column, "%s: that is still", by);
        worst = 0;
        for (size_t i = 0; i < a.n; i++) {
            worst = larger(worst, fabs((double)f.means[3 * i] - a.means[3 * i]));
            if (heads[h].column == SPIN_COL_LOG_SCALES)
                worst = larger(worst, fabs(f.log_scales[3 * i] - canonical.log_scales[3 * i]));
            else if (heads[h].column == SPIN_COL_QUATS)
                worst = larger(worst, fabs(f.quats[4 * i] - canonical.quats[4 * i]));
            else if (heads[h].column == SPIN_COL_SH)
                worst = larger(worst, fabs(f.sh[48 * i + 5] - canonical.sh[48 * i + 5]));
            else
                worst = larger(worst, fabs(f.logit_opacities[i] - canonical.logit_opacities[i]));
        }
        near(worst, 0, 0, "it is the canonical one, and places are as they were");
    }
    spin_splats_free(&a);
    spin_splats_free(&c);
    spin_splats_free(&f);
    spin_splats_free(&canonical);
}

/* The same network in another form: prefixes of the keys, and an extra layer without effect. */
static void test_shapes(const char *fixture)
{
    static const char *const words[] = {"", "deformation_net.", "module."};
    const char *model = path_in(fixture, "model");
    struct pth pth;

    for (size_t w = 0; w < 3; w++) {
        const char *copy = copy_of(model), *path = golden_path(copy, NETWORK);

        pth_load(path, &pth);
        for (int i = 0; i < pth.n; i++) {
            char name[100];

            snprintf(name, sizeof name, "%s%.80s", words[w], pth.tensor[i].name);
            memcpy(pth.tensor[i].name, name, sizeof name);
        }
        for (int s = 0; s < 2 && w == 0; s++) { /* relu(1 relu(h)) = relu(h) */
            uint64_t shape[2];
            char key[40];
            struct pth_tensor *t;

            snprintf(key, sizeof key, "feature_out_%c.0.weight", "cf"[s]);
            shape[0] = shape[1] = pth_find(&pth, key)->shape[0];
            snprintf(key, sizeof key, "feature_out_%c.2.weight", "cf"[s]);
            t = pth_put(&pth, key, 2, shape);
            for (uint64_t i = 0; i < shape[0]; i++)
                t->values[i * shape[0] + i] = 1;
            snprintf(key, sizeof key, "feature_out_%c.2.bias", "cf"[s]);
            pth_put(&pth, key, 1, shape);
        }
        pth_save(&pth, path);
        pth_free(&pth);
        golden_as(FROM, copy, NULL, fixture, 0, w ? words[w] : "with a second layer");
    }
}

/* ---- Malformed files --------------------------------------------------------------------------
 */

static void test_lies(const char *model)
{
    static const struct lie lies[] = {
        {NETWORK, "set pos_deform_c.1.weight 0 nan", "pos_deform_c.1.weight", "NaN in a layer"},
        {NETWORK, "set offsets 3 nan", "offsets", "NaN in the offsets"},
        {NETWORK, "put offsets 30", "offsets", "offsets of another shape"},
        {NETWORK, "drop offsets", "offsets", "no offsets"},
        {NETWORK, "set weight 7 nan", "weight", "NaN in the table of times"},
        {NETWORK, "put weight 30 4 4", "weight", "a table of three dimensions"},
        {NETWORK, "put weight 30 15", "has 24 inputs", "a table that the first layer does not fit"},
        {NETWORK, "put weight 29 16", "max_embeddings", "a table of fewer rows than cfg_args says"},
        {NETWORK, "put weight 30 0", "weight", "a table without columns"},
        {NETWORK, "drop rgb_deform_f.3.weight", "rgb_deform_f.3.weight",
         "a head that is needed and not there"},
        {NETWORK, "drop feature_out_c.0.bias", "feature_out_c.0.bias", "a layer without bias"},
        {NETWORK, "put scales_deform_f.3.weight 5 24", "scales_deform_f.3.weight",
         "a head with too many outputs"},
        {NETWORK, "put feature_out_f.4.weight 24 24; put feature_out_f.4.bias 24", "feature_out_f.",
         "a layer that is missing"},
        {NETWORK, "put timenet.0.weight 24 24", "timenet.0.weight", "a tensor of another method"},
        {NETWORK, "drop feature_out_c.0.weight; drop feature_out_f.0.weight",
         "feature_out_c.0.weight", "no first layer"},
        {NETWORK, "pair", "not contain a state dict", "a pair instead of a state dict"},
        {CLOUD, "set embedding_2 4 nan", "embedding_2", "NaN in an embedding"},
        {CLOUD, "drop embedding_3", "embedding_3", "embeddings with a hole"},
        {CLOUD, "drop embedding_ 0 7", "embedding_*", "no embeddings"},
        {CLOUD, "rows 0", "0 vertices", "a cloud of nothing"},
        {CLOUD, "set y 1 nan", "x, y, z", "NaN in a place"},
        {CLOUD, "drop opacity", "opacity", "no opacities"},
        {CLOUD, DEGREE_2, "degree 2", "SH of degree 2 where SH is deformed"},
        {"cfg_args", "text min_embeddings=6=>min_embeddings=0", "min_embeddings", "no row"},
        {"cfg_args", "text min_embeddings=6=>min_embeddings=2.5", "min_embeddings", "half a row"},
        {"cfg_args", "text min_embeddings=6=>min_embeddings=1e12", "min_embeddings",
         "more rows than can be"},
        {"cfg_args", "text max_embeddings=30=>max_embeddings='x'", "max_embeddings",
         "rows in words"},
        {"cfg_args", "text c2f_temporal_iter=10000=>c2f_temporal_iter=0", "c2f_temporal_iter",
         "growth in no time"},
        {"cfg_args", "text total_num_frames=300=>total_num_frames=-3", "total_num_frames",
         "-3 frames"},
        {"cfg_args", "text use_anneal=True=>use_anneal=Maybe", "use_anneal",
         "a switch that is neither"},
        {"cfg_args", "text no_dc=False=>no_dc=[", "cut short", "a bracket that is not closed"},
        {"cfg_args", "text Namespace(=>Name(", "Namespace", "settings of another kind"},
    };
    static const char *const needed[] = {"min_embeddings=6, ",
                                         "max_embeddings=30, ",
                                         "c2f_temporal_iter=10000, ",
                                         "deform_from_iter=5000, ",
                                         "use_anneal=True, ",
                                         "use_coarse_temporal_embedding=True, ",
                                         "no_c2f_temporal_embedding=False, ",
                                         "no_coarse_deform=False, ",
                                         "no_fine_deform=False, ",
                                         "no_ds=False, ",
                                         "no_dr=False, ",
                                         "no_do=False, ",
                                         "no_dc=False, "};

    refuse_lies(FROM, model, NULL, lies, sizeof lies / sizeof *lies);
    for (size_t i = 0; i < sizeof needed / sizeof *needed; i++) {
        char word[40];

        snprintf(word, sizeof word, "'%.*s'", (int)strcspn(needed[i], "="), needed[i]);
        model_fails(FROM, make_with(model, needed[i], ""), NULL, "cfg_args", word, word);
    }
    model_fails(FROM, edited(model, CLOUD, "put embedding_8"), NULL, "deformation.pth",
                "property embedding_*", "an embedding more than the network takes");
}

/* Unused tensors may be missing. */
static void test_unused(const char *model)
{
    const char *copy = copy_of(model), *path = golden_path(copy, NETWORK);
    struct spin_splats s = {0};
    struct pth pth;

    pth_load(path, &pth);
    for (int i = pth.n - 1; i >= 0; i--) {
        if (strstr(pth.tensor[i].name, "rgb_deform") || strstr(pth.tensor[i].name, "_c."))
            pth_drop(&pth, pth.tensor[i].name);
    }
    pth_save(&pth, path);
    pth_free(&pth);
    edit_file(path_in(copy, "cfg_args"),
              "text no_dc=False=>no_dc=True;text no_coarse_deform=False=>no_coarse_deform=True");
    read_at(copy, 0.5, &s, NULL);
    ok(s.n > 0, "a head and a stage that are off may be missing");
    copy = edited(model, CLOUD, DEGREE_2 "; rows 1");
    replace_text(path_in(copy, "cfg_args"), "no_dc=False", "no_dc=True");
    read_at(copy, 0.5, &s, NULL);
    ok(s.n == 1 && s.sh_degree == 2, "one Gaussian, with SH of degree 2 that is not deformed");
    spin_splats_free(&s);
}

static void test_files(const char *model)
{
    const char *copy = copy_of(model), *cloud = golden_path(model, CLOUD);
    const struct spin_importer *found = NULL;
    struct run run;

    while (golden_path(copy, NETWORK))
        unlink(golden_path(copy, NETWORK));
    model_fails(FROM, copy, NULL, copy, "deformation.pth", "no network");
    model_fails(FROM, new_folder(), NULL, NULL, "iteration_<N>", "an empty folder");
    model_fails(FROM, path_in(model, "../manifest.json"), NULL, "manifest.json",
                "is neither the model's folder", "a file of another kind");
    model_fails("4dgaussian", golden_path(model, SAVE), NULL, "deformation.pth", "--from ed3dgs",
                "4dgaussian says whose network it is");
    if (ok(spin_importer_find(cloud, NULL, false, &found) == SPIN_OK &&
               !strcmp(found->name, "ply") && run_open("ply", cloud, &run) == SPIN_OK,
           "the cloud by itself is a PLY")) {
        ok(strstr(run.sequence.notes, "--from ed3dgs") != NULL, "and a note says what it lacks");
        run_close(&run);
    }
}

TAP_MAIN
{
    const char *root = check_fixture(FROM), **names = check_cases(FROM, "expected.npz");
    const char *fixture, *model;

    spin_log_set_level(-2);
    if (!root) {
        skip("ed3dgs fixtures", "there are none here");
        return;
    }
    for (size_t i = 0; names[i]; i++) {
        model = path_in(path_in(root, names[i]), "model");
        PART(refuse_cuts, FROM, model, NULL, NETWORK);
        PART(refuse_cuts, FROM, model, NULL, CLOUD);
        PART(refuse_cuts, FROM, model, NULL, "cfg_args");
    }
    free(names);
    fixture = path_in(root, "annealed_early");
    model = path_in(fixture, "model");
    PART(test_iteration, fixture);
    PART(test_rows, model);
    PART(test_times, fixture);
    PART(test_switches, model);
    PART(test_shapes, fixture);
    PART(test_lies, model);
    PART(test_unused, model);
    PART(refuse_containers, FROM, model, NULL, NETWORK);
    PART(test_files, model);
}
