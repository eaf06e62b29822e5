/* deformable3dgs: every fixture at all its times, of MotionGS as well, saves that do not belong together, and
 * networks that lie.
 * K: deformable3dgs motiongs import threads */
#include "math/covariance.h"
#include "tests/importers/models.h"

/* ---- Fixtures -------------------------------------------------------------------------------- */

/* What the rasteriser forms from what was imported. */
static float *covariances(const struct spin_splats *s)
{
    float *out = malloc(6 * s->n * sizeof *out + 1);

    for (size_t i = 0; i < s->n; i++) {
        double scale[3], quat[4], cov6[6];

        for (int c = 0; c < 3; c++)
            scale[c] = exp(s->log_scales[3 * i + (size_t)c]);
        for (int c = 0; c < 4; c++)
            quat[c] = s->quats[4 * i + (size_t)c];
        spin_covariance_of(scale, quat, cov6);
        for (int c = 0; c < 6; c++)
            out[6 * i + (size_t)c] = (float)cov6[c];
    }
    return out;
}

static void compare_time(struct spin_npz *npz, int index, const char *name,
                         const struct spin_splats *s)
{
    struct spin_array info;
    double *xyz_want = check_load(npz, "xyz", &info);
    double extent = fmax(1, xyz_want ? largest(xyz_want, (size_t)info.count) : 1);
    struct expected xyz = {npz, bound("xyz").abs * extent, 0, name};
    struct expected cov = {npz, bound("cov6").abs, bound("cov6").rel, name};
    struct expected still = {npz, 2e-6, 2e-5, name};
    uint64_t first = (uint64_t)index * s->n;
    float *opacity = map_values(s->logit_opacities, s->n, sigmoid), *cov6 = covariances(s);
    double worst = 0;

    compare(&xyz, "xyz", 3 * first, 3 * s->n, s->means);
    compare(&cov, "cov6", 6 * first, 6 * s->n, cov6);
    compare(&still, "opacity", 0, s->n, opacity);
    compare(&still, "sh", 0, 48 * s->n, s->sh);
    for (size_t i = 0; i < s->n; i++) {
        const float *q = s->quats + 4 * i;

        worst = fmax(worst, fabs(sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]) - 1));
    }
    ok(worst < 1e-6, "%s: rotations are of unit length", name);
    free(opacity);
    free(cov6);
    free(xyz_want);
}

static const char *only_entry(const char *folder)
{
    char **names = NULL;
    const char *entry = NULL;
    size_t n = 0;

    if (spin_folder_list(folder, &names, &n) != SPIN_OK || n == 0)
        exit(1);
    entry = path_in(folder, names[0]);
    spin_folder_list_free(names);
    return entry;
}

/* `method` begins what is recognised, and times run from 0 to `last`. */
static void test_fixture(const char *folder, const char *name, const char *method, double last)
{
    const char *model = path_in(folder, "model");
    const char *network = path_in(only_entry(path_in(model, "deform")), "deform.pth");
    const struct spin_importer *found = NULL;
    struct spin_splats s = {0};
    struct spin_array info;
    struct spin_npz npz;
    struct run run;
    double *times;

    bounds_of = folder;
    ok(spin_importer_find(model, NULL, false, &found) == SPIN_OK &&
           !strcmp(found->name, "deformable3dgs"),
       "%s: the model's folder is recognised", name);
    ok(spin_importer_find(network, NULL, false, &found) == SPIN_OK &&
           !strcmp(found->name, "deformable3dgs") && read_all(NULL, network) == SPIN_OK,
       "%s: so is the checkpoint alone", name);
    if (!ok(model_open("deformable3dgs", model, NULL, &run) == SPIN_OK, "%s: opens", name)) {
        printf("#   %s\n", spin_last_error());
        return;
    }
    ok(run.sequence.continuous && run.sequence.time_first == 0 && run.sequence.time_last == last &&
           run.sequence.static_columns == (SPIN_COL_LOGIT_OPACITIES | SPIN_COL_SH),
       "%s: any time in 0..%g, opacities and colours are still", name, last);
    ok(strncmp(run.sequence.variant, method, strlen(method)) == 0, "%s: is said to be of %s: %s",
       name, method, run.sequence.variant);
    if (spin_npz_open(path_in(folder, "expected.npz"), &npz) != SPIN_OK)
        exit(1);
    times = check_load(&npz, "times", &info);
    for (size_t t = 0; times && t < info.count; t++) {
        char what[200];

        snprintf(what, sizeof what, "%s, time %g", name, times[t]);
        if (ok(run.importer->frame(run.self, (int)t, times[t], run.sequence.columns, &s) == SPIN_OK,
               "%s: reads", what))
            compare_time(&npz, (int)t, what, &s);
        else
            printf("#   %s\n", spin_last_error());
    }
    free(times);
    spin_splats_free(&s);
    spin_npz_close(&npz);
    run_close(&run);
}

/* ---- Models made here ------------------------------------------------------------------------ */

/* A fixture's cloud and a network (NULL: the same), saved at these iterations (0: not at all). */
static const char *make_model(const char *folder, const struct pth *pth, int cloud_at,
                              int network_at, const char *cfg)
{
    const char *model = new_folder(), *to;
    char name[64];

    if (cloud_at) {
        snprintf(name, sizeof name, "point_cloud/iteration_%d", cloud_at);
        to = path_in(model, name);
        if (spin_folder_make(to) != SPIN_OK)
            exit(1);
        copy_file(path_in(only_entry(path_in(folder, "model/point_cloud")), "point_cloud.ply"),
                  path_in(to, "point_cloud.ply"));
    }
    if (network_at) {
        snprintf(name, sizeof name, "deform/iteration_%d", network_at);
        to = path_in(model, name);
        if (spin_folder_make(to) != SPIN_OK)
            exit(1);
        if (pth)
            pth_save(pth, path_in(to, "deform.pth"));
        else
            copy_file(path_in(only_entry(path_in(folder, "model/deform")), "deform.pth"),
                      path_in(to, "deform.pth"));
    }
    if (cfg)
        write_text(path_in(model, "cfg_args"), cfg);
    return model;
}

/* The same cloud and network as `model` has at `have`, also at `also`. */
static void add_save(const char *model, const char *side, const char *file, int have, int also)
{
    char from[100], to[100];

    snprintf(from, sizeof from, "%s/iteration_%d", side, have);
    snprintf(to, sizeof to, "%s/iteration_%d", side, also);
    if (spin_folder_make(path_in(model, to)) != SPIN_OK)
        exit(1);
    copy_file(path_in(path_in(model, from), file), path_in(path_in(model, to), file));
}

static void test_saves(const char *folder)
{
    const char *const seven[] = {"iteration", "7000", NULL}, *const five[] = {"iteration", "5",
                                                                              NULL};
    const char *model = make_model(folder, NULL, 7000, 7000, NULL);
    const struct spin_importer *found = NULL;
    struct run run;

    ok(spin_importer_find(model, NULL, false, &found) == SPIN_E_NOT_RECOGNISED &&
           strstr(spin_last_error(), "deformable3dgs"),
       "a model without cfg_args may be of another method: %s", spin_last_error());
    ok(read_all("deformable3dgs", model) == SPIN_OK, "it is read when named");

    add_save(model, "point_cloud", "point_cloud.ply", 7000, 10000);
    model_fails("deformable3dgs", model, NULL, "iteration_10000", "--iteration",
                "a cloud newer than the network is not paired silently");
    ok(model_open("deformable3dgs", model, seven, &run) == SPIN_OK, "but read when asked for");
    run_close(&run);
    model_fails("deformable3dgs", model, five, NULL, "iteration_5", "a save that is not there");
    add_save(model, "deform", "deform.pth", 7000, 10000);
    ok(model_open("deformable3dgs", model, NULL, &run) == SPIN_OK &&
           strstr(run.sequence.variant, "iteration_10000"),
       "the largest number counts, not the first by name");
    run_close(&run);
    model_fails("deformable3dgs", make_model(folder, NULL, 7000, 8000, NULL), NULL, NULL,
                "two runs or half copied", "saves of different iterations");
    model_fails("deformable3dgs", make_model(folder, NULL, 7000, 0, NULL), NULL, NULL, "'deform'",
                "no networks");
    model_fails("deformable3dgs", make_model(folder, NULL, 0, 7000, NULL), NULL, NULL,
                "'point_cloud'", "no clouds");
    model_fails("deformable3dgs",
                path_in(only_entry(path_in(folder, "model/point_cloud")), "point_cloud.ply"), NULL,
                NULL, "is neither the model's folder", "a cloud alone is not a model");
    ok(model_open("deformable3dgs", make_model(folder, NULL, 2000, 2000, NULL), NULL, &run) ==
               SPIN_OK &&
           strstr(run.sequence.notes, "before iteration 3000"),
       "a save of the warm-up says so");
    run_close(&run);
    ok(model_open("deformable3dgs",
                  make_model(folder, NULL, 9000, 9000, "Namespace(is_6dof=True, sh_degree=3)"),
                  NULL, &run) == SPIN_OK &&
           strstr(run.sequence.notes, "is_6dof=True"),
       "a cfg_args that disagrees is noted, and does not count");
    run_close(&run);
}

/* MotionGS is told by its cfg_args alone. */
static void test_motiongs(const char *folder)
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
        good = model_open("deformable3dgs", make_model(folder, NULL, 9000, 9000, cfg), NULL,
                          &run) == SPIN_OK;
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
    model_fails("deformable3dgs", make_model(folder, NULL, 9000, 9000, odd), NULL, "cfg_args",
                "'optimize_pose' is '7x'", "an option of MotionGS that is no bool");
}

/* The network of `folder` with one change, which `word` must be said about. */
static void refuse(const char *folder, struct pth *pth, const char *word, const char *what)
{
    model_fails("deformable3dgs", make_model(folder, pth, 9000, 9000, NULL), NULL, "deform.pth",
                word, what);
    pth_free(pth);
}

static void test_networks(const char *folder)
{
    const char *path = path_in(only_entry(path_in(folder, "model/deform")), "deform.pth");
    const uint64_t wide[] = {32, 116}, narrow[] = {32, 31}, head[] = {3, 32}, three[] = {3};
    const uint64_t odd[] = {32, 85}, poor[] = {32, 63};
    struct pth pth;

    pth_load(path, &pth);
    ok(read_all("deformable3dgs", make_model(folder, &pth, 9000, 9000, NULL)) == SPIN_OK,
       "a copy of the network is read");

    pth_drop(&pth, "linear.3.weight");
    refuse(folder, &pth, "linear.3.weight", "a layer missing in the list");
    pth_load(path, &pth);
    pth_drop(&pth, "linear.3.bias");
    refuse(folder, &pth, "linear.3.bias", "a layer without a bias");
    pth_load(path, &pth);
    pth_drop(&pth, "gaussian_scaling.weight");
    refuse(folder, &pth, "gaussian_scaling.weight", "a head that is missing");
    pth_load(path, &pth);
    pth_drop(&pth, "gaussian_warp.weight");
    refuse(folder, &pth, "gaussian_warp", "neither kind of motion");
    pth_load(path, &pth);
    pth_put(&pth, "branch_w.weight", 2, head);
    pth_put(&pth, "branch_w.bias", 1, three);
    refuse(folder, &pth, "branch_w", "both kinds of motion");
    pth_load(path, &pth);
    pth_put(&pth, "linear.6.weight", 2, wide);
    refuse(folder, &pth, "an earlier layer takes the input again", "two wide layers");
    pth_load(path, &pth);
    pth_put(&pth, "linear.2.weight", 2, narrow);
    refuse(folder, &pth, "linear.2.weight", "a chain of widths that is broken");
    pth_load(path, &pth);
    pth_put(&pth, "linear.0.weight", 2, odd);
    refuse(folder, &pth, "linear", "an even number of time inputs");
    pth_load(path, &pth);
    pth_put(&pth, "linear.0.weight", 2, poor);
    refuse(folder, &pth, "linear", "no time inputs");
    pth_load(path, &pth);
    pth_put(&pth, "gaussian_opacity.weight", 2, head);
    refuse(folder, &pth, "gaussian_opacity.weight", "a head that this method does not have");
    pth_load(path, &pth);
    pth_find(&pth, "linear.1.weight")->values[5] = NAN;
    refuse(folder, &pth, "not finite", "NaN in a layer");
    pth_load(path, &pth);
    pth.pair = true;
    refuse(folder, &pth, "grid4d", "a pair of dicts");
    pth_load(path, &pth);
    pth_find(&pth, "gaussian_warp.bias")->values[0] = 3e38f;
    pth_find(&pth, "gaussian_warp.weight")->values[0] = 3e38f;
    ok(read_all("deformable3dgs", make_model(folder, &pth, 9000, 9000, NULL)) != SPIN_OK &&
           strstr(spin_last_error(), "not finite"),
       "a network that leaves the floats is an error, not NaN in the result");
    pth_free(&pth);
}

/* A screw of length 0 has no direction: refused, not NaN. */
static void test_no_screw(const char *folder)
{
    const char *path = path_in(only_entry(path_in(folder, "model/deform")), "deform.pth");
    struct pth pth;

    pth_load(path, &pth);
    memset(pth_find(&pth, "branch_w.weight")->values, 0,
           pth_find(&pth, "branch_w.weight")->count * sizeof(float));
    memset(pth_find(&pth, "branch_w.bias")->values, 0, 3 * sizeof(float));
    ok(read_all("deformable3dgs", make_model(folder, &pth, 9000, 9000, NULL)) != SPIN_OK &&
           strstr(spin_last_error(), "positions"),
       "a screw of length 0 is refused");
    pth_free(&pth);
}

/* A screw of whole turns, without way, moves by a constant of the method along its axis, for each turn again. */
static void test_whole_turns(const char *folder)
{
    const char *path = path_in(only_entry(path_in(folder, "model/deform")), "deform.pth");
    const uint64_t head[] = {3, 32}, three[] = {3};
    struct spin_splats s = {0};
    struct pth pth;
    struct run run;
    double z[2] = {0};

    pth_load(path, &pth);
    pth_drop(&pth, "gaussian_warp.weight");
    pth_drop(&pth, "gaussian_warp.bias");
    pth_put(&pth, "branch_w.weight", 2, head);
    pth_put(&pth, "branch_v.weight", 2, head);
    pth_put(&pth, "branch_v.bias", 1, three);
    for (int i = 0; i < 2; i++) {
        pth_put(&pth, "branch_w.bias", 1, three)->values[2] = (float)(200 * M_PI) * (float)(i + 1);
        if (ok(run_open("deformable3dgs", make_model(folder, &pth, 9000, 9000, NULL), &run) ==
                       SPIN_OK &&
                   run.importer->frame(run.self, 0, 0.5, SPIN_COL_MEANS, &s) == SPIN_OK,
               "%d00 whole turns are read", i + 1))
            z[i] = (double)s.means[2];
        run_close(&run);
    }
    near(z[1] - z[0], 2e-3 * M_PI, 1e-5, "a hundred turns more are 2 pi / 1000");
    spin_splats_free(&s);
    pth_free(&pth);
}

static void test_cuts(const char *folder)
{
    const char *model = make_model(folder, NULL, 9000, 9000, NULL);

    cut_file("deformable3dgs", model, path_in(model, "deform/iteration_9000"), "deform.pth",
             "no cut of deform.pth can be read");
    cut_file("deformable3dgs", model, path_in(model, "point_cloud/iteration_9000"),
             "point_cloud.ply", "no cut of point_cloud.ply can be read");
}

/* The same files, made by MotionGS's own code. */
static void test_motiongs_fixtures(void)
{
    const char **names = check_cases("motiongs", "expected.npz");
    const char *root = check_fixture("motiongs");

    if (!root)
        skip("motiongs fixtures", "there are none here");
    for (size_t i = 0; root && names[i]; i++)
        test_fixture(path_in(root, names[i]), names[i], "MotionGS,",
                     strncmp(names[i], "dynerf", 6) == 0 ? 10 : 1);
    free(names);
}

TAP_MAIN
{
    const char **names = check_cases("deformable3dgs", "expected.npz");
    const char *root = check_fixture("deformable3dgs");

    spin_log_set_level(-2);
    test_motiongs_fixtures();
    if (!root) {
        skip("deformable3dgs fixtures", "there are none here");
        return;
    }
    for (size_t i = 0; names[i]; i++)
        test_fixture(path_in(root, names[i]), names[i], "Deformable 3D Gaussians,", 1);
    free(names);
    test_saves(path_in(root, "real_small"));
    test_motiongs(path_in(root, "real_small"));
    test_networks(path_in(root, "real_small"));
    test_whole_turns(path_in(root, "real_small"));
    if (has(root, "sixdof_small"))
        test_no_screw(path_in(root, "sixdof_small"));
    test_cuts(path_in(root, "real_small"));
}
