/* scgs: the checkpoint, cfg_args, skinning, and malformed files. t-golden.c compares the values,
 * t-variants.c reads altered files.
 * K: scgs import */
#include "tests/importers/edits.h"

#define FROM "scgs"
#define CLOUD "point_cloud/*/point_cloud.ply"
#define NETWORK "deform/*/deform.pth"

static void test_settings(const char *model)
{
    const char *copy = copy_of(model), *config = path_in(new_folder(), "args");
    struct run run;

    copy_file(path_in(copy, "cfg_args"), config);
    remove(path_in(copy, "cfg_args"));
    model_fails(FROM, copy, NULL, copy, "--cfg-args", "no cfg_args");
    ok(model_open(FROM, copy, (const char *[]){"cfg-args", config, NULL}, &run) == SPIN_OK &&
           strstr(run.sequence.variant, "48 nodes"),
       "one that is given");
    run_close(&run);
    model_fails(FROM, model, (const char *[]){"iteration", "7", NULL}, model, "iteration_7",
                "a checkpoint that does not exist");
    copy = edited(model, "cfg_args", "text is_scene_static=False=>is_scene_static=True");
    ok(run_open(NULL, copy, &run) == SPIN_OK && run.sequence.n_frames == 1 &&
           !run.sequence.continuous &&
           run.sequence.static_columns == (SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES),
       "a static scene is one frame");
    run_close(&run);
}

/* Skinning: the features of a Gaussian are the logits of all nodes. With the first far above the
 * others, all Gaussians follow the first node, and the mean is its displacement. */
static void test_skinning(const char *model)
{
    char edits[4000] = "", *end = edits;
    const char *copy = edited(model, "cfg_args",
                              "text skinning=False=>skinning=True; "
                              "text gs_with_motion_mask=True=>gs_with_motion_mask=False");
    struct spin_splats s = {0};
    struct run run;
    bool rigid = true;

    end += sprintf(end, "set fea_0 * 200; set fea_1 * 0");
    for (int i = 3; i < 48; i++)
        end += sprintf(end, "; put fea_%d", i);
    edit_file(golden_path(copy, CLOUD), edits);
    edit_file(golden_path(copy, NETWORK), "drop _node_radius; put nodes 48 3");
    if (!ok(run_open(NULL, copy, &run) == SPIN_OK &&
                run.importer->frame(run.self, 0, 0.5, run.sequence.columns, &s) == SPIN_OK,
            "skinning is read")) {
        printf("# %s\n", spin_last_error());
        return;
    }
    for (size_t i = 1; i < s.n && i < 20; i++) {
        struct cloud cloud;

        cloud_load(golden_path(copy, CLOUD), &cloud);
        rigid =
            rigid &&
            fabs((double)s.means[3 * i] - (double)s.means[0] -
                 ((double)cloud_find(&cloud, "x")[i] - (double)cloud_find(&cloud, "x")[0])) < 1e-5;
        cloud_free(&cloud);
    }
    ok(rigid, "all Gaussians follow the node of the largest feature");
    run_close(&run);
    spin_splats_free(&s);
}

static void test_lies(const char *model)
{
    static const struct lie lies[] = {
        {"cfg_args", "text K=4=>K=2.5", "K is 2.5", "half a node"},
        {"cfg_args", "text hyper_dim=2=>hyper_dim=-1", "hyper_dim is -1", "-1 dimensions"},
        {"cfg_args", "text hash_time=False=>hash_time=True", "hash_time", "a hash of times"},
        {CLOUD, "drop fea_2", "2 properties fea_*", "no mask"},
        {CLOUD, "put fea_3", "4 properties fea_*", "a feature too many"},
        {CLOUD, "drop rot_1", "rot_1", "three numbers of a rotation"},
        {NETWORK, "put nodes 0 5", "0 nodes", "no nodes"},
        {NETWORK, "drop nodes", "'nodes'", "no tensor of nodes"},
        {NETWORK, "put _node_radius 47", "_node_radius", "a radius too few"},
        {NETWORK, "drop network.gaussian_warp.weight", "gaussian_warp", "no head of positions"},
        {NETWORK, "put network.gaussian_rotation.weight 3 32", "gaussian_rotation",
         "three outputs of a rotation"},
        {NETWORK, "put network.other.weight 3 3", "network.other.weight", "a derived method"},
        {NETWORK, "drop network.linear.7.weight", "linear.7", "a layer that is missing"},
    };

    model_fails(FROM, edited(model, "cfg_args", "text skinning=False=>skinning=True"), NULL,
                "deform.pth", "[*, 3]", "skinning by nodes with more coordinates");
    model_fails(FROM, edited(model, "cfg_args", "text hyper_dim=2, =>"), NULL, "point_cloud.ply",
                "expected 9, for hyper_dim=8", "no hyper_dim, which is 8 by default");
    refuse_lies(FROM, model, NULL, lies, sizeof lies / sizeof *lies);
    refuse_cuts(FROM, model, NULL, NETWORK);
    refuse_cuts(FROM, model, NULL, CLOUD);
}

TAP_MAIN
{
    const char *model = check_fixture("scgs/real_mask_hyper2/model");

    spin_log_set_level(-2);
    if (!model) {
        skip("scgs fixtures", "there are none here");
        return;
    }
    test_settings(model);
    test_skinning(model);
    test_lies(model);
}
