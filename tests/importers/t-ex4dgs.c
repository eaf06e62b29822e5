/* ex4dgs: cfg_args, options, rows and malformed files.
 * K: ex4dgs import */
#include "tests/importers/edits.h"
#include "tests/importers/streams.h"

#define FROM "ex4dgs"

static void write_bytes(const char *path, const void *bytes, size_t n)
{
    FILE *file = fopen(path, "wb");

    if (!file || fwrite(bytes, 1, n, file) != n || fclose(file) != 0)
        exit(1);
}

/* ---- Fixtures -------------------------------------------------------------------------------- */

static void test_sequence(const char *folder, const char *name)
{
    bool plys = !golden_path(folder, "model/chkpnt*");
    struct spin_splats s = {0};
    struct spin_npz npz;
    struct table times;
    struct run run;

    if (run_open(FROM, path_in(folder, "model"), &run) != SPIN_OK ||
        spin_npz_open(path_in(folder, "expected.npz"), &npz) != SPIN_OK)
        exit(1);
    times = golden_load(&npz, "times", 0);
    ok(run.sequence.counts_frames && run.sequence.time_last == times.value[times.n_rows - 1] &&
           (strstr(run.sequence.variant, "PLYs") != NULL) == plys,
       "%s: times count frames, and it is said which files are read", name);
    ok(run.importer->frame(run.self, 0, 0, run.sequence.columns, &s) == SPIN_OK && s.antialias,
       "%s: antialiased", name);
    free(times.value);
    spin_splats_free(&s);
    spin_npz_close(&npz);
    run_close(&run);
}

/* ---- Runs made here -------------------------------------------------------------------------- */

/* A fixture's PLYs in point_cloud/iteration_<at> of a new model, with this cfg_args, or NULL. */
static const char *make_run(const char *fixture, int at, const char *cfg)
{
    const char *save = golden_path(fixture, "model/point_cloud/*"), *model = new_folder(), *to;
    char name[64];

    snprintf(name, sizeof name, "point_cloud/iteration_%d", at);
    to = path_in(model, name);
    if (spin_folder_make(to) != SPIN_OK)
        exit(1);
    copy_file(path_in(save, "point_cloud.ply"), path_in(to, "point_cloud.ply"));
    copy_file(path_in(save, "dynamic_point_cloud.ply"), path_in(to, "dynamic_point_cloud.ply"));
    if (cfg)
        write_text(path_in(model, "cfg_args"), cfg);
    return model;
}

static void fails_at(const char *path, double time, const char *word, const char *what)
{
    struct spin_splats s = {0};
    struct run run;
    bool good = run_open(FROM, path, &run) == SPIN_OK &&
                run.importer->frame(run.self, 0, time, run.sequence.columns, &s) != SPIN_OK &&
                strstr(spin_last_error(), word);

    ok(good, "%s", what);
    if (!good)
        printf("#   '%s'\n", spin_last_error());
    run_close(&run);
    spin_splats_free(&s);
}

/* Two runs give the same floats. */
static bool same_at(struct run *a, struct run *b, double time)
{
    struct spin_splats s = {0}, t = {0};
    bool same = a->importer->frame(a->self, 0, time, a->sequence.columns, &s) == SPIN_OK &&
                b->importer->frame(b->self, 0, time, b->sequence.columns, &t) == SPIN_OK &&
                s.n == t.n && !memcmp(s.means, t.means, 12 * s.n) &&
                !memcmp(s.quats, t.quats, 16 * s.n) &&
                !memcmp(s.logit_opacities, t.logit_opacities, 4 * s.n);

    spin_splats_free(&s);
    spin_splats_free(&t);
    return same;
}

#define CFG                                                                                        \
    "Namespace(time_interval=5, time_pad=3, interp_type='cube', rot_interp_type='slerp', "         \
    "duration=20"

static void test_options(const char *fixture)
{
    static const struct {
        const char *cfg, *word, *what;
    } refused[] = {
        {"Namespace(a=1)", "interp_type beside the model: use --interp",
         "cfg_args without the kind of curve"},
        {"Namespace(interp_type='cube')", "time_interval beside the model: use --interval",
         "nor the interval"},
        {"Namespace(interp_type='cube', time_interval=5)",
         "time_pad beside the model: use --time-pad", "nor the pad"},
        {"Namespace(interp_type='cube', time_interval=5, time_pad=3)",
         "duration beside the model: use --duration", "nor the number of frames"},
        {CFG ", interp_type='cubic_diff')", "interp_type is 'cubic_diff'",
         "a curve that cannot be"},
        {CFG ", rot_interp_type='lerp')", "rot_interp_type is 'lerp'",
         "straight lines for rotations"},
        {CFG ", time_interval='x')", "'time_interval' is ''x''", "an interval that is no number"},
        {CFG ", time_interval=0)", "inconsistent settings", "key frames at one place"},
        {CFG ", time_pad=1e9)", "inconsistent settings", "a pad beyond measure"},
        {CFG ", duration=-1)", "inconsistent settings", "a clip of -1 frames"},
        {CFG ", var_pad=0)", "inconsistent settings", "edges without a width"},
        {CFG, "cut short", "half a cfg_args"},
    };
    const char *all[] = {"interp", "cube",     "interval", "5", "time-pad",
                         "3",      "duration", "20",       NULL};
    const char *curve[] = {"interp", "spline", NULL}, *word[] = {"interval", "5x", NULL};
    const char *other[] = {"iteration", "7", NULL}, *linear[] = {"interp", "linear", NULL};
    const char *model = make_run(fixture, 30000, CFG ")"), *bare = make_run(fixture, 30000, NULL);
    spin_json *manifest = load_manifest(fixture);
    const struct spin_splats_4d *rows;
    double n_keys = 0;
    struct run run, named;

    ok(run_open(FROM, model, &run) == SPIN_OK && model_open(FROM, bare, all, &named) == SPIN_OK &&
           same_at(&run, &named, 7.25),
       "options say what cfg_args does");
    run_close(&named);
    ok(model_open(FROM, model, linear, &named) == SPIN_OK && !same_at(&run, &named, 7.25) &&
           strstr(named.sequence.variant, "linear"),
       "and count before it");
    run_close(&named);
    ok(run_open(NULL, path_in(model, "point_cloud/iteration_30000"), &named) == SPIN_OK &&
           same_at(&run, &named, 7.25),
       "the folder of a save is recognised, and cfg_args found above it");
    run_close(&named);
    ok(run_open(NULL, path_in(model, "point_cloud/iteration_30000/point_cloud.ply"), &named) ==
               SPIN_OK &&
           same_at(&run, &named, 7.25),
       "so is either PLY, which stands for both");
    run_close(&named);
    run_close(&run);
    fails_with(FROM, bare, curve, "option 'interp' is 'spline'", "a curve that is none");
    fails_with(FROM, bare, word, "option 'interval' is '5x'", "an interval that is no number");
    fails_with(FROM, model, other, "iteration_7", "a save that is not there");
    fails_with(FROM, bare, NULL, "there is no cfg_args with interp_type", "no cfg_args");
    for (size_t i = 0; i < sizeof refused / sizeof *refused; i++)
        fails(FROM, make_run(fixture, 30000, refused[i].cfg), refused[i].word, refused[i].what);
    ok(run_open(FROM, make_run(fixture, 5, CFG ", start_timestamp=151)"), &run) == SPIN_OK &&
           strstr(run.sequence.notes, "this frame of the recording is at time 0"),
       "a clip from the middle of a recording is noted");
    run_close(&run);
    fails_at(model, -0.5, "its times are 0 to 19", "a time before the clip");
    fails_at(model, 19.5, "its times are 0 to 19", "a time behind it");
    fails_at(model, NAN, "has no time nan", "a time that is no number");
    model = make_run(fixture, 5, CFG ", duration=60)");
    fails_at(model, 59, "needs the key frames 12 to 15, but the model has",
             "a time for which key frames are missing");
    spin_json_number(spin_json_get(manifest, "keyframes"), &n_keys);
    spin_json_free(manifest);
    fails_at(model, 5 * (n_keys - 2) - 8, "needs the key frames", "the first of these times");
    ok(run_open(FROM, model, &run) == SPIN_OK && same_at(&run, &run, 5 * (n_keys - 2) - 8.01),
       "the last before them");
    ok(run.importer->splats_4d(run.self, &rows) == SPIN_OK && !rows,
       "there are no 4D splats of such a clip");
    run_close(&run);
    ok(run_open(FROM, make_run(fixture, 5, CFG ", interp_type='linear')"), &run) == SPIN_OK &&
           run.importer->splats_4d(run.self, &rows) == SPIN_OK && rows->degree == 1 && rows->cuts,
       "paths of lines have degree 1");
    run_close(&run);
    fails_at(make_run(fixture, 5, CFG ", duration=60, interp_type='linear')"), 59,
             "needs the key frames 12 to 13", "lines need fewer, and begin one interval later");
}

/* The latest save is used; of one save the checkpoint. */
static void test_saves(const char *fixture, const char *checkpoint)
{
    const char *model = make_run(fixture, 30000, CFG ")"),
               *save = path_in(model, "point_cloud/iteration_40000");
    const char *old[] = {"iteration", "30000", NULL};
    const struct spin_importer *found = NULL;
    struct run run;

    copy_file(checkpoint, path_in(model, "chkpnt20000.pth"));
    ok(run_open(NULL, model, &run) == SPIN_OK && strstr(run.sequence.variant, "PLYs") &&
           strstr(run.sequence.notes, "iteration_30000"),
       "PLYs newer than the checkpoint are read");
    run_close(&run);
    copy_file(checkpoint, path_in(model, "chkpnt30000.pth"));
    ok(run_open(NULL, model, &run) == SPIN_OK && strstr(run.sequence.variant, "chkpnt30000.pth"),
       "of one iteration the checkpoint is");
    ok(strstr(run.sequence.notes, "time_interval is 5 in cfg_args and 10 in the checkpoint") &&
           strstr(run.sequence.notes,
                  "time_pad in cfg_args implies a shift of 13 frames, but the checkpoint has 12"),
       "a cfg_args of another run is noted");
    run_close(&run);
    if (spin_folder_make(save) != SPIN_OK)
        exit(1);
    copy_file(path_in(model, "point_cloud/iteration_30000/point_cloud.ply"),
              path_in(save, "point_cloud.ply"));
    fails(FROM, model, "iteration_40000/dynamic_point_cloud.ply",
          "a save without its dynamic half");
    fails(FROM, path_in(save, "point_cloud.ply"), "dynamic_point_cloud.ply",
          "and its static half alone");
    ok(spin_importer_find(save, NULL, false, &found) == SPIN_OK && !strcmp(found->name, FROM),
       "whose folder is not taken for a cloud of 3DGS");
    fails(FROM, save, "dynamic_point_cloud.ply", "but refused");
    ok(model_open(FROM, model, old, &run) == SPIN_OK, "an older one can be asked for");
    run_close(&run);
    ok(unlink(path_in(save, "point_cloud.ply")) == 0, "(the static half goes)");
    copy_file(path_in(model, "point_cloud/iteration_30000/dynamic_point_cloud.ply"),
              path_in(save, "dynamic_point_cloud.ply"));
    fails(FROM, model, "iteration_40000/point_cloud.ply", "a save without its static half");
    fails(FROM, new_folder(), "contains neither chkpnt<N>.pth nor point_cloud", "an empty folder");
    fails("ply", path_in(model, "point_cloud/iteration_30000/point_cloud.ply"), "Ex4DGS",
          "importer ply does not take the static half for the whole");
    fails("ply", path_in(model, "point_cloud/iteration_30000/dynamic_point_cloud.ply"), "Ex4DGS",
          "nor the dynamic one");

    model = new_folder();
    copy_file(checkpoint, path_in(model, "chkpnt5.pth"));
    ok(spin_importer_find(model, NULL, false, &found) == SPIN_OK && !strcmp(found->name, FROM),
       "a folder with nothing but a checkpoint is recognised by its optimiser");
    ok(spin_importer_find(path_in(model, "chkpnt5.pth"), NULL, false, &found) == SPIN_OK &&
           !strcmp(found->name, FROM),
       "so is the checkpoint");
    fails(FROM, model, "there is no cfg_args with interp_type beside the model: use --interp",
          "but how to go between its keys is not in it");
    const char *cube[] = {"interp", "cube", NULL};

    ok(model_open(FROM, model, cube, &run) == SPIN_OK && run.sequence.time_last == 29 &&
           strstr(run.sequence.notes, "assumed 30, from the checkpoint's duration"),
       "the number of frames is");
    run_close(&run);
}

/* ---- Rows ------------------------------------------------------------------------------------ */

static void test_rows(const char *fixture)
{
    const char *model = make_run(fixture, 1, CFG ")");
    const float log_scale[3] = {-2, -3, -4};
    struct spin_splats s = {0}, whole = {0};
    struct run run;
    size_t n;

    if (run_open(FROM, model, &run) != SPIN_OK ||
        run.importer->frame(run.self, 0, 3, run.sequence.columns, &whole) != SPIN_OK)
        exit(1);
    n = whole.n;
    run_close(&run);
    edit_file(path_in(model, "point_cloud/iteration_1/point_cloud.ply"),
              "set xyz_disp_1 2 nan; set scale_0 4 inf; set rot_0 6 0; set rot_1 6 0; "
              "set rot_2 6 0; set rot_3 6 0; set scale_0 6 -2; set scale_1 6 -3; set scale_2 6 -4");
    edit_file(path_in(model, "point_cloud/iteration_1/dynamic_point_cloud.ply"),
              "set motion_xyz_0_2 0 nan; set motion_opacity_v_1 3 inf; set motion_rot_2_0 5 0; "
              "set motion_rot_2_1 5 0; set motion_rot_2_2 5 0; set motion_rot_2_3 5 0");
    ok(run_open(FROM, model, &run) == SPIN_OK && strstr(run.sequence.notes, "5 of") &&
           run.sequence.counts[0] == n - 5 &&
           run.importer->frame(run.self, 0, 3, run.sequence.columns, &s) == SPIN_OK && s.n == n - 5,
       "rows that cannot be drawn are dropped and counted");
    check_sane(&s, run.sequence.columns, "the others are sane");
    ok(!memcmp(s.means, whole.means, 24) && !memcmp(s.means + 6, whole.means + 9, 12) &&
           !memcmp(s.sh + 48 * (n - 6), whole.sh + 48 * (n - 1), 192),
       "and are the same as before");
    near(fabs(s.quats[4 * 4]), 1, 1e-6, "a static rotation of 0 is none, as the rasteriser has it");
    for (size_t c = 0; c < 3; c++)
        near(s.log_scales[3 * 4 + c], log_scale[c], 1e-5, "with the scales that are stored");
    run_close(&run);
    spin_splats_free(&s);
    spin_splats_free(&whole);
}

/* Replace a word of a header by another of the same length. */
static void rename_property(const char *path, const char *old, const char *new_name)
{
    struct spin_map map;
    unsigned char *bytes, *at;

    if (spin_map_open(path, &map) != SPIN_OK || !(bytes = malloc(map.size)))
        exit(1);
    memcpy(bytes, map.data, map.size);
    at = memmem(bytes, map.size, old, strlen(old));
    if (!at || strlen(old) != strlen(new_name))
        exit(1);
    memcpy(at, new_name, strlen(old));
    write_bytes(path, bytes, map.size);
    free(bytes);
    spin_map_close(&map);
}

static void test_names(const char *fixture)
{
    static const struct {
        bool moving;
        const char *old, *new_name, *word, *what;
    } cases[] = {
        {true, " motion_xyz_3_1", " motion_xyz_3_7", "no property 'motion_xyz_3_1'",
         "a hole in the key frames"},
        {true, " motion_rot_3_1", " lotion_rot_3_1", "motion_rot_*",
         "fewer rotations than positions"},
        {true, " motion_f_rest_9\n", " lotion_f_rest_9\n", "44 properties motion_f_rest_*",
         "SH of no degree"},
        {true, " motion_opacity\n", " lotion_opacity\n", "no property 'motion_opacity'",
         "no opacity"},
        {true, " motion_opacity_c_1", " motion_opacity_d_1", "no property 'motion_opacity_c_1'",
         "one time"},
        {false, " xyz_disp_2", " xyz_disk_2", "no property 'xyz_disp_2'", "no drift"},
        {false, " y\n", " Y\n", "no property 'y'", "no place"},
        {false, "element vertex", "element vortex", "no element 'vertex'", "no vertices"},
    };

    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        const char *model = make_run(fixture, 1, CFG ")");
        const char *file = path_in(path_in(model, "point_cloud/iteration_1"),
                                   cases[i].moving ? "dynamic_point_cloud.ply" : "point_cloud.ply");

        rename_property(file, cases[i].old, cases[i].new_name);
        fails(FROM, model, cases[i].word, cases[i].what);
        ok(strstr(spin_last_error(), spin_path_name(file)) != NULL, "  and the file is named");
    }
}

/* ---- Checkpoints made here ------------------------------------------------------------------- */

enum { STILL = 4, MOVING = 3, KEYS = 9 };

/* A small model with one item changed. */
static const char *write_model(const char *folder, int index, struct item other, float value)
{
    struct item items[40];

    for (int i = 0; i < 40; i++)
        items[i] = (struct item){'n', 0, 0, 0};
    items[0] = (struct item){'i', 3, 0, 0};
    items[1] = items[4] = items[18] = (struct item){'t', STILL, 3, 0};
    items[2] = (struct item){'t', STILL, 1, 3};
    items[3] = (struct item){'t', STILL, 15, 3};
    items[5] = (struct item){'t', STILL, 4, 0};
    items[6] = (struct item){'t', STILL, 1, 0};
    items[19] = (struct item){'i', 43, 0, 0};
    items[20] = (struct item){'i', 10, 0, 0};
    items[21] = (struct item){'i', 12, 0, 0};
    items[22] = (struct item){'i', KEYS, 0, 0};
    items[23] = (struct item){'t', MOVING, KEYS, 3};
    items[24] = (struct item){'t', MOVING, 1, 3};
    items[25] = (struct item){'t', MOVING, 15, 3};
    items[26] = (struct item){'t', MOVING, 3, 0};
    items[27] = (struct item){'t', MOVING, 1, 0};
    items[28] = items[29] = (struct item){'t', MOVING, 2, 1};
    items[30] = (struct item){'t', MOVING, KEYS, 4};
    if (index >= 0)
        items[index] = other;
    return write_items(path_in(folder, "chkpnt1.pth"), items, 40, value);
}

/* The same with all tensors of the static half (0), or of the dynamic one (1), empty. */
static const char *write_half(const char *folder, bool moving)
{
    static const int of_still[] = {1, 2, 3, 4, 5, 6, 18},
                     of_moving[] = {23, 24, 25, 26, 27, 28, 29, 30};
    struct item items[40];

    for (int i = 0; i < 40; i++)
        items[i] = (struct item){'n', 0, 0, 0};
    items[0] = (struct item){'i', 0, 0, 0};
    items[19] = items[20] = items[21] = (struct item){'i', 43, 0, 0};
    for (int i = 0; i < 8; i++) {
        static const int widths[] = {3, 1, 15, 3, 1, 2, 2, 4};
        int w = widths[i];

        if (i < 7)
            items[of_still[i]] = (struct item){'t', moving ? 0 : STILL,
                                               moving ? 0 : (int[]){3, 1, 15, 3, 4, 1, 3}[i],
                                               moving             ? 0
                                               : i == 1 || i == 2 ? 3
                                                                  : 0};
        items[of_moving[i]] = !moving            ? (struct item){'t', 0, 0, 0}
                              : i == 0 || i == 7 ? (struct item){'t', MOVING, KEYS, w}
                                                 : (struct item){'t', MOVING, w,
                                                                 i == 1 || i == 2   ? 3
                                                                 : i == 5 || i == 6 ? 1
                                                                                    : 0};
    }
    return write_items(path_in(folder, "chkpnt1.pth"), items, 40, 1);
}

static void test_checkpoints(void)
{
    static const struct {
        int index;
        struct item item;
        const char *word, *what;
    } cases[] = {
        {0, {'i', 4, 0, 0}, "active SH degree is 4", "degree 4"},
        {0, {'n', 0, 0, 0}, "the active SH degree) is None", "no degree"},
        {1, {'n', 0, 0, 0}, "xyz (item 1)", "no static centres"},
        {1,
         {'t', 0, 0, 0},
         "item 5 (rotation) is not empty, but item 1",
         "no static centres, but all else"},
        {2, {'t', STILL, 3, 0}, "features_dc (item 2)", "SH of another rank"},
        {3, {'t', STILL, 14, 3}, "has 14 rows of SH", "SH of no degree"},
        {3, {'t', STILL, 8, 3}, "degree 2, those of dynamic ones 3", "SH of two degrees"},
        {5, {'t', STILL, 3, 0}, "rotation (item 5)", "quaternions of three numbers"},
        {6, {'t', STILL + 1, 1, 0}, "opacity (item 6)", "another number of opacities"},
        {18, {'t', STILL, 2, 0}, "xyz_disp (item 18)", "a flat drift"},
        {19, {'t', 1, 0, 0}, "item 19 (duration) is a tensor", "a duration that is no int"},
        {19, {'i', 0, 0, 0}, "inconsistent settings", "no duration"},
        {20, {'i', 0, 0, 0}, "inconsistent settings", "no interval"},
        {21, {'n', 0, 0, 0}, "item 21 (time_shift) is None", "no shift"},
        {23,
         {'t', 0, 0, 0},
         "item 30 (motion rotation) is not empty",
         "no dynamic centres, but all else"},
        {23, {'t', MOVING, KEYS, 2}, "motion xyz (item 23)", "flat key frames"},
        {28, {'t', MOVING, 2, 0}, "motion opacity center (item 28)", "times of another rank"},
        {29, {'t', MOVING, 3, 1}, "motion opacity var (item 29)", "three widths"},
        {30,
         {'t', MOVING, KEYS - 1, 4},
         "motion rotation (item 30)",
         "fewer rotations than positions"},
    };
    const char *folder = new_folder(), *path = path_in(folder, "chkpnt1.pth");
    const char *cfg =
        "Namespace(interp_type='cube', rot_interp_type='slerp', time_interval=10, duration=30)";
    struct item none[28] = {{0}};
    struct spin_splats s = {0};
    struct run run;

    write_text(path_in(folder, "cfg_args"), cfg);
    write_model(folder, -1, (struct item){0}, 1);
    ok(run_open(NULL, folder, &run) == SPIN_OK && run.sequence.time_last == 29 &&
           run.importer->frame(run.self, 0, 29, run.sequence.columns, &s) == SPIN_OK &&
           s.n == STILL + MOVING,
       "a checkpoint made here is read");
    check_sane(&s, run.sequence.columns, "and sane");
    near(s.means[0], 1 + 29.0 / 43, 1e-6, "static: 1 + 29/43 of 1");
    near(s.means[3 * STILL], 1, 1e-6, "dynamic: between equal keys");
    run_close(&run);
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        write_model(folder, cases[i].index, cases[i].item, 1);
        fails(FROM, folder, cases[i].word, cases[i].what);
        ok(strstr(spin_last_error(), "chkpnt1.pth") != NULL, "  and the file is named");
    }
    write_model(folder, -1, (struct item){0}, NAN);
    fails(FROM, folder, "none of the 7 Gaussians has finite values", "NaN everywhere");
    write_model(folder, 19, (struct item){'i', 20, 0, 0}, 1);
    ok(run_open(FROM, folder, &run) == SPIN_OK &&
           strstr(run.sequence.notes, "saved before training covered the whole clip"),
       "a checkpoint from the middle of training is noted");
    run_close(&run);
    for (int moving = 0; moving < 2; moving++) {
        write_half(folder, moving);
        ok(run_open(FROM, folder, &run) == SPIN_OK &&
               run.sequence.counts[0] == (moving ? MOVING : STILL) &&
               run.sequence.static_columns ==
                   (moving ? SPIN_COL_LOG_SCALES | SPIN_COL_SH : SPIN_COL_ATTRIBUTES) &&
               run.importer->frame(run.self, 0, 0, run.sequence.columns, &s) == SPIN_OK &&
               s.sh_degree == 0,
           moving ? "a run without static Gaussians" : "a run without dynamic Gaussians");
        check_sane(&s, run.sequence.columns, "  and sane");
        run_close(&run);
    }
    for (int i = 0; i < 28; i++)
        none[i].kind = 'n';
    write_items(path, none, 28, 0);
    fails(FROM, folder, "Hybrid 3D-4DGS (--from hybrid4dgs)", "a checkpoint of another method");
    write_items(path, none, 27, 0);
    fails(FROM, folder, "the model is a tuple of 27 items, but that of Ex4DGS has 40",
          "or of none that is known");
    fails(FROM, "no/such.pth", "no/such.pth", "a missing file");
    spin_splats_free(&s);
}

/* ---- Files cut short ------------------------------------------------------------------------- */

static void test_cuts(const char *folder, const char *name)
{
    static const char *const plys[] = {"point_cloud.ply", "dynamic_point_cloud.ply"};
    const char *model = path_in(folder, "model"), *save = NULL;
    char **names = NULL;
    size_t n = 0;

    if (spin_folder_list(model, &names, &n) != SPIN_OK)
        exit(1);
    for (size_t i = 0; i < n; i++) {
        const char *copy = new_folder();

        if (!strstr(names[i], ".pth"))
            continue;
        copy_file(path_in(model, "cfg_args"), path_in(copy, "cfg_args"));
        copy_file(path_in(model, names[i]), path_in(copy, names[i]));
        ok(read_all(FROM, copy) == SPIN_OK && read_cuts(FROM, copy, path_in(copy, names[i])) == 0 &&
               strstr(spin_last_error(), names[i]),
           "%s: no truncation of %s can be read", name, names[i]);
        survive_flips(FROM, path_in(model, names[i]));
    }
    spin_folder_list_free(names);
    if (!has(model, "point_cloud"))
        return;
    save = golden_path(model, "point_cloud/*");
    for (int i = 0; i < 2; i++) {
        const char *copy = new_folder();

        copy_file(path_in(model, "cfg_args"), path_in(copy, "cfg_args"));
        copy_file(path_in(save, plys[0]), path_in(copy, plys[0]));
        copy_file(path_in(save, plys[1]), path_in(copy, plys[1]));
        ok(read_all(FROM, copy) == SPIN_OK && read_cuts(FROM, copy, path_in(copy, plys[i])) == 0 &&
               strstr(spin_last_error(), plys[i]),
           "%s: no truncation of %s can be read", name, plys[i]);
    }
}

TAP_MAIN
{
    const char **names = check_cases("ex4dgs", "expected.npz");
    const char *root = check_fixture("ex4dgs");
    const char *plys = root && has(root, "ply_only") ? "ply_only" : "small";
    const char *full = root && has(root, "full_run") ? "full_run" : "small";

    spin_log_set_level(-2);
    test_checkpoints();
    if (!root) {
        skip("ex4dgs fixtures", "there are none here");
        return;
    }
    for (size_t i = 0; names[i]; i++) {
        test_sequence(path_in(root, names[i]), names[i]);
        test_cuts(path_in(root, names[i]), names[i]);
    }
    free(names);
    test_options(path_in(root, plys));
    test_rows(path_in(root, plys));
    test_names(path_in(root, plys));
    test_saves(path_in(root, plys), path_in(path_in(root, full), "model/chkpnt40000.pth"));
}
