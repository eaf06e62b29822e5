/* ed3dgs: every fixture at all its times, what the iteration and the options of a run change, other shapes of
 * the same network, and files that lie.
 * K: ed3dgs import threads */
#include "tests/importers/clouds.h"

/* ---- Fixtures -------------------------------------------------------------------------------- */

static void compare_time(struct spin_npz *npz, int index, const char *name,
                         const struct spin_splats *s)
{
    static const struct {
        const char *key;
        size_t width;
    } parts[] = {{"xyz", 3}, {"rot", 4}, {"scale_raw", 3}, {"opacity", 1}, {"sh", 48}};
    float *opacity = map_values(s->logit_opacities, s->n, sigmoid);
    const float *const got[] = {s->means, s->quats, s->log_scales, opacity, s->sh};

    for (size_t i = 0; i < 5; i++) {
        struct expected e = {npz, bound(parts[i].key).abs, 0, name};
        size_t n = parts[i].width * s->n;
        struct spin_array info;
        double *want = check_load(npz, parts[i].key, &info); /* one time only: it does not change */

        compare(&e, parts[i].key, info.shape[0] > 1 ? (uint64_t)index * n : 0, n, got[i]);
        free(want);
    }
    free(opacity);
}

/* The model at `path` against the numbers of fixture `folder`; later: what to add to their times. */
static void compare_model(const char *path, const char *const *pairs, const char *folder,
                          double later, const char *name)
{
    struct spin_splats s = {0}, again = {0};
    struct spin_array info;
    struct spin_npz npz;
    struct run run;
    double *times;

    bounds_of = folder;
    if (!ok(model_open("ed3dgs", path, pairs, &run) == SPIN_OK, "%s: opens", name)) {
        printf("#   %s\n", spin_last_error());
        return;
    }
    if (spin_npz_open(path_in(folder, "expected.npz"), &npz) != SPIN_OK)
        exit(1);
    times = check_load(&npz, "times", &info);
    for (size_t t = 0; times && t < info.count; t++) {
        double time = times[t] + later;
        char what[200];

        snprintf(what, sizeof what, "%s, time %g", name, time);
        if (ok(run.importer->frame(run.self, 0, time, run.sequence.columns, &s) == SPIN_OK,
               "%s: reads", what))
            compare_time(&npz, (int)t, what, &s);
        else
            printf("#   %s\n", spin_last_error());
        run.importer->frame(run.self, 0, time, SPIN_COL_MEANS, &again);
        check_same_bits(again.means, s.means, 3 * s.n * sizeof *s.means,
                        "positions alone are the same");
    }
    free(times);
    spin_splats_free(&s);
    spin_splats_free(&again);
    spin_npz_close(&npz);
    run_close(&run);
}

/* iteration_<N> with the largest N of a fixture. */
static const char *save_of(const char *folder)
{
    const char *clouds = path_in(folder, "model/point_cloud"), *save = NULL;
    char **names = NULL;
    size_t n = 0;
    long most = -1;

    if (spin_folder_list(clouds, &names, &n) != SPIN_OK)
        exit(1);
    for (size_t i = 0; i < n; i++) {
        if (atol(names[i] + strlen("iteration_")) > most) {
            most = atol(names[i] + strlen("iteration_"));
            save = path_in(clouds, names[i]);
        }
    }
    spin_folder_list_free(names);
    return save;
}

static void is_recognised(const char *path, const char *what)
{
    const struct spin_importer *found = NULL;

    ok(spin_importer_find(path, NULL, false, &found) == SPIN_OK && !strcmp(found->name, "ed3dgs"),
       "%s is recognised", what);
}

static void test_fixture(const char *folder, const char *name)
{
    const char *model = path_in(folder, "model"), *save = save_of(folder);

    compare_model(model, NULL, folder, 0, name);
    compare_model(path_in(save, "deformation.pth"), NULL, folder, 0, "the network alone");
    is_recognised(model, name);
    is_recognised(save, "the folder of its save");
    is_recognised(path_in(save, "deformation.pth"), "its network");
}

/* ---- Models made here ------------------------------------------------------------------------ */

/* A copy of a fixture's last save as `save`, with another network and cloud (NULL: the same). */
static const char *make_model_at(const char *folder, const char *save, const struct pth *pth,
                                 const struct cloud *cloud)
{
    const char *model = new_folder(), *from = save_of(folder);
    const char *to = path_in(path_in(model, "point_cloud"), save);

    if (spin_folder_make(to) != SPIN_OK)
        exit(1);
    if (pth)
        pth_save(pth, path_in(to, "deformation.pth"));
    else
        copy_file(path_in(from, "deformation.pth"), path_in(to, "deformation.pth"));
    if (cloud)
        cloud_save(cloud, path_in(to, "point_cloud.ply"));
    else
        copy_file(path_in(from, "point_cloud.ply"), path_in(to, "point_cloud.ply"));
    copy_file(path_in(folder, "model/cfg_args"), path_in(model, "cfg_args"));
    return model;
}

static const char *make_model(const char *folder, const struct pth *pth, const struct cloud *cloud)
{
    return make_model_at(folder, spin_path_name(save_of(folder)), pth, cloud);
}

static void test_truncations(const char *folder)
{
    const char *model = make_model(folder, NULL, NULL);
    const char *save = path_in(path_in(model, "point_cloud"), spin_path_name(save_of(folder)));

    cut_everywhere("ed3dgs", model, NULL, save, "deformation.pth");
    cut_everywhere("ed3dgs", model, NULL, save, "point_cloud.ply");
    cut_everywhere("ed3dgs", model, NULL, model, "cfg_args");
}

/* A model of which an option is another one. */
static const char *make_with(const char *folder, const char *word, const char *by)
{
    const char *model = make_model(folder, NULL, NULL);

    replace_text(path_in(model, "cfg_args"), word, by);
    return model;
}

static void read_at(const char *path, double time, struct spin_splats *out, unsigned *still)
{
    struct run run;

    if (model_open("ed3dgs", path, NULL, &run) != SPIN_OK ||
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
static void test_iteration(const char *folder)
{
    const char *early = make_model_at(folder, "iteration_3000", NULL, NULL);
    const char *named = make_model_at(folder, "last", NULL, NULL), *save, *cfg;
    const char *number[] = {"iteration", "5400", NULL}, *other[] = {"iteration", "5300", NULL};
    const char *settings[] = {"iteration", "5400", "cfg-args", NULL, NULL};
    struct spin_splats a = {0};
    struct cloud cloud;
    const float *scale, *x;
    double worst = 0, moved = 0;

    cloud_load(path_in(save_of(folder), "point_cloud.ply"), &cloud);
    read_at(early, 0.5, &a, NULL);
    scale = cloud_find(&cloud, "scale_1");
    x = cloud_find(&cloud, "x");
    for (size_t i = 0; i < a.n; i++) {
        worst = fmax(worst, fabs((double)a.log_scales[3 * i + 1] - scale[i]));
        moved = fmax(moved, fabs((double)a.means[3 * i] - x[i]));
    }
    ok(worst == 0 && moved > 0.01, "before deform_from_iter only positions and rotations move");
    spin_splats_free(&a);
    cloud_free(&cloud);

    save = path_in(named, "point_cloud/last");
    model_fails("ed3dgs", save, NULL, "last", "--iteration", "a save without its number");
    compare_model(save, number, folder, 0, "the number by --iteration");
    model_fails("ed3dgs", save_of(folder), other, "5300", "iteration_5400",
                "--iteration of another save than the one given");
    model_fails("ed3dgs", path_in(folder, "model"), other, "model", "iteration_5300",
                "a save that is not there");
    cfg = path_in(new_folder(), "kept");
    copy_file(path_in(named, "cfg_args"), cfg);
    unlink(path_in(named, "cfg_args"));
    model_fails("ed3dgs", save, number, "last", "--cfg-args", "no cfg_args");
    settings[3] = cfg;
    compare_model(save, settings, folder, 0, "settings by --cfg-args");
}

/* Which rows of the table count, told by options that come to the same. */
static void test_rows(const char *folder)
{
    const char *late = make_with(folder, "c2f_temporal_iter=10000", "c2f_temporal_iter=5400");
    const char *whole =
        make_with(folder, "no_c2f_temporal_embedding=False", "no_c2f_temporal_embedding=True");
    const char *both = make_with(folder, "use_coarse_temporal_embedding=True",
                                 "use_coarse_temporal_embedding=False");
    const char *few = make_with(folder, "min_embeddings=6", "min_embeddings=18"), *one;
    struct spin_splats a = {0}, b = {0};

    test_same(late, whole, "the whole table from c2f_temporal_iter on");
    replace_text(path_in(whole, "cfg_args"), "min_embeddings=6", "min_embeddings=30");
    replace_text(path_in(both, "cfg_args"), "no_c2f_temporal_embedding=False",
                 "no_c2f_temporal_embedding=True");
    test_same(both, whole, "the coarse stage with as many rows as the fine one");
    replace_text(path_in(few, "cfg_args"), "c2f_temporal_iter=10000", "c2f_temporal_iter=1e12");
    both = make_with(folder, "use_coarse_temporal_embedding=True",
                     "use_coarse_temporal_embedding=False");
    read_at(few, 0.37, &a, NULL);  /* coarse 18, fine 18 */
    read_at(both, 0.37, &b, NULL); /* 6 + 24 * 0.54 = 18.96, both */
    same(&a, &b, 0, "rows grow with the iteration and are cut to a whole number");
    one = make_with(folder, "min_embeddings=6", "min_embeddings=1");
    read_at(one, 0.2, &a, NULL);
    ok(a.n > 0, "one row is enough");
    spin_splats_free(&a);
    spin_splats_free(&b);
}

/* Times are shifted by the offsets that are not 0, and reflected at 0 and at 1. */
static void test_times(const char *folder)
{
    const char *model = make_model(folder, NULL, NULL), *still;
    struct spin_splats a = {0}, b = {0};
    struct pth_tensor *offsets;
    struct pth pth;
    double shift = 0, n = 0;
    struct run run;

    pth_load(path_in(save_of(folder), "deformation.pth"), &pth);
    offsets = pth_find(&pth, "offsets");
    for (uint64_t i = 0; i < offsets->count; i++) {
        shift += offsets->values[i];
        n += offsets->values[i] != 0;
        offsets->values[i] = 0;
    }
    shift /= n;
    still = make_model(folder, &pth, NULL);
    compare_model(still, NULL, folder, shift, "without offsets, at times shifted by them");
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
    if (model_open("ed3dgs", model, NULL, &run) != SPIN_OK)
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
    model = make_with(folder, "total_num_frames=300, ", "");
    if (model_open("ed3dgs", model, NULL, &run) != SPIN_OK)
        exit(1);
    ok(run.sequence.time_last == 1 && run.sequence.half_open,
       "of an unknown number of frames: to 1");
    run_close(&run);
    spin_splats_free(&a);
    spin_splats_free(&b);
}

/* Both stages add to the same attributes; heads and stages that are off leave them alone. */
static void test_switches(const char *folder)
{
    static const struct {
        const char *word;
        unsigned column;
    } heads[] = {{"no_ds", SPIN_COL_LOG_SCALES},
                 {"no_dr", SPIN_COL_QUATS},
                 {"no_do", SPIN_COL_LOGIT_OPACITIES},
                 {"no_dc", SPIN_COL_SH}};
    const char *whole = make_model(folder, NULL, NULL);
    const char *fine = make_with(folder, "no_coarse_deform=False", "no_coarse_deform=True");
    const char *coarse = make_with(folder, "no_fine_deform=False", "no_fine_deform=True"), *none;
    struct spin_splats a = {0}, c = {0}, f = {0}, canonical = {0};
    unsigned still = 0;
    double worst = 0;

    none = make_with(folder, "no_fine_deform=False", "no_fine_deform=True");
    replace_text(path_in(none, "cfg_args"), "no_coarse_deform=False", "no_coarse_deform=True");
    read_at(whole, 0.6, &a, &still);
    ok(still == 0, "nothing is still");
    read_at(coarse, 0.6, &c, NULL);
    read_at(fine, 0.6, &f, NULL);
    read_at(none, 0.6, &canonical, &still);
    ok(still == (SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES), "without stages everything is still");
    for (size_t i = 0; i < 3 * a.n; i++)
        worst =
            fmax(worst, fabs((double)c.means[i] + f.means[i] - canonical.means[i] - a.means[i]));
    near(worst, 0, 1e-5, "the stages' residuals add up");
    for (size_t h = 0; h < 4; h++) {
        char word[32], by[32];

        snprintf(word, sizeof word, "%s=False", heads[h].word);
        snprintf(by, sizeof by, "%s=True", heads[h].word);
        read_at(make_with(folder, word, by), 0.6, &f, &still);
        ok(still == heads[h].column, "%s: that is still", by);
        worst = 0;
        for (size_t i = 0; i < a.n; i++) {
            worst = fmax(worst, fabs((double)f.means[3 * i] - a.means[3 * i]));
            if (heads[h].column == SPIN_COL_LOG_SCALES)
                worst = fmax(worst, fabs(f.log_scales[3 * i] - canonical.log_scales[3 * i]));
            else if (heads[h].column == SPIN_COL_QUATS)
                worst = fmax(worst, fabs(f.quats[4 * i] - canonical.quats[4 * i]));
            else if (heads[h].column == SPIN_COL_SH)
                worst = fmax(worst, fabs(f.sh[48 * i + 5] - canonical.sh[48 * i + 5]));
            else
                worst = fmax(worst, fabs(f.logit_opacities[i] - canonical.logit_opacities[i]));
        }
        near(worst, 0, 0, "it is the canonical one, and places are as they were");
    }
    spin_splats_free(&a);
    spin_splats_free(&c);
    spin_splats_free(&f);
    spin_splats_free(&canonical);
}

/* The same network in other clothes: words before the keys, a layer more that changes nothing. */
static void test_shapes(const char *folder)
{
    static const char *const words[] = {"deformation_net.", "module."};
    struct pth pth;

    for (size_t w = 0; w < 2; w++) {
        pth_load(path_in(save_of(folder), "deformation.pth"), &pth);
        for (int i = 0; i < pth.n; i++) {
            char name[100];

            snprintf(name, sizeof name, "%s%.80s", words[w], pth.tensor[i].name);
            memcpy(pth.tensor[i].name, name, sizeof name);
        }
        compare_model(make_model(folder, &pth, NULL), NULL, folder, 0, words[w]);
        pth_free(&pth);
    }
    pth_load(path_in(save_of(folder), "deformation.pth"), &pth);
    for (int s = 0; s < 2; s++) { /* relu(1 relu(h)) = relu(h) */
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
    compare_model(make_model(folder, &pth, NULL), NULL, folder, 0, "with a second layer");
    pth_free(&pth);
}

/* ---- Files that lie -------------------------------------------------------------------------- */

static const uint64_t cube[3] = {30, 4, 4}, narrow[2] = {30, 15}, short_table[2] = {29, 16};
static const uint64_t odd_head[2] = {5, 24}, square[2] = {24, 24}, no_columns[2] = {30, 0};
static const uint64_t flat[1] = {30};

static void nan_weight(struct pth *p) { pth_find(p, "pos_deform_c.1.weight")->values[0] = NAN; }
static void nan_offset(struct pth *p) { pth_find(p, "offsets")->values[3] = NAN; }
static void flat_offsets(struct pth *p) { pth_put(p, "offsets", 1, flat); }
static void no_offsets(struct pth *p) { pth_drop(p, "offsets"); }
static void nan_table(struct pth *p) { pth_find(p, "weight")->values[7] = NAN; }
static void cubic_table(struct pth *p) { pth_put(p, "weight", 3, cube); }
static void narrow_table(struct pth *p) { pth_put(p, "weight", 2, narrow); }
static void few_rows(struct pth *p) { pth_put(p, "weight", 2, short_table); }
static void empty_rows(struct pth *p) { pth_put(p, "weight", 2, no_columns); }
static void no_head(struct pth *p) { pth_drop(p, "rgb_deform_f.3.weight"); }
static void no_bias(struct pth *p) { pth_drop(p, "feature_out_c.0.bias"); }
static void wide_head(struct pth *p) { pth_put(p, "scales_deform_f.3.weight", 2, odd_head); }
static void hole(struct pth *p)
{
    pth_put(p, "feature_out_f.4.weight", 2, square);
    pth_put(p, "feature_out_f.4.bias", 1, square);
}
static void other_tensor(struct pth *p) { pth_put(p, "timenet.0.weight", 2, square); }
static void no_trunk(struct pth *p)
{
    pth_drop(p, "feature_out_c.0.weight");
    pth_drop(p, "feature_out_f.0.weight");
}
static void two_dicts(struct pth *p) { p->pair = true; }

static void nan_embedding(struct cloud *c) { cloud_find(c, "embedding_2")[4] = NAN; }
static void embedding_hole(struct cloud *c) { cloud_drop(c, "embedding_3"); }
static void no_embedding(struct cloud *c)
{
    for (int i = 0; i < 8; i++) {
        char name[32];

        snprintf(name, sizeof name, "embedding_%d", i);
        cloud_drop(c, name);
    }
}
static void one_more(struct cloud *c) { cloud_add(c, "embedding_8"); }
static void no_vertices(struct cloud *c) { c->n = 0; }
static void nan_place(struct cloud *c) { cloud_find(c, "y")[1] = NAN; }
static void no_opacity(struct cloud *c) { cloud_drop(c, "opacity"); }
static void degree_2(struct cloud *c)
{
    for (int i = 24; i < 45; i++) {
        char name[32];

        snprintf(name, sizeof name, "f_rest_%d", i);
        cloud_drop(c, name);
    }
}

static void test_networks(const char *folder)
{
    static const struct {
        void (*change)(struct pth *);
        const char *word, *what;
    } lies[] = {
        {nan_weight, "pos_deform_c.1.weight", "NaN in a layer"},
        {nan_offset, "offsets", "NaN in the offsets"},
        {flat_offsets, "offsets", "offsets of another shape"},
        {no_offsets, "offsets", "no offsets"},
        {nan_table, "weight", "NaN in the table of times"},
        {cubic_table, "weight", "a table of three dimensions"},
        {narrow_table, "takes 24 inputs", "a table that the first layer does not fit"},
        {few_rows, "max_embeddings", "a table of fewer rows than cfg_args says"},
        {empty_rows, "weight", "a table without columns"},
        {no_head, "rgb_deform_f.3.weight", "a head that is needed and not there"},
        {no_bias, "feature_out_c.0.bias", "a layer without bias"},
        {wide_head, "scales_deform_f.3.weight", "a head with too many outputs"},
        {hole, "feature_out_f.", "a layer that is missing"},
        {other_tensor, "timenet.0.weight", "a tensor of another method"},
        {no_trunk, "feature_out_c.0.weight", "no first layer"},
        {two_dicts, "not a state dict", "a pair instead of a state dict"},
    };
    struct pth pth;

    for (size_t i = 0; i < sizeof lies / sizeof *lies; i++) {
        pth_load(path_in(save_of(folder), "deformation.pth"), &pth);
        lies[i].change(&pth);
        model_fails("ed3dgs", make_model(folder, &pth, NULL), NULL, "deformation.pth", lies[i].word,
                    lies[i].what);
        pth_free(&pth);
    }
    /* What is not used may be missing. */
    pth_load(path_in(save_of(folder), "deformation.pth"), &pth);
    for (int i = pth.n - 1; i >= 0; i--) {
        if (strstr(pth.tensor[i].name, "rgb_deform") || strstr(pth.tensor[i].name, "_c."))
            pth_drop(&pth, pth.tensor[i].name);
    }
    {
        const char *model = make_model(folder, &pth, NULL);
        struct spin_splats s = {0};

        replace_text(path_in(model, "cfg_args"), "no_dc=False", "no_dc=True");
        replace_text(path_in(model, "cfg_args"), "no_coarse_deform=False", "no_coarse_deform=True");
        read_at(model, 0.5, &s, NULL);
        ok(s.n > 0, "a head and a stage that are off may be missing");
        spin_splats_free(&s);
    }
    pth_free(&pth);
}

static void test_clouds(const char *folder)
{
    static const struct {
        void (*change)(struct cloud *);
        const char *word, *what;
    } lies[] = {
        {nan_embedding, "embedding_2", "NaN in an embedding"},
        {embedding_hole, "embedding_3", "embeddings with a hole"},
        {no_embedding, "embedding_*", "no embeddings"},
        {no_vertices, "0 vertices", "a cloud of nothing"},
        {nan_place, "x, y, z", "NaN in a place"},
        {no_opacity, "opacity", "no opacities"},
        {degree_2, "degree 2", "SH of degree 2 where SH is deformed"},
    };
    struct spin_splats s = {0};
    struct cloud cloud;
    const char *model;

    for (size_t i = 0; i < sizeof lies / sizeof *lies; i++) {
        cloud_load(path_in(save_of(folder), "point_cloud.ply"), &cloud);
        lies[i].change(&cloud);
        model_fails("ed3dgs", make_model(folder, NULL, &cloud), NULL, "point_cloud.ply",
                    lies[i].word, lies[i].what);
        cloud_free(&cloud);
    }
    cloud_load(path_in(save_of(folder), "point_cloud.ply"), &cloud);
    one_more(&cloud);
    model_fails("ed3dgs", make_model(folder, NULL, &cloud), NULL, "deformation.pth",
                "9 properties embedding_*", "an embedding more than the network takes");
    cloud_free(&cloud);
    cloud_load(path_in(save_of(folder), "point_cloud.ply"), &cloud);
    degree_2(&cloud);
    cloud.n = 1;
    model = make_model(folder, NULL, &cloud);
    replace_text(path_in(model, "cfg_args"), "no_dc=False", "no_dc=True");
    read_at(model, 0.5, &s, NULL);
    ok(s.n == 1 && s.sh_degree == 2, "one Gaussian, with SH of degree 2 that is not deformed");
    spin_splats_free(&s);
    cloud_free(&cloud);
}

static void test_settings(const char *folder)
{
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
    static const struct {
        const char *word, *by, *in;
    } bad[] = {
        {"min_embeddings=6", "min_embeddings=0", "min_embeddings"},
        {"min_embeddings=6", "min_embeddings=2.5", "min_embeddings"},
        {"min_embeddings=6", "min_embeddings=1e12", "min_embeddings"},
        {"max_embeddings=30", "max_embeddings='x'", "max_embeddings"},
        {"c2f_temporal_iter=10000", "c2f_temporal_iter=0", "c2f_temporal_iter"},
        {"total_num_frames=300", "total_num_frames=-3", "total_num_frames"},
        {"use_anneal=True", "use_anneal=Maybe", "use_anneal"},
        {"no_dc=False", "no_dc=[", "cut short"},
        {"Namespace(", "Name(", "Namespace"},
    };

    for (size_t i = 0; i < sizeof needed / sizeof *needed; i++) {
        char word[40];

        snprintf(word, sizeof word, "'%.*s'", (int)strcspn(needed[i], "="), needed[i]);
        model_fails("ed3dgs", make_with(folder, needed[i], ""), NULL, "cfg_args", word, word);
    }
    for (size_t i = 0; i < sizeof bad / sizeof *bad; i++)
        model_fails("ed3dgs", make_with(folder, bad[i].word, bad[i].by), NULL, "cfg_args",
                    bad[i].in, bad[i].by);
}

/* Every bad checkpoint that the reader of the container is tested with, in place of a network. */
static void test_files(const char *folder)
{
    const char *bad = check_fixture("torch_container/malformed");
    const char *model = make_model(folder, NULL, NULL), *from = save_of(folder);
    const char *save = path_in(path_in(model, "point_cloud"), spin_path_name(from));
    const struct spin_importer *found = NULL;
    char **names = NULL;
    size_t n = 0;
    struct run run;

    if (bad && spin_folder_list(bad, &names, &n) == SPIN_OK) {
        for (size_t i = 0; i < n; i++) {
            if (!strstr(names[i], ".pth"))
                continue;
            copy_file(path_in(bad, names[i]), path_in(save, "deformation.pth"));
            model_fails("ed3dgs", model, NULL, "deformation.pth", "", names[i]);
        }
        spin_folder_list_free(names);
    } else {
        skip("malformed containers", "there are none here");
    }
    unlink(path_in(save, "deformation.pth"));
    model_fails("ed3dgs", model, NULL, model, "deformation.pth", "no network");
    model_fails("ed3dgs", new_folder(), NULL, NULL, "iteration_<N>", "an empty folder");
    model_fails("ed3dgs", path_in(folder, "manifest.json"), NULL, "manifest.json",
                "is neither the model's folder", "a file of another kind");
    model_fails("4dgaussian", save_of(folder), NULL, "deformation.pth", "--from ed3dgs",
                "4dgaussian says whose network it is");
    if (ok(spin_importer_find(path_in(from, "point_cloud.ply"), NULL, false, &found) == SPIN_OK &&
               !strcmp(found->name, "ply") &&
               run_open("ply", path_in(from, "point_cloud.ply"), &run) == SPIN_OK,
           "the cloud by itself is a PLY")) {
        ok(strstr(run.sequence.notes, "--from ed3dgs") != NULL, "and a note says what it lacks");
        run_close(&run);
    }
}

TAP_MAIN
{
    const char *root = check_fixture("ed3dgs"), *folder;
    char **names = NULL;
    size_t n = 0;

    spin_log_set_level(-2);
    if (!root || spin_folder_list(root, &names, &n) != SPIN_OK) {
        skip("ed3dgs fixtures", "there are none here");
        return;
    }
    for (size_t i = 0; i < n; i++) {
        test_fixture(path_in(root, names[i]), names[i]);
        PART(test_truncations, path_in(root, names[i]));
    }
    spin_folder_list_free(names);
    folder = path_in(root, "annealed_early");
    PART(test_iteration, folder);
    PART(test_rows, folder);
    PART(test_times, folder);
    PART(test_switches, folder);
    PART(test_shapes, folder);
    PART(test_networks, folder);
    PART(test_clouds, folder);
    PART(test_settings, folder);
    PART(test_files, folder);
}
