/* 4dgaussian: flags from cfg_args or options, rare networks made here, and malformed files.
 * K: 4dgaussian import threads */
#include "tests/importers/edits.h"

#define FROM "4dgaussian"
#define SAVE "point_cloud/iteration_*"
#define CLOUD SAVE "/point_cloud.ply"
#define NETWORK SAVE "/deformation.pth"

/* The repository's own export: all correct but the opacity, which it forgets to deform. */
static void test_official(const char *root)
{
    const char *folder = path_in(root, "dynerf_like");
    struct spin_splats ours = {0}, theirs = {0};
    struct run run, ply;

    if (run_open(FROM, path_in(folder, "model"), &run) != SPIN_OK ||
        run_open("ply", path_in(folder, "official_export/time_00003.ply"), &ply) != SPIN_OK)
        exit(1);
    run.importer->frame(run.self, 0, 0.81, run.sequence.columns, &ours);
    ply.importer->frame(ply.self, 0, 0, ply.sequence.columns, &theirs);
    if (ok(ours.n == theirs.n, "as many Gaussians as the method's own export")) {
        double worst = 0, moved = 0;

        for (size_t i = 0; i < 3 * ours.n; i++) {
            worst = larger(worst, fabs(ours.means[i] - theirs.means[i]));
            worst = larger(worst, fabs(ours.log_scales[i] - theirs.log_scales[i]));
        }
        for (size_t i = 0; i < 48 * ours.n; i++)
            worst = larger(worst, fabs(ours.sh[i] - theirs.sh[i]));
        for (size_t i = 0; i < ours.n; i++)
            moved = larger(moved, fabs(ours.logit_opacities[i] - theirs.logit_opacities[i]));
        near(worst, 0, 2e-4, "positions, scales and colours are those of the method's own export");
        ok(moved > 1e-3, "opacities are not: it writes the canonical ones");
    }
    run_close(&run);
    run_close(&ply);
    spin_splats_free(&ours);
    spin_splats_free(&theirs);
}

/* ---- Models made here ------------------------------------------------------------------------ */

/* A copy of a fixture's model with this cfg_args; NULL: none. */
static const char *make_model(const char *fixture, const char *cfg)
{
    const char *copy = copy_of(path_in(fixture, "model")), *path = path_in(copy, "cfg_args");

    unlink(path);
    if (cfg)
        write_text(path, cfg);
    return copy;
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
    const char *model = make_model(folder, NULL), *pe;
    struct run run;

    golden_as(FROM, model, flags, folder, 0, "--deform instead of cfg_args");
    golden_as(FROM, make_model(folder, "Namespace(grid_pe=3)"), flags, folder, 0,
              "--deform before cfg_args");
    if (ok(run_open(FROM, model, &run) == SPIN_OK, "opens without cfg_args")) {
        ok(strstr(run.sequence.notes, "no cfg_args") != NULL &&
               strstr(run.sequence.notes, "appear to be trained: position opacity\n") != NULL,
           "notes what it assumed and which weights look trained");
        run_close(&run);
    }
    folder = path_in(root, "options_static_rot_pe");
    pe = make_model(folder, NULL);
    golden_as(FROM, pe, all, folder, 0, "all options instead of cfg_args");
    golden_as(FROM, make_model(folder, "Namespace(grid_pe=3)"), all, folder, 0,
              "--grid-pe before cfg_args");
    model_fails(FROM, pe, NULL, "deformation.pth", "--grid-pe", "encoded features need --grid-pe");
    model_fails(FROM, model, bad_word, "colour", "expected", "a head that does not exist");
    model_fails(FROM, model, bad_bool, "perhaps", "expected", "a switch that is neither");
    model_fails(FROM, model, missing, model, "iteration_5", "a save that is not there");
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

    model = make_model(folder, NULL);
    pth_load(golden_path(model, NETWORK), &pth);
    grid = pth_put(&pth, "deformation_net.empty_voxel.grid", 5, shape);
    for (int i = 0; i < 64 * 64 * 64; i++) /* a ramp along x */
        grid->values[i] = (float)(i / 4096) / 63;
    low = pth_put(&pth, "deformation_net.empty_voxel.xyz_min", 1, three);
    high = pth_put(&pth, "deformation_net.empty_voxel.xyz_max", 1, three);
    for (int d = 0; d < 3; d++) {
        low->values[d] = -0.5f;
        high->values[d] = 0.5f;
    }
    if (model_open(FROM, model, none, &run) != SPIN_OK ||
        run.importer->frame(run.self, 0, 0.5, SPIN_COL_MEANS, &still) != SPIN_OK)
        exit(1);
    ok(run.sequence.static_columns == run.sequence.columns, "without heads nothing moves");
    run_close(&run);
    if (model_open(FROM, model, moved, &run) != SPIN_OK ||
        run.importer->frame(run.self, 0, 0.5, SPIN_COL_MEANS, &plain) != SPIN_OK)
        exit(1);
    run_close(&run);
    pth_save(&pth, golden_path(model, NETWORK));
    if (!ok(model_open(FROM, model, moved, &run) == SPIN_OK &&
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

            worst = larger(worst, fabs(want - masked.means[3 * i + (size_t)d]));
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

    model = make_model(folder, NULL);
    pth_load(golden_path(model, NETWORK), &pth);
    for (int i = 0; i < pth.n; i++) {
        char name[100];

        snprintf(name, sizeof name, "module.%.90s", pth.tensor[i].name);
        memcpy(pth.tensor[i].name, name, sizeof name);
    }
    pth_save(&pth, golden_path(model, NETWORK));
    golden_as(FROM, model, NULL, folder, 0, "keys that begin with 'module.'");
    pth_free(&pth);
    if (run_open(FROM, model, &run) != SPIN_OK)
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

/* ---- Malformed files --------------------------------------------------------------------------
 */

#define NET "deformation_net."

static void test_lies(const char *root)
{
    static const struct lie lies[] = {
        {NETWORK, "set " NET "pos_deform.1.weight 0 nan", "pos_deform.1.weight", "NaN in a layer"},
        {NETWORK, "set " NET "grid.grids.1.4 0 nan", "grids.1.4", "NaN in a plane"},
        {NETWORK, "set " NET "grid.aabb 0 nan", "aabb", "NaN in the box"},
        {NETWORK, "set " NET "grid.aabb 4 =1", "along y", "a bounding box without extent"},
        {NETWORK, "drop " NET "grid.grids.1. 3 5", "has 3 planes", "planes without time"},
        {NETWORK, "put " NET "grid.grids.0.3 1 4 6 7", "along y",
         "planes that contradict each other"},
        {NETWORK, "put " NET "grid.grids.0.2 1 5 6 6", "grids.0.2", "planes of different channels"},
        {NETWORK, "put " NET "grid.grids.0.0 1 4 0 6", "along y", "a plane without rows"},
        {NETWORK, "put " NET "feature_out.0.weight 16 9", "has 9 inputs",
         "a first layer that does not fit the planes"},
        {NETWORK, "put " NET "pos_deform.3.weight 5 16", "pos_deform.3.weight",
         "a head with too many outputs"},
        {NETWORK, "drop " NET "shs_deform.1.weight", "shs_deform.1.weight",
         "a head that is needed and not there"},
        {NETWORK, "drop " NET "feature_out.0.bias", "feature_out.0.bias", "a layer without bias"},
        {NETWORK, "drop " NET "grid.aabb", "aabb", "no box"},
        {NETWORK, "drop " NET "grid.grids.0.0", "grids.0.0", "no planes"},
        {NETWORK, "drop " NET "grid.grids.0.0; put feature_out_c.0.weight 16 9", "E-D3DGS",
         "a network of E-D3DGS"},
        {NETWORK, "pair", "not contain a state dict", "a pair instead of a state dict"},
    };
    const char *deform[] = {"deform", "position,scale,rotation,opacity,sh", NULL};
    const char *folder = path_in(root, "coarse_and_fine"), *model, *save;
    const char *word[] = {"grid-pe", "x", NULL};

    model = make_model(folder, NULL);
    refuse_lies(FROM, model, deform, lies, sizeof lies / sizeof *lies);
    refuse_cuts(FROM, model, NULL, NETWORK);
    refuse_cuts(FROM, model, NULL, CLOUD);
    refuse_containers(FROM, model, NULL, NETWORK);
    model = make_model(folder, "Namespace(no_dx=Perhaps)");
    model_fails(FROM, model, NULL, "cfg_args", "no_dx", "a flag that is neither");
    model = make_model(folder, "Namespace(no_dx=False, a=[1, 2");
    model_fails(FROM, model, NULL, "cfg_args", "cut short", "cfg_args cut short");
    model = make_model(folder, "Namespace(grid_pe=3)");
    model_fails(FROM, model, word, "--grid-pe", "expected", "--grid-pe of a word");
    model = make_model(folder, "{}");
    model_fails(FROM, model, NULL, "cfg_args", "Namespace", "cfg_args of another kind");
    model = make_model(folder, NULL);
    save = golden_path(model, SAVE);
    unlink(path_in(save, "deformation.pth"));
    model_fails(FROM, save, NULL, save, "deformation.pth", "no network");
    write_text(path_in(save, "deformation_GAD.pth"), "");
    model_fails(FROM, model, NULL, model, "MoDec-GS", "a run of MoDec-GS");
    model_fails(FROM, save, NULL, save, "MoDec-GS", "the folder of its save");
    model = new_folder();
    if (spin_folder_make(path_in(model, "point_cloud/coarse_iteration_3000")) != SPIN_OK)
        exit(1);
    model_fails(FROM, model, NULL, model, "coarse stage", "a run cut off in its first stage");
    model_fails(FROM, path_in(path_in(root, "coarse_and_fine"), "manifest.json"), NULL,
                "manifest.json", "is neither the model's folder", "a file of another kind");
    model_fails(FROM, "no/such/model", NULL, "no/such/model", "", "no such path");
}

TAP_MAIN
{
    const char *root = check_fixture(FROM);

    spin_log_set_level(-2);
    if (!root) {
        skip("4dgaussian fixtures", "there are none here");
        return;
    }
    if (has(root, "dynerf_like"))
        PART(test_official, root);
    if (has(root, "flags_no_ds_no_dr") && has(root, "options_static_rot_pe"))
        PART(test_options, root);
    PART(test_voxels, root);
    PART(test_prefix_and_threads, root);
    PART(test_lies, root);
}
