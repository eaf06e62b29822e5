/* grid4d: settings from cfg_args or options, and malformed files.
 * K: grid4d import threads */
#include "importers/lib/run_config.h"
#include "tests/importers/hashfields.h"

#define FROM "grid4d"

static void test_options(const char *root)
{
    const char *all[] = {"bound", "30", "scale-xyz", "1.5,0.5,1", "directional", "false", NULL};
    const char *bad[] = {"directional", "up", NULL}, *best[] = {"iteration", "best", NULL};
    const char *fixture = path_in(root, "bound30_dim4");

    if (has(root, "bound30_dim4"))
        golden_as(FROM, with_settings(path_in(fixture, "model"), ""), all, fixture, 0,
                  "options instead of cfg_args");
    fixture = path_in(root, "dnerf_like");
    model_fails(FROM, path_in(fixture, "model"), bad, "--directional", "expected",
                "--directional of a word");
    golden_as(FROM, path_in(fixture, "model"), best, fixture, 0, "--iteration best");
}

static const struct lie lies[] = {
    {NETWORK, "set yzt_encoding.offsets 0 1", "begins with 1", "offsets that do not begin at 0"},
    {NETWORK, "set yzt_encoding.offsets 2 =1", "level 1", "a level without rows"},
    {NETWORK, "set yzt_encoding.offsets 8 +1", "level 7", "offsets behind the table"},
    {NETWORK, "real yzt_encoding.offsets", "offsets", "offsets that are not whole numbers"},
    {NETWORK, "put yzt_encoding.embeddings 5000 2", "yzt_encoding.offsets",
     "a table that is too short"},
    {NETWORK, "put xzt_encoding.embeddings 5524 3", "3 features", "three features a row"},
    {NETWORK, "put spatial_mlp.0.weight 48 13", "spatial_mlp.0.weight",
     "a first layer that does not fit the grid"},
    {NETWORK, "put gaussian_warp.weight 3 48", "gaussian_warp.weight", "a head of another method"},
    {NETWORK, "drop xyt_encoding.per_level_scale", "xyt_encoding.per_level_scale", "no growth"},
    {NETWORK, "put xyz_encoding.base_resolution 4", "xyz_encoding.base_resolution",
     "resolutions of four axes"},
    {NETWORK, "drop gaussian_scaling.bias", "gaussian_scaling.bias", "a head without bias"},
    {NETWORK, "set xyt_encoding.embeddings 100 nan", "xyt_encoding.embeddings", "NaN in a table"},
    {NETWORK, "set xyt_encoding.base_resolution 1 0", "yield no valid grid", "a resolution of 0"},
    {NETWORK, "set xyt_encoding.per_level_scale 2 1e6", "yield no valid grid",
     "levels beyond all bounds"},
    {NETWORK, "swap", "swapped", "a swapped pair"},
    {NETWORK, "pair", "Deformable 3D Gaussians", "a single state dict"},
};

/* Three numbers of a setting: a list, a tuple, or one number for all. */
static void test_numbers(void)
{
    static const char *const good[] = {"7", "[7, 7,7]", "(7.0,7, 0.7e1)", "(7,7,7,)"};
    static const char *const bad[] = {"",         "x",       "[7,7]", "(7,7,7,7)", "[7 7 7]",
                                      "[7,,7,7]", "(7,7,x)", "[]",    "[",         "7,7,7"};
    int wrong = 0;

    for (size_t i = 0; i < sizeof good / sizeof *good; i++) {
        double v[3] = {0};
        struct cfg_span s = {good[i], good[i] + strlen(good[i])};

        wrong += !spin_cfg_numbers(s, 3, v) || v[0] != 7 || v[1] != 7 || v[2] != 7;
    }
    for (size_t i = 0; i < sizeof bad / sizeof *bad; i++) {
        double v[3];

        wrong += spin_cfg_numbers((struct cfg_span){bad[i], bad[i] + strlen(bad[i])}, 3, v);
    }
    ok(wrong == 0, "three numbers of a setting: %d are read wrong", wrong);
}

TAP_MAIN
{
    test_numbers();
    const char *root = check_fixture(FROM), *dash = check_fixture("dash"), *model;

    spin_log_set_level(-2);
    if (!root) {
        skip("grid4d fixtures", "there are none here");
        return;
    }
    model = path_in(root, "dnerf_like/model");
    PART(test_options, root);
    PART(refuse_lies, FROM, model, NULL, lies, sizeof lies / sizeof *lies);
    PART(test_hash_settings, FROM, model);
    if (dash)
        model_fails(FROM, path_in(dash, "default_like/model"), NULL, "deform.pth", "--from dash",
                    "a run of DASH");
}
