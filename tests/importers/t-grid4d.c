/* grid4d: every fixture at all its times, settings from cfg_args or options, and files that lie.
 * K: grid4d import threads */
#include "tests/importers/hashfields.h"

static void test_fixture(const char *folder, const char *name)
{
    const struct spin_importer *found = NULL;
    const char *network = hash_network_of(folder);

    compare_hash_model("grid4d", path_in(folder, "model"), NULL, folder, name);
    ok(spin_importer_find(network, NULL, false, &found) == SPIN_OK &&
           !strcmp(found->name, "grid4d") && read_all(NULL, network) == SPIN_OK,
       "%s: the checkpoint alone is recognised and read", name);
    ok(spin_importer_find(path_in(folder, "model"), NULL, false, &found) == SPIN_OK &&
           !strcmp(found->name, "grid4d"),
       "%s: so is the model's folder", name);
}

static void test_options(const char *root)
{
    const char *folder = path_in(root, "bound30_dim4");
    const char *all[] = {"bound", "30", "scale-xyz", "1.5,0.5,1", "directional", "false", NULL};
    const char *bad[] = {"directional", "up", NULL};
    const char *best[] = {"iteration", "best", NULL};

    if (has(root, "bound30_dim4"))
        compare_hash_model("grid4d", make_hash_model(folder, NULL, ""), all, folder,
                           "options instead of cfg_args");
    folder = path_in(root, "dnerf_like");
    model_fails("grid4d", path_in(folder, "model"), bad, "--directional", "expected",
                "--directional of a word");
    compare_hash_model("grid4d", path_in(folder, "model"), best, folder, "--iteration best");
}

static const uint64_t odd_table[2] = {5524, 3}, short_table[2] = {5000, 2};
static const uint64_t odd_layer[2] = {48, 13}, odd_warp[2] = {3, 48}, four[1] = {4};

static struct pth_tensor *offsets(struct pth *p) { return pth_find(p, "yzt_encoding.offsets"); }
static void late_offsets(struct pth *p) { offsets(p)->values[0] = 1; }
static void equal_offsets(struct pth *p) { offsets(p)->values[2] = offsets(p)->values[1]; }
static void far_offsets(struct pth *p) { offsets(p)->values[8] += 1; }
static void real_offsets(struct pth *p) { offsets(p)->whole = false; }
static void shorter_table(struct pth *p) { pth_put(p, "yzt_encoding.embeddings", 2, short_table); }
static void three_features(struct pth *p) { pth_put(p, "xzt_encoding.embeddings", 2, odd_table); }
static void wide_layer(struct pth *p) { pth_put(p, "spatial_mlp.0.weight", 2, odd_layer); }
static void narrow_warp(struct pth *p) { pth_put(p, "gaussian_warp.weight", 2, odd_warp); }
static void no_growth(struct pth *p) { pth_drop(p, "xyt_encoding.per_level_scale"); }
static void four_axes(struct pth *p) { pth_put(p, "xyz_encoding.base_resolution", 1, four); }
static void no_scaling(struct pth *p) { pth_drop(p, "gaussian_scaling.bias"); }
static void nan_table(struct pth *p) { pth_find(p, "xyt_encoding.embeddings")->values[100] = NAN; }
static void zero_base(struct pth *p) { pth_find(p, "xyt_encoding.base_resolution")->values[1] = 0; }
static void fast_growth(struct pth *p)
{
    pth_find(p, "xyt_encoding.per_level_scale")->values[2] = 1e6f;
}
static void swapped(struct pth *p)
{
    for (int i = 0; i < p->n; i++)
        p->tensor[i].dict = !p->tensor[i].dict;
}
static void one_dict(struct pth *p)
{
    for (int i = 0; i < p->n; i++)
        p->tensor[i].dict = 0;
    p->pair = false;
}

static const struct hash_lie lies[] = {
    {late_offsets, "begins with 1", "offsets that do not begin at 0"},
    {equal_offsets, "level 1", "a level without rows"},
    {far_offsets, "level 7", "offsets behind the table"},
    {real_offsets, "offsets", "offsets that are not whole numbers"},
    {shorter_table, "yzt_encoding.offsets", "a table that is too short"},
    {three_features, "3 features", "three features a row"},
    {wide_layer, "spatial_mlp.0.weight", "a first layer that does not fit the grid"},
    {narrow_warp, "gaussian_warp.weight", "a head of another method"},
    {no_growth, "xyt_encoding.per_level_scale", "no growth"},
    {four_axes, "xyz_encoding.base_resolution", "resolutions of four axes"},
    {no_scaling, "gaussian_scaling.bias", "a head without bias"},
    {nan_table, "xyt_encoding.embeddings", "NaN in a table"},
    {zero_base, "make no grid", "a resolution of 0"},
    {fast_growth, "make no grid", "levels beyond all bounds"},
    {swapped, "swapped", "a swapped pair"},
    {one_dict, "Deformable-3D-Gaussians", "a single state dict"},
};

TAP_MAIN
{
    const char *root = check_fixture("grid4d"), *dash = check_fixture("dash");
    char **names = NULL;
    size_t n = 0;

    spin_log_set_level(-2);
    if (!root || spin_folder_list(root, &names, &n) != SPIN_OK) {
        skip("grid4d fixtures", "there are none here");
        return;
    }
    for (size_t i = 0; i < n; i++)
        test_fixture(path_in(root, names[i]), names[i]);
    spin_folder_list_free(names);
    test_options(root);
    test_hash_lies("grid4d", path_in(root, "dnerf_like"), lies, sizeof lies / sizeof *lies);
    test_hash_settings("grid4d", path_in(root, "dnerf_like"));
    if (dash)
        model_fails("grid4d", path_in(dash, "default_like/model"), NULL, "deform.pth",
                    "--from dash", "a run of DASH");
}
