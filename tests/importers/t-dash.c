/* dash: every fixture at all its times, settings from cfg_args or options, and files that lie.
 * K: dash import threads */
#include "tests/importers/hashfields.h"

static void test_fixture(const char *folder, const char *name)
{
    const struct spin_importer *found = NULL;
    const char *network = hash_network_of(folder);

    compare_hash_model("dash", path_in(folder, "model"), NULL, folder, name);
    ok(spin_importer_find(network, NULL, false, &found) == SPIN_OK &&
           !strcmp(found->name, "dash") && read_all(NULL, network) == SPIN_OK,
       "%s: the checkpoint alone is recognised and read", name);
    ok(spin_importer_find(path_in(folder, "model"), NULL, false, &found) == SPIN_OK &&
           !strcmp(found->name, "dash"),
       "%s: so is the model's folder", name);
}

static void test_options(const char *root)
{
    const char *folder = path_in(root, "default_like"), *model = make_hash_model(folder, NULL, "");
    const char *all[] = {"bound", "1", "scale-xyz", "1", NULL};
    const char *best[] = {"iteration", "best", NULL};

    compare_hash_model("dash", model, all, folder, "options instead of cfg_args");
    compare_hash_model("dash", path_in(folder, "model"), best, folder, "--iteration best");
}

/* Static Gaussians keep every digit. */
static void test_static(const char *folder)
{
    struct spin_splats early = {0}, late = {0};
    struct spin_array info;
    struct spin_npz npz;
    struct run run;
    double *dynamic;
    size_t n_still = 0, n_same = 0, n_moved = 0;

    if (spin_npz_open(path_in(folder, "expected.npz"), &npz) != SPIN_OK ||
        run_open("dash", path_in(folder, "model"), &run) != SPIN_OK)
        exit(1);
    dynamic = check_load(&npz, "dynamic", &info);
    run.importer->frame(run.self, 0, 0.1, run.sequence.columns, &early);
    run.importer->frame(run.self, 0, 0.9, run.sequence.columns, &late);
    for (size_t i = 0; dynamic && i < early.n; i++) {
        bool same = !memcmp(early.means + 3 * i, late.means + 3 * i, 3 * sizeof(float)) &&
                    !memcmp(early.quats + 4 * i, late.quats + 4 * i, 4 * sizeof(float)) &&
                    !memcmp(early.log_scales + 3 * i, late.log_scales + 3 * i, 3 * sizeof(float));

        n_still += dynamic[i] == 0;
        n_same += dynamic[i] == 0 && same;
        n_moved += dynamic[i] != 0 && !same;
    }
    ok(n_still > 0 && n_same == n_still && n_moved > 0,
       "static Gaussians are the same at all times, bit for bit, and others move");
    free(dynamic);
    spin_splats_free(&early);
    spin_splats_free(&late);
    spin_npz_close(&npz);
    run_close(&run);
}

static const uint64_t odd_warp[2] = {7, 48}, odd_layer[2] = {48, 17}, three[1] = {3};

static void early_offsets(struct pth *p) { pth_find(p, "xyzt_encoding.offsets")->values[3] = 1; }
static void wide_warp(struct pth *p) { pth_put(p, "gaussian_warp.weight", 2, odd_warp); }
static void wide_layer(struct pth *p) { pth_put(p, "d4_mlp.0.weight", 2, odd_layer); }
static void three_axes(struct pth *p) { pth_put(p, "xyzt_encoding.per_level_scale", 1, three); }
static void no_table(struct pth *p) { pth_drop(p, "xyzt_encoding.embeddings"); }
static void nan_table(struct pth *p) { pth_find(p, "xyzt_encoding.embeddings")->values[7] = NAN; }
static void swapped(struct pth *p)
{
    for (int i = 0; i < p->n; i++)
        p->tensor[i].dict = !p->tensor[i].dict;
}

static const struct hash_lie lies[] = {
    {early_offsets, "level 2", "offsets that go back"},
    {wide_warp, "gaussian_warp.weight", "a head of another method"},
    {wide_layer, "d4_mlp.0.weight", "a first layer that does not fit the grid"},
    {three_axes, "xyzt_encoding.per_level_scale", "growth of three axes"},
    {no_table, "xyzt_encoding.embeddings", "no table"},
    {nan_table, "xyzt_encoding.embeddings", "NaN in the table"},
    {swapped, "swapped", "a swapped pair"},
};

TAP_MAIN
{
    const char *root = check_fixture("dash"), *grid4d = check_fixture("grid4d");
    const char *folder, *model;
    char **names = NULL;
    size_t n = 0;

    spin_log_set_level(-2);
    if (!root || spin_folder_list(root, &names, &n) != SPIN_OK) {
        skip("dash fixtures", "there are none here");
        return;
    }
    for (size_t i = 0; i < n; i++)
        test_fixture(path_in(root, names[i]), names[i]);
    spin_folder_list_free(names);
    folder = path_in(root, "default_like");
    test_options(root);
    test_static(folder);
    test_hash_lies("dash", folder, lies, sizeof lies / sizeof *lies);
    test_hash_settings("dash", folder);
    if (!grid4d)
        return;
    model_fails("dash", path_in(grid4d, "dnerf_like/model"), NULL, "deform.pth", "--from grid4d",
                "a run of Grid4D");
    model = make_hash_model(folder, NULL, NULL);
    copy_file(path_in(grid4d, "dnerf_like/model/point_cloud/iteration_50000/point_cloud.ply"),
              path_in(model, "point_cloud/iteration_7/point_cloud.ply"));
    model_fails("dash", model, NULL, "point_cloud.ply", "'dynamic'", "a cloud without 'dynamic'");
}
