/* deformable3dgs: saves of different iterations, MotionGS recognised by cfg_args, and malformed
 * networks.
 * K: deformable3dgs motiongs import threads */
#include "tests/importers/edits.h"

#define FROM "deformable3dgs"
#define CLOUD "point_cloud/*/point_cloud.ply"
#define NETWORK "deform/*/deform.pth"

/* A model's cloud and network, saved at these iterations (0: not at all), with this cfg_args or
 * none. */
static const char *make_model(const char *model, int cloud_at, int network_at, const char *cfg)
{
    static const char *const file[] = {CLOUD, NETWORK};
    const char *copy = new_folder();
    const int at[] = {cloud_at, network_at};

    for (int i = 0; i < 2; i++) {
        char to[64];

        snprintf(to, sizeof to, "%.*s/iteration_%d", (int)strcspn(file[i], "/"), file[i], at[i]);
        if (at[i] && spin_folder_make(path_in(copy, to)) != SPIN_OK)
            exit(1);
        if (at[i])
            copy_file(golden_path(model, file[i]),
                      path_in(path_in(copy, to), spin_path_name(file[i])));
    }
    if (cfg)
        write_text(path_in(copy, "cfg_args"), cfg);
    return copy;
}

static void test_saves(const char *fixture)
{
    const char *const seven[] = {"iteration", "7000", NULL}, *const five[] = {"iteration", "5",
                                                                              NULL};
    const char *model = make_model(fixture, 7000, 7000, NULL);
    const struct spin_importer *found = NULL;
    struct run run;

    ok(spin_importer_find(model, NULL, false, &found) == SPIN_E_NOT_RECOGNISED &&
           strstr(spin_last_error(), FROM),
       "a model without cfg_args may be of another method: %s", spin_last_error());
    ok(read_all(FROM, model) == SPIN_OK, "it is read when named");

    copy_folder_to(path_in(model, "point_cloud/iteration_7000"),
                   path_in(model, "point_cloud/iteration_10000"));
    model_fails(FROM, model, NULL, "iteration_10000", "--iteration",
                "a cloud newer than the network is not paired silently");
    ok(model_open(FROM, model, seven, &run) == SPIN_OK && run.sequence.time_first == 0 &&
           run.sequence.time_last == 1,
       "but read when asked for, with times in 0..1");
    run_close(&run);
    model_fails(FROM, model, five, NULL, "iteration_5", "a save that is not there");
    copy_folder_to(path_in(model, "deform/iteration_7000"),
                   path_in(model, "deform/iteration_10000"));
    ok(model_open(FROM, model, NULL, &run) == SPIN_OK &&
           strstr(run.sequence.variant, "iteration_10000"),
       "the largest number counts, not the first by name");
    run_close(&run);
    model_fails(FROM, make_model(fixture, 7000, 8000, NULL), NULL, NULL, "no iteration has both",
                "saves of different iterations");
    model_fails(FROM, make_model(fixture, 7000, 0, NULL), NULL, NULL, "'deform'", "no networks");
    model_fails(FROM, make_model(fixture, 0, 7000, NULL), NULL, NULL, "'point_cloud'", "no clouds");
    model_fails(FROM, golden_path(fixture, CLOUD), NULL, NULL, "is neither the model's folder",
                "a cloud alone is not a model");
    ok(model_open(FROM, make_model(fixture, 2000, 2000, NULL), NULL, &run) == SPIN_OK &&
           strstr(run.sequence.notes, "before iteration 3000"),
       "a save of the warm-up says so");
    run_close(&run);
    ok(model_open(FROM, make_model(fixture, 9000, 9000, "Namespace(is_6dof=True, sh_degree=3)"),
                  NULL, &run) == SPIN_OK &&
           strstr(run.sequence.notes, "is_6dof=True"),
       "a cfg_args that disagrees is noted, and does not count");
    run_close(&run);
}

/* Only cfg_args identifies MotionGS. */
static void test_motiongs(const char *fixture)
{
    static const struct {
        const char *cfg;
        double last;
        const char *said, *not_said;
    } cases[] = {
        {"is_6dof=False, use_depth_and_flow=True, optimize_pose=False, "
         "scene_format='plenopticVideo'",
         10, "times are seconds", "cameras"},
        {"use_depth_and_flow=False, optimize_pose=True, scene_format='nerfies'", 1,
         "moved the cameras", "may be seconds"},
        {"use_depth_and_flow=True, scene_format=''", 1, "scene_format='': times are those of",
         "cameras"},
        {"optimize_pose=False, scene_format='blender'", 1,
         "scene_format='blender': times are those of", "cameras"},
    };
    const char *odd = "Namespace(use_depth_and_flow=True, optimize_pose=7x, sh_degree=3)";
    struct run run;

    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        char cfg[200];
        bool good;

        snprintf(cfg, sizeof cfg, "Namespace(sh_degree=3, %s)", cases[i].cfg);
        good = model_open(FROM, make_model(fixture, 9000, 9000, cfg), NULL, &run) == SPIN_OK;
        ok(good && strncmp(run.sequence.variant, "MotionGS,", 9) == 0 &&
               run.sequence.time_last == cases[i].last &&
               run.sequence.half_open == (cases[i].last != 1) &&
               strstr(run.sequence.notes, cases[i].said) &&
               !strstr(run.sequence.notes, cases[i].not_said),
           "MotionGS with %s", cases[i].cfg);
        if (!good)
            printf("#   %s\n", spin_last_error());
        run_close(&run);
    }
    model_fails(FROM, make_model(fixture, 9000, 9000, odd), NULL, "cfg_args",
                "'optimize_pose' is '7x'", "an option of MotionGS that is no bool");
}

static void test_networks(const char *model)
{
    static const struct lie lies[] = {
        {NETWORK, "drop linear.3.weight", "linear.3.weight", "a layer missing in the list"},
        {NETWORK, "drop linear.3.bias", "linear.3.bias", "a layer without a bias"},
        {NETWORK, "drop gaussian_scaling.weight", "gaussian_scaling.weight",
         "a head that is missing"},
        {NETWORK, "drop gaussian_warp.weight", "gaussian_warp", "neither kind of motion"},
        {NETWORK, "put branch_w.weight 3 32; put branch_w.bias 3", "branch_w",
         "both kinds of motion"},
        {NETWORK, "put linear.6.weight 32 116", "an earlier layer has the skip connection",
         "two wide layers"},
        {NETWORK, "put linear.2.weight 32 31", "linear.2.weight",
         "a chain of widths that is broken"},
        {NETWORK, "put linear.0.weight 32 85", "linear", "an even number of time inputs"},
        {NETWORK, "put linear.0.weight 32 63", "linear", "no time inputs"},
        {NETWORK, "put gaussian_opacity.weight 3 32", "gaussian_opacity.weight",
         "a head that this method does not have"},
        {NETWORK, "set linear.1.weight 5 nan", "not finite", "NaN in a layer"},
        {NETWORK, "pair", "grid4d", "a pair of dicts"},
    };
    const char *far = "set gaussian_warp.bias 0 3e38; set gaussian_warp.weight 0 3e38";

    ok(read_all(FROM, edited(model, NETWORK, "")) == SPIN_OK, "a copy of the network is read");
    refuse_lies(FROM, model, NULL, lies, sizeof lies / sizeof *lies);
    fails(FROM, edited(model, NETWORK, far), "not finite",
          "a network that leaves the floats is an error, not NaN in the result");
    refuse_cuts(FROM, model, NULL, NETWORK);
    refuse_cuts(FROM, model, NULL, CLOUD);
}

/* A screw of whole turns, without way, moves by a constant of the method along its axis, for each
 * turn again. */
static void test_whole_turns(const char *model)
{
    struct spin_splats s = {0};
    struct run run;
    double z[2] = {0};

    for (int i = 0; i < 2; i++) {
        char edits[300];

        snprintf(edits, sizeof edits,
                 "drop gaussian_warp.weight; drop gaussian_warp.bias; put branch_w.weight 3 32; "
                 "put branch_v.weight 3 32; put branch_v.bias 3; put branch_w.bias 3; "
                 "set branch_w.bias 2 %.9g",
                 200 * M_PI * (i + 1));
        if (ok(run_open(FROM, edited(model, NETWORK, edits), &run) == SPIN_OK &&
                   run.importer->frame(run.self, 0, 0.5, SPIN_COL_MEANS, &s) == SPIN_OK,
               "%d00 whole turns are read", i + 1))
            z[i] = (double)s.means[2];
        run_close(&run);
    }
    near(z[1] - z[0], 2e-3 * M_PI, 1e-5, "a hundred turns more are 2 pi / 1000");
    spin_splats_free(&s);
}

TAP_MAIN
{
    const char *root = check_fixture(FROM), *model;

    spin_log_set_level(-2);
    if (!root) {
        skip("deformable3dgs fixtures", "there are none here");
        return;
    }
    model = path_in(root, "real_small/model");
    PART(test_saves, model);
    PART(test_motiongs, model);
    PART(test_networks, model);
    PART(test_whole_turns, model);
    if (has(root, "sixdof_small"))
        fails(FROM,
              edited(path_in(root, "sixdof_small/model"), NETWORK,
                     "set branch_w.weight * 0; set branch_w.bias * 0"),
              "positions", "a screw of length 0 is refused: it has no direction");
}
