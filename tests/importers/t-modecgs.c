/* modecgs: malformed files, and those that may be missing.
 * K: modecgs import threads */
#include "tests/importers/edits.h"

#define FROM "modecgs"
#define SAVE "point_cloud/*"

static const char *seen[] = {"camera", "0.3,-2.5,0.8", NULL};

static void test_lies(const char *original)
{
    static const struct lie lies[] = {
        {SAVE "/deformation_GAD.pth", "drop deformation_net.feature_deform.3.bias",
         "deformation_net.feature_deform.3.bias", "a head of the first network without bias"},
        {SAVE "/deformation_GAD.pth", "drop deformation_net.grid.grids.0.0",
         "deformation_net.grid.grids.0.0", "a first network without planes"},
        {SAVE "/deformation_LGD.pth", "drop deformation_net.pos_deform.1.weight",
         "deformation_net.pos_deform.1.weight", "a second network that moves nothing"},
        {SAVE "/deformation_LGD.pth", "set deformation_net.grid.aabb 0 nan",
         "deformation_net.grid.aabb", "NaN in the second network"},
    };
    static const struct lie settings[] = {
        {"cfg_args", "text GLMD=True=>GLMD=False", "GLMD", "a run without GLMD"},
        {"cfg_args", "text 'explicit'=>'implicit'", "LGD_method", "a run with an implicit LGD"},
        {"cfg_args", "text 'mul'=>'sum'", "anchor_dynamics_local_type",
         "an unknown kind of dynamics"},
        {"cfg_args", "text anchor_dynamics_offset=True, =>", "anchor_dynamics_offset",
         "a flag that is missing"},
        {"cfg_args", "text use_feat_bank=False=>use_feat_bank=True", "use_feat_bank",
         "a feature bank, with --camera"},
    };
    const char *far[] = {"camera", "1,2", NULL}, *model = copy_of(original);
    const char *save = golden_path(model, SAVE), *other;
    struct run run;

    refuse_lies(FROM, original, NULL, lies, sizeof lies / sizeof *lies);
    refuse_lies(FROM, original, seen, settings, sizeof settings / sizeof *settings);
    model_fails(FROM, model, far, "--camera", "X,Y,Z", "--camera of two numbers");
    refuse_cuts(FROM, model, NULL, SAVE "/deformation_GAD.pth");
    refuse_cuts(FROM, model, NULL, SAVE "/deformation_LGD.pth");
    refuse_cuts(FROM, model, NULL, SAVE "/point_cloud.ply");
    write_text(path_in(save, "opacity_mlp.pt"), "PK\003\004");
    model_fails(FROM, model, seen, "opacity_mlp.pt", "", "opacities that are no archive");
    copy_file(path_in(save, "cov_mlp.pt"), path_in(save, "opacity_mlp.pt"));
    model_fails(FROM, model, seen, "opacity_mlp.pt", "data/2", "layers of another network");
    ok(run_open(FROM, model, &run) == SPIN_OK, "which does not matter without --camera");
    run_close(&run);
    unlink(path_in(save, "canonical_times.npy"));
    ok(run_open(FROM, model, &run) == SPIN_OK && strstr(run.sequence.variant, "4 segments"),
       "even segments without canonical_times.npy");
    run_close(&run);
    write_text(path_in(save, "canonical_times.npy"), "x");
    model_fails(FROM, model, NULL, "canonical_times.npy", "", "times that are no array");
    unlink(path_in(save, "canonical_times.npy"));
    unlink(path_in(model, "cfg_args"));
    model_fails(FROM, model, NULL, NULL, "no cfg_args", "no cfg_args");
    other = check_fixture("4dgaussian/coarse_and_fine/model");
    if (other)
        model_fails(FROM, other, NULL, other, "4DGaussians", "is of 4DGaussians");
}

TAP_MAIN
{
    const char *model = check_fixture("modecgs/default_like/model");

    spin_log_set_level(-2);
    if (!model)
        skip("modecgs fixtures", "there are none here");
    else
        test_lies(model);
}
