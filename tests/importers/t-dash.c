/* dash: static Gaussians, settings from cfg_args or options, and malformed files.
 * K: dash import threads */
#include "tests/importers/hashfields.h"

#define FROM "dash"

static void test_options(const char *fixture)
{
    const char *all[] = {"bound", "1", "scale-xyz", "1", NULL};
    const char *best[] = {"iteration", "best", NULL}, *model = path_in(fixture, "model");

    golden_as(FROM, with_settings(model, ""), all, fixture, 0, "options instead of cfg_args");
    golden_as(FROM, model, best, fixture, 0, "--iteration best");
}

/* Static Gaussians keep all digits. */
static void test_static(const char *folder)
{
    struct spin_splats early = {0}, late = {0};
    struct spin_array info;
    struct spin_npz npz;
    struct run run;
    double *dynamic;
    size_t n_still = 0, n_same = 0, n_moved = 0;

    if (spin_npz_open(path_in(folder, "expected.npz"), &npz) != SPIN_OK ||
        run_open(FROM, path_in(folder, "model"), &run) != SPIN_OK)
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

static const struct lie lies[] = {
    {NETWORK, "set xyzt_encoding.offsets 3 1", "level 2", "offsets that go back"},
    {NETWORK, "put gaussian_warp.weight 7 48", "gaussian_warp.weight", "a head of another method"},
    {NETWORK, "put d4_mlp.0.weight 48 17", "d4_mlp.0.weight",
     "a first layer that does not fit the grid"},
    {NETWORK, "put xyzt_encoding.per_level_scale 3", "xyzt_encoding.per_level_scale",
     "growth of three axes"},
    {NETWORK, "drop xyzt_encoding.embeddings", "xyzt_encoding.embeddings", "no table"},
    {NETWORK, "set xyzt_encoding.embeddings 7 nan", "xyzt_encoding.embeddings", "NaN in the table"},
    {NETWORK, "swap", "swapped", "a swapped pair"},
};

TAP_MAIN
{
    const char *root = check_fixture(FROM), *grid4d = check_fixture("grid4d"), *fixture, *model;

    spin_log_set_level(-2);
    if (!root) {
        skip("dash fixtures", "there are none here");
        return;
    }
    fixture = path_in(root, "default_like");
    model = path_in(fixture, "model");
    PART(test_options, fixture);
    PART(test_static, fixture);
    PART(refuse_lies, FROM, model, NULL, lies, sizeof lies / sizeof *lies);
    PART(test_hash_settings, FROM, model);
    if (!grid4d)
        return;
    model_fails(FROM, path_in(grid4d, "dnerf_like/model"), NULL, "deform.pth", "--from grid4d",
                "a run of Grid4D");
    model = copy_of(model);
    copy_file(golden_path(path_in(grid4d, "dnerf_like/model"), CLOUD), golden_path(model, CLOUD));
    model_fails(FROM, model, NULL, "point_cloud.ply", "'dynamic'", "a cloud without 'dynamic'");
}
