/* 4dgaussian: every fixture at all its times, flags from cfg_args or options, rare networks made
 * here, and files that lie.
 * K: 4dgaussian import threads */
#include "tests/importers/models.h"

/* ---- Fixtures -------------------------------------------------------------------------------- */

static float largest_of(const float *values, size_t n)
{
    float most = 0;

    for (size_t i = 0; i < n; i++)
        most = fmaxf(most, fabsf(values[i]));
    return most;
}

static void compare_time(struct spin_npz *npz, int index, double extent, const char *name,
                         const struct spin_splats *s)
{
    struct spin_array sh;
    double *unused = check_load(npz, "sh", &sh);
    struct expected xyz = {npz, bound("xyz").abs * extent, 0, name};
    struct expected rot = {npz, bound("rot").abs, 0, name};
    struct expected scale = {npz, bound("scale_raw").abs, 0, name};
    struct expected opaque = {npz, bound("opacity").abs, 0, name};
    struct expected colour = {npz, bound("sh").abs, 0, name};
    uint64_t first = (uint64_t)index * s->n;
    float *opacity = map_values(s->logit_opacities, s->n, sigmoid);

    compare(&xyz, "xyz", 3 * first, 3 * s->n, s->means);
    compare(&rot, "rot", 4 * first, 4 * s->n, s->quats);
    compare(&scale, "scale_raw", 3 * first, 3 * s->n, s->log_scales);
    compare(&opaque, "opacity", first, s->n, opacity);
    compare(&colour, "sh", unused && sh.shape[0] > 1 ? 48 * first : 0, 48 * s->n, s->sh);
    free(opacity);
    free(unused);
}

/* The model at `path` against the numbers of fixture `folder`. */
static void compare_model(const char *path, const char *const *pairs, const char *folder,
                          const char *name)
{
    struct spin_splats s = {0};
    struct spin_array info;
    struct spin_npz npz;
    struct run run;
    double *times;

    bounds_of = folder;
    if (!ok(model_open("4dgaussian", path, pairs, &run) == SPIN_OK, "%s: opens", name)) {
        printf("#   %s\n", spin_last_error());
        return;
    }
    ok(run.sequence.continuous && run.sequence.time_first == 0 && run.sequence.time_last == 1,
       "%s: any time in 0..1 may be asked for", name);
    if (spin_npz_open(path_in(folder, "expected.npz"), &npz) != SPIN_OK)
        exit(1);
    times = check_load(&npz, "times", &info);
    for (size_t t = 0; times && t < info.count; t++) {
        char what[200];

        snprintf(what, sizeof what, "%s, time %g", name, times[t]);
        if (ok(run.importer->frame(run.self, (int)t, times[t], run.sequence.columns, &s) == SPIN_OK,
               "%s: reads", what))
            compare_time(&npz, (int)t, fmax(1, largest_of(s.means, 3 * s.n)), what, &s);
        else
            printf("#   %s\n", spin_last_error());
    }
    free(times);
    spin_splats_free(&s);
    spin_npz_close(&npz);
    run_close(&run);
}

static const char *save_of(const char *folder)
{
    const char *clouds = path_in(folder, "model/point_cloud");
    char **names = NULL;
    const char *save = NULL;
    size_t n = 0;

    if (spin_folder_list(clouds, &names, &n) != SPIN_OK)
        exit(1);
    for (size_t i = 0; i < n; i++) {
        if (strncmp(names[i], "iteration_", 10) == 0)
            save = path_in(clouds, names[i]);
    }
    spin_folder_list_free(names);
    return save;
}

static void test_fixture(const char *folder, const char *name)
{
    const struct spin_importer *found = NULL;
    const char *save = save_of(folder), *model = path_in(folder, "model");

    compare_model(model, NULL, folder, name);
    ok(spin_importer_find(model, NULL, false, &found) == SPIN_OK &&
           !strcmp(found->name, "4dgaussian"),
       "%s: the model's folder is recognised", name);
    ok(spin_importer_find(save, NULL, false, &found) == SPIN_OK &&
           !strcmp(found->name, "4dgaussian"),
       "%s: so is that of the save", name);
    ok(spin_importer_find(path_in(save, "deformation.pth"), NULL, false, &found) == SPIN_OK &&
           !strcmp(found->name, "4dgaussian") &&
           read_all(NULL, path_in(save, "deformation.pth")) == SPIN_OK,
       "%s: and the checkpoint alone", name);
}

/* The repository's own export: all right but for the opacity, which it forgets to deform. */
static void test_official(const char *root)
{
    const char *folder = path_in(root, "dynerf_like");
    struct spin_splats ours = {0}, theirs = {0};
    struct run run, ply;

    if (run_open("4dgaussian", path_in(folder, "model"), &run) != SPIN_OK ||
        run_open("ply", path_in(folder, "official_export/time_00003.ply"), &ply) != SPIN_OK)
        exit(1);
    run.importer->frame(run.self, 0, 0.81, run.sequence.columns, &ours);
    ply.importer->frame(ply.self, 0, 0, ply.sequence.columns, &theirs);
    if (ok(ours.n == theirs.n, "as many Gaussians as the method's own export")) {
        double worst = 0, moved = 0;

        for (size_t i = 0; i < 3 * ours.n; i++) {
            worst = fmax(worst, fabs(ours.means[i] - theirs.means[i]));
            worst = fmax(worst, fabs(ours.log_scales[i] - theirs.log_scales[i]));
        }
        for (size_t i = 0; i < 48 * ours.n; i++)
            worst = fmax(worst, fabs(ours.sh[i] - theirs.sh[i]));
        for (size_t i = 0; i < ours.n; i++)
            moved = fmax(moved, fabs(ours.logit_opacities[i] - theirs.logit_opacities[i]));
        near(worst, 0, 2e-4, "positions, scales and colours are those of the method's own export");
        ok(moved > 1e-3, "opacities are not: it writes the canonical ones");
    }
    run_close(&run);
    run_close(&ply);
    spin_splats_free(&ours);
    spin_splats_free(&theirs);
}

/* ---- Models made here ------------------------------------------------------------------------ */

/* A copy of a fixture's save with another network (NULL: the same) and cfg_args (NULL: none). */
static const char *make_model(const char *folder, const struct pth *pth, const char *cfg)
{
    const char *model = new_folder(), *to = path_in(model, "point_cloud/iteration_7");
    const char *from = save_of(folder);

    if (spin_folder_make(to) != SPIN_OK)
        exit(1);
    copy_file(path_in(from, "point_cloud.ply"), path_in(to, "point_cloud.ply"));
    if (pth)
        pth_save(pth, path_in(to, "deformation.pth"));
    else
        copy_file(path_in(from, "deformation.pth"), path_in(to, "deformation.pth"));
    if (cfg)
        write_text(path_in(model, "cfg_args"), cfg);
    return model;
}

static void test_options(const char *root)
{
    const char *folder = path_in(root, "flags_no_ds_no_dr");
    const char *flags[] = {"deform", "position,opacity", NULL};
    const char *all[] = {
        "deform", "position,scale,rotation,opacity", "apply-rotation", "true", "grid-pe", "2",
        NULL};
    const char *bad_word[] = {"deform", "position,colour", NULL};
    const char *bad_bool[] = {"apply-rotation", "perhaps", NULL};
    const char *missing[] = {"iteration", "5", NULL};
    const char *model = make_model(folder, NULL, NULL), *pe;
    struct run run;

    compare_model(model, flags, folder, "--deform instead of cfg_args");
    compare_model(make_model(folder, NULL, "Namespace(grid_pe=3)"), flags, folder,
                  "--deform before cfg_args");
    if (ok(run_open("4dgaussian", model, &run) == SPIN_OK, "opens without cfg_args")) {
        ok(strstr(run.sequence.notes, "no cfg_args") != NULL &&
               strstr(run.sequence.notes, "look trained: position opacity\n") != NULL,
           "notes what it assumed and which weights look trained");
        run_close(&run);
    }
    folder = path_in(root, "options_static_rot_pe");
    pe = make_model(folder, NULL, NULL);
    compare_model(pe, all, folder, "all options instead of cfg_args");
    compare_model(make_model(folder, NULL, "Namespace(grid_pe=3)"), all, folder,
                  "--grid-pe before cfg_args");
    model_fails("4dgaussian", pe, NULL, "deformation.pth", "--grid-pe",
                "encoded features need --grid-pe");
    model_fails("4dgaussian", model, bad_word, "colour", "expected", "a head that does not exist");
    model_fails("4dgaussian", model, bad_bool, "perhaps", "expected", "a switch that is neither");
    model_fails("4dgaussian", model, missing, model, "iteration_5", "a save that is not there");
}

/* empty_voxel: a mask that is 1 inside the box and 0 outside leaves or removes the canonical
 * place. */
static void test_voxels(const char *root)
{
    const char *folder = path_in(root, "coarse_and_fine"), *model;
    const char *moved[] = {"deform", "position", NULL};
    static const uint64_t shape[5] = {1, 1, 64, 64, 64}, three[1] = {3};
    struct spin_splats plain = {0}, masked = {0}, still = {0};
    const char *none[] = {"deform", "none", NULL};
    struct pth_tensor *grid, *low, *high;
    struct pth pth;
    struct run run;
    double worst = 0;
    int n_outside = 0;

    pth_load(path_in(save_of(folder), "deformation.pth"), &pth);
    grid = pth_put(&pth, "deformation_net.empty_voxel.grid", 5, shape);
    for (int i = 0; i < 64 * 64 * 64; i++) /* a ramp along x */
        grid->values[i] = (float)(i / 4096) / 63;
    low = pth_put(&pth, "deformation_net.empty_voxel.xyz_min", 1, three);
    high = pth_put(&pth, "deformation_net.empty_voxel.xyz_max", 1, three);
    for (int d = 0; d < 3; d++) {
        low->values[d] = -0.5f;
        high->values[d] = 0.5f;
    }
    model = make_model(folder, NULL, NULL);
    if (model_open("4dgaussian", model, none, &run) != SPIN_OK ||
        run.importer->frame(run.self, 0, 0.5, SPIN_COL_MEANS, &still) != SPIN_OK)
        exit(1);
    ok(run.sequence.static_columns == run.sequence.columns, "without heads nothing moves");
    run_close(&run);
    if (model_open("4dgaussian", model, moved, &run) != SPIN_OK ||
        run.importer->frame(run.self, 0, 0.5, SPIN_COL_MEANS, &plain) != SPIN_OK)
        exit(1);
    run_close(&run);
    model = make_model(folder, &pth, NULL);
    if (!ok(model_open("4dgaussian", model, moved, &run) == SPIN_OK &&
                run.importer->frame(run.self, 0, 0.5, SPIN_COL_MEANS, &masked) == SPIN_OK,
            "reads a network with empty_voxel"))
        printf("#   %s\n", spin_last_error());
    run_close(&run);
    for (size_t i = 0; i < masked.n; i++) {
        const float *p = still.means + 3 * i;
        bool inside = fabsf(p[0]) < 0.5f && fabsf(p[1]) < 0.5f && fabsf(p[2]) < 0.5f;
        bool far = fabsf(p[0]) > 0.53f || fabsf(p[1]) > 0.53f || fabsf(p[2]) > 0.53f;

        n_outside += far;
        for (int d = 0; (inside || far) && d < 3; d++) {
            double keep = inside ? p[0] + 0.5 : 0;
            double want = p[d] * keep + (plain.means[3 * i + (size_t)d] - p[d]);

            worst = fmax(worst, fabs(want - masked.means[3 * i + (size_t)d]));
        }
    }
    near(worst, 0, 1e-5, "the mask is the grid inside its box and 0 outside");
    ok(masked.n > 0 && n_outside > 0, "and there are Gaussians of both kinds");
    pth_free(&pth);
    spin_splats_free(&plain);
    spin_splats_free(&masked);
    spin_splats_free(&still);
}

static void test_prefix_and_threads(const char *root)
{
    const char *folder = path_in(root, "coarse_and_fine"), *model;
    struct spin_splats a = {0}, b = {0};
    struct pth pth;
    struct run run;

    pth_load(path_in(save_of(folder), "deformation.pth"), &pth);
    for (int i = 0; i < pth.n; i++) {
        char name[100];

        snprintf(name, sizeof name, "module.%.90s", pth.tensor[i].name);
        memcpy(pth.tensor[i].name, name, sizeof name);
    }
    model = make_model(folder, &pth, NULL);
    compare_model(model, NULL, folder, "keys that begin with 'module.'");
    pth_free(&pth);
    if (run_open("4dgaussian", model, &run) != SPIN_OK)
        exit(1);
    run.importer->frame(run.self, 0, 0.3, run.sequence.columns, &a);
    run.importer->frame(run.self, 0, 0.7, SPIN_COL_MEANS, &b);
    run.importer->frame(run.self, 0, 0.3, SPIN_COL_MEANS, &b);
    check_same_bits(a.means, b.means, 3 * a.n * sizeof *a.means,
                    "positions alone are the same, in any order");
    ok(run.importer->frame(run.self, 0, NAN, SPIN_COL_MEANS, &b) == SPIN_E_USAGE,
       "there is no time NaN");
    run_close(&run);
    spin_splats_free(&a);
    spin_splats_free(&b);
}

/* ---- Files that lie -------------------------------------------------------------------------- */

static void put_nan(struct pth *pth, const char *name) { pth_find(pth, name)->values[0] = NAN; }

/* A fixture's network with one change; the message names the file and has `word` in it. */
static void test_change(const char *folder, void (*change)(struct pth *), const char *word,
                        const char *what)
{
    const char *deform[] = {"deform", "position,scale,rotation,opacity,sh", NULL};
    struct pth pth;

    pth_load(path_in(save_of(folder), "deformation.pth"), &pth);
    change(&pth);
    model_fails("4dgaussian", make_model(folder, &pth, NULL), deform, "deformation.pth", word,
                what);
    pth_free(&pth);
}

#define NET "deformation_net."
static const uint64_t odd_plane[4] = {1, 4, 6, 7}, odd_channels[4] = {1, 5, 6, 6};
static const uint64_t odd_layer[2] = {16, 9}, odd_head[2] = {5, 16}, no_rows[4] = {1, 4, 0, 6};

static void nan_weight(struct pth *p) { put_nan(p, NET "pos_deform.1.weight"); }
static void nan_plane(struct pth *p) { put_nan(p, NET "grid.grids.1.4"); }
static void nan_box(struct pth *p) { put_nan(p, NET "grid.aabb"); }
static void flat_box(struct pth *p)
{
    struct pth_tensor *t = pth_find(p, NET "grid.aabb");

    t->values[4] = t->values[1];
}
static void three_planes(struct pth *p)
{
    for (int i = 3; i < 6; i++) {
        char name[60];

        snprintf(name, sizeof name, NET "grid.grids.1.%d", i);
        pth_drop(p, name);
    }
}
static void wide_plane(struct pth *p) { pth_put(p, NET "grid.grids.0.3", 4, odd_plane); }
static void many_channels(struct pth *p) { pth_put(p, NET "grid.grids.0.2", 4, odd_channels); }
static void empty_plane(struct pth *p) { pth_put(p, NET "grid.grids.0.0", 4, no_rows); }
static void wide_input(struct pth *p) { pth_put(p, NET "feature_out.0.weight", 2, odd_layer); }
static void wide_head(struct pth *p) { pth_put(p, NET "pos_deform.3.weight", 2, odd_head); }
static void no_head(struct pth *p) { pth_drop(p, NET "shs_deform.1.weight"); }
static void no_bias(struct pth *p) { pth_drop(p, NET "feature_out.0.bias"); }
static void no_box(struct pth *p) { pth_drop(p, NET "grid.aabb"); }
static void no_planes(struct pth *p) { pth_drop(p, NET "grid.grids.0.0"); }
static void of_ed3dgs(struct pth *p)
{
    no_planes(p);
    pth_put(p, "feature_out_c.0.weight", 2, odd_layer);
}
static void two_dicts(struct pth *p) { p->pair = true; }

static void test_lies(const char *root)
{
    static const struct {
        void (*change)(struct pth *);
        const char *word, *what;
    } lies[] = {
        {nan_weight, "pos_deform.1.weight", "NaN in a layer"},
        {nan_plane, "grids.1.4", "NaN in a plane"},
        {nan_box, "aabb", "NaN in the box"},
        {flat_box, "along y", "a box without extent"},
        {three_planes, "has 3 planes", "planes without time"},
        {wide_plane, "along y", "planes that contradict each other"},
        {many_channels, "grids.0.2", "planes of different channels"},
        {empty_plane, "along y", "a plane without rows"},
        {wide_input, "9 features", "a first layer that does not fit the planes"},
        {wide_head, "pos_deform.3.weight", "a head with too many outputs"},
        {no_head, "shs_deform.1.weight", "a head that is needed and not there"},
        {no_bias, "feature_out.0.bias", "a layer without bias"},
        {no_box, "aabb", "no box"},
        {no_planes, "grids.0.0", "no planes"},
        {of_ed3dgs, "E-D3DGS", "a network of E-D3DGS"},
        {two_dicts, "not a state dict", "a pair instead of a state dict"},
    };
    const char *folder = path_in(root, "coarse_and_fine"), *model, *save;
    const char *word[] = {"grid-pe", "x", NULL};

    for (size_t i = 0; i < sizeof lies / sizeof *lies; i++)
        test_change(folder, lies[i].change, lies[i].word, lies[i].what);

    model = make_model(folder, NULL, "Namespace(no_dx=Perhaps)");
    model_fails("4dgaussian", model, NULL, "cfg_args", "no_dx", "a flag that is neither");
    model = make_model(folder, NULL, "Namespace(no_dx=False, a=[1, 2");
    model_fails("4dgaussian", model, NULL, "cfg_args", "cut short", "cfg_args cut short");
    model = make_model(folder, NULL, "Namespace(grid_pe=3)");
    model_fails("4dgaussian", model, word, "--grid-pe", "expected", "--grid-pe of a word");
    model = make_model(folder, NULL, "{}");
    model_fails("4dgaussian", model, NULL, "cfg_args", "Namespace", "cfg_args of another kind");
    model = make_model(folder, NULL, NULL);
    save = path_in(model, "point_cloud/iteration_7");
    cut_file("4dgaussian", model, save, "deformation.pth", "no truncation of the network is read");
    cut_file("4dgaussian", model, save, "point_cloud.ply", "no truncation of the cloud is read");
    unlink(path_in(save, "deformation.pth"));
    model_fails("4dgaussian", model, NULL, model, "deformation.pth", "no network");
    write_text(path_in(save, "deformation_GAD.pth"), "");
    model_fails("4dgaussian", model, NULL, model, "MoDec-GS", "a run of MoDec-GS");
    model_fails("4dgaussian", save, NULL, save, "MoDec-GS", "the folder of its save");
    model = new_folder();
    if (spin_folder_make(path_in(model, "point_cloud/coarse_iteration_3000")) != SPIN_OK)
        exit(1);
    model_fails("4dgaussian", model, NULL, model, "coarse stage",
                "a run cut off in its first stage");
    model_fails("4dgaussian", path_in(path_in(root, "coarse_and_fine"), "manifest.json"), NULL,
                "manifest.json", "is neither the model's folder", "a file of another kind");
    model_fails("4dgaussian", "no/such/model", NULL, "no/such/model", "", "no such path");
}

/* Every bad checkpoint that the reader of the container is tested with, in place of a network. */
static void test_containers(const char *root)
{
    const char *bad = check_fixture("torch_container/malformed"), *folder, *model, *to;
    char **names = NULL;
    size_t n = 0;

    if (!bad || spin_folder_list(bad, &names, &n) != SPIN_OK) {
        skip("malformed containers", "there are none here");
        return;
    }
    folder = path_in(root, "coarse_and_fine");
    model = make_model(folder, NULL, NULL);
    to = path_in(model, "point_cloud/iteration_7/deformation.pth");
    for (size_t i = 0; i < n; i++) {
        if (!strstr(names[i], ".pth"))
            continue;
        copy_file(path_in(bad, names[i]), to);
        model_fails("4dgaussian", model, NULL, "deformation.pth", "", names[i]);
    }
    spin_folder_list_free(names);
}

TAP_MAIN
{
    const char *root = check_fixture("4dgaussian");
    char **names = NULL;
    size_t n = 0;

    spin_log_set_level(-2);
    if (!root || spin_folder_list(root, &names, &n) != SPIN_OK) {
        skip("4dgaussian fixtures", "there are none here");
        return;
    }
    for (size_t i = 0; i < n; i++)
        test_fixture(path_in(root, names[i]), names[i]);
    spin_folder_list_free(names);
    if (has(root, "dynerf_like"))
        test_official(root);
    if (has(root, "flags_no_ds_no_dr") && has(root, "options_static_rot_pe"))
        test_options(root);
    test_voxels(root);
    test_prefix_and_threads(root);
    test_lies(root);
    test_containers(root);
}
