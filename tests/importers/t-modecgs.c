/* modecgs: positions of the fixture at all its times, of all offsets and of those that a camera
 * sees, and files that lie. K: modecgs import threads */
#include "tests/importers/clouds.h"

static const char *save_path = "model/point_cloud/iteration_14000";

/* The rows of an expected array of [T][n][3] that `keep` [T][n] marks; all when it is NULL. */
static size_t pick_rows(const double *want, const double *keep, size_t t, size_t n, double *out)
{
    size_t kept = 0;

    for (size_t i = 0; i < n; i++) {
        if (!keep || keep[t * n + i] > 0)
            memcpy(out + 3 * kept++, want + 3 * (t * n + i), 3 * sizeof *out);
    }
    return kept;
}

static void compare_model(const char *path, const char *const *pairs, const char *folder,
                          bool camera, const char *name)
{
    struct spin_array info, times_info;
    struct spin_splats s = {0};
    struct spin_npz npz;
    struct run run;
    double *times, *want, *keep, *rows;
    size_t n;

    bounds_of = folder;
    if (!ok(model_open("modecgs", path, pairs, &run) == SPIN_OK, "%s: opens", name)) {
        printf("#   %s\n", spin_last_error());
        return;
    }
    ok(run.sequence.continuous && run.sequence.columns == SPIN_COL_MEANS &&
           strstr(run.sequence.notes, "positions only"),
       "%s: has positions only, and says so", name);
    if (spin_npz_open(path_in(folder, "expected.npz"), &npz) != SPIN_OK)
        exit(1);
    times = check_load(&npz, "times", &times_info);
    keep = check_load(&npz, "keep", &info);
    want = check_load(&npz, "centre", &info);
    if (!times || !keep || !want)
        exit(1);
    n = info.shape[1];
    rows = malloc(3 * n * sizeof *rows);
    for (size_t t = 0; t < times_info.count; t++) {
        size_t kept = pick_rows(want, camera ? keep : NULL, t, n, rows);
        char what[200];

        snprintf(what, sizeof what, "%s, time %g: %zu centres", name, times[t], kept);
        if (ok(run.importer->frame(run.self, 0, times[t], run.sequence.columns, &s) == SPIN_OK &&
                   s.n == kept,
               "%s are read", what))
            check_close(s.means, rows, 3 * kept, bound("centre").abs, 0, what);
        else
            printf("#   %s\n", spin_last_error());
    }
    free(rows);
    free(times);
    free(keep);
    free(want);
    spin_splats_free(&s);
    spin_npz_close(&npz);
    run_close(&run);
}

/* A copy of the fixture. */
static const char *make_model(const char *folder)
{
    const char *from = path_in(folder, save_path), *model = new_folder();
    const char *to = path_in(model, "point_cloud/iteration_14000");
    char **names = NULL;
    size_t n = 0;

    if (spin_folder_make(to) != SPIN_OK || spin_folder_list(from, &names, &n) != SPIN_OK)
        exit(1);
    for (size_t i = 0; i < n; i++)
        copy_file(path_in(from, names[i]), path_in(to, names[i]));
    copy_file(path_in(folder, "model/cfg_args"), path_in(model, "cfg_args"));
    spin_folder_list_free(names);
    return model;
}

static const char *seen[] = {"camera", "0.3,-2.5,0.8", NULL};

static void test_network(const char *folder, const char *file, const char *tensor, bool nan,
                         const char *what)
{
    const char *model = make_model(folder);
    const char *path = path_in(path_in(model, "point_cloud/iteration_14000"), file);
    struct pth pth;

    pth_load(path, &pth);
    if (nan)
        pth_find(&pth, tensor)->values[0] = NAN;
    else
        pth_drop(&pth, tensor);
    pth_save(&pth, path);
    pth_free(&pth);
    model_fails("modecgs", model, NULL, file, tensor, what);
}

/* cfg_args with one word of it replaced. */
static void test_setting(const char *folder, const char *word, const char *by, const char *in,
                         const char *what)
{
    const char *model = make_model(folder), *path = path_in(model, "cfg_args");

    replace_text(path, word, by);
    model_fails("modecgs", model, seen, "cfg_args", in, what);
}

static void test_lies(const char *folder)
{
    const char *far[] = {"camera", "1,2", NULL}, *model = make_model(folder);
    const char *save = path_in(model, "point_cloud/iteration_14000"), *other;
    struct run run;

    test_network(folder, "deformation_GAD.pth", "deformation_net.feature_deform.3.bias", false,
                 "a head of the first network without bias");
    test_network(folder, "deformation_GAD.pth", "deformation_net.grid.grids.0.0", false,
                 "a first network without planes");
    test_network(folder, "deformation_LGD.pth", "deformation_net.pos_deform.1.weight", false,
                 "a second network that moves nothing");
    test_network(folder, "deformation_LGD.pth", "deformation_net.grid.aabb", true,
                 "NaN in the second network");
    test_setting(folder, "GLMD=True", "GLMD=False", "GLMD", "a run without GLMD");
    test_setting(folder, "'explicit'", "'implicit'", "LGD_method", "a run with an implicit LGD");
    test_setting(folder, "'mul'", "'sum'", "anchor_dynamics_local_type",
                 "an unknown kind of dynamics");
    test_setting(folder, "anchor_dynamics_offset=True, ", "", "anchor_dynamics_offset",
                 "a flag that is missing");
    test_setting(folder, "use_feat_bank=False", "use_feat_bank=True", "use_feat_bank",
                 "a feature bank, with --camera");
    model_fails("modecgs", model, far, "--camera", "X,Y,Z", "--camera of two numbers");
    cut_file("modecgs", model, save, "deformation_GAD.pth", "no truncation of the first network");
    cut_file("modecgs", model, save, "deformation_LGD.pth", "no truncation of the second network");
    cut_file("modecgs", model, save, "point_cloud.ply", "no truncation of the anchors");
    write_text(path_in(save, "opacity_mlp.pt"), "PK\003\004");
    model_fails("modecgs", model, seen, "opacity_mlp.pt", "", "opacities that are no archive");
    copy_file(path_in(path_in(folder, save_path), "cov_mlp.pt"), path_in(save, "opacity_mlp.pt"));
    model_fails("modecgs", model, seen, "opacity_mlp.pt", "data/2", "layers of another network");
    ok(run_open("modecgs", model, &run) == SPIN_OK, "which does not matter without --camera");
    run_close(&run);
    unlink(path_in(save, "canonical_times.npy"));
    ok(run_open("modecgs", model, &run) == SPIN_OK && strstr(run.sequence.variant, "4 segments"),
       "even segments without canonical_times.npy");
    run_close(&run);
    write_text(path_in(save, "canonical_times.npy"), "x");
    model_fails("modecgs", model, NULL, "canonical_times.npy", "", "times that are no array");
    unlink(path_in(save, "canonical_times.npy"));
    unlink(path_in(model, "cfg_args"));
    model_fails("modecgs", model, NULL, NULL, "no cfg_args", "no cfg_args");
    other = check_fixture("4dgaussian/coarse_and_fine/model");
    if (other)
        model_fails("modecgs", other, NULL, other, "4DGaussians", "a run of 4DGaussians");
}

TAP_MAIN
{
    const char *folder = check_fixture("modecgs/default_like"), *model;
    const struct spin_importer *found = NULL;

    spin_log_set_level(-2);
    if (!folder) {
        skip("modecgs fixtures", "there are none here");
        return;
    }
    model = path_in(folder, "model");
    compare_model(model, NULL, folder, false, "all offsets");
    compare_model(model, seen, folder, true, "those that a camera sees");
    ok(spin_importer_find(path_in(folder, save_path), NULL, false, &found) == SPIN_OK &&
           !strcmp(found->name, "modecgs"),
       "the folder of the save is recognised");
    ok(spin_importer_find(model, NULL, false, &found) == SPIN_OK && !strcmp(found->name, "modecgs"),
       "so is the model's");
    test_lies(folder);
}
