/* hybrid4dgs: settings found and guessed, a missing half, and malformed files.
 * K: hybrid4dgs import */
#include "tests/importers/edits.h"
#include "tests/importers/streams.h"

#define FROM "hybrid4dgs"

static void test_folders(const char *fixture)
{
    const char *file = golden_path(fixture, "model/chkpnt*"), *folder = new_folder();
    const char *duration[] = {"time-duration", "0,10", NULL},
               *wrong[] = {"time-duration", "10,0", NULL};
    const struct spin_importer *found = NULL;
    struct spin_splats a = {0}, b = {0};
    struct run run;

    copy_file(file, path_in(folder, "chkpnt_best.pth"));
    ok(spin_importer_find(folder, NULL, false, &found) == SPIN_OK && !strcmp(found->name, FROM),
       "a folder with nothing but a checkpoint is recognised by its optimiser");
    ok(spin_importer_find(path_in(folder, "chkpnt_best.pth"), NULL, false, &found) == SPIN_OK &&
           !strcmp(found->name, FROM),
       "so is the checkpoint");
    ok(run_open(NULL, folder, &run) == SPIN_OK && strstr(run.sequence.notes, "is assumed, from") &&
           !strstr(run.sequence.notes, "colours depend"),
       "the range of times is guessed then, and colours do not depend on it");
    run_close(&run);
    copy_file(file, path_in(folder, "chkpnt100.pth"));
    copy_file(file, path_in(folder, "chkpnt20.pth"));
    ok(model_open(FROM, folder, duration, &run) == SPIN_OK && run.sequence.time_first == 0 &&
           run.sequence.time_last == 10 &&
           strstr(run.sequence.notes, "'chkpnt100.pth' is read; to import chkpnt_best.pth instead"),
       "the largest number is read, and the best one is noted");
    run.importer->frame(run.self, 0, 3, run.sequence.columns, &a);
    run_close(&run);
    fails_with(FROM, folder, wrong, "A < B", "a range backwards");
    write_text(path_in(folder, "cfg_args"),
               "Namespace(sh_degree=3, from3dgs='', start_timestamp=0, frame_ratio=2)");
    ok(run_open(NULL, folder, &run) == SPIN_OK &&
           run.importer->frame(run.self, 0, 6, run.sequence.columns, &b) == SPIN_OK && a.n == b.n &&
           !memcmp(a.means, b.means, 12 * a.n) &&
           !memcmp(a.logit_opacities, b.logit_opacities, 4 * a.n),
       "frame_ratio 2: time 6 of the data set is the file's 3");
    run_close(&run);
    write_text(path_in(folder, "cfg_args"), "Namespace(frame_ratio=0)");
    fails(FROM, folder, "cfg_args': frame_ratio is 0", "a ratio of 0");
    spin_splats_free(&a);
    spin_splats_free(&b);

    folder = new_folder();
    if (spin_folder_make(path_in(folder, "point_cloud/iteration_6000")) != SPIN_OK)
        exit(1);
    write_text(path_in(folder, "point_cloud/iteration_6000/point_cloud.ply"), "ply\n");
    write_text(path_in(folder, "cfg_args"), "Namespace(from3dgs='', start_timestamp=0)");
    ok(spin_importer_find(folder, NULL, false, &found) == SPIN_OK && !strcmp(found->name, FROM),
       "a run without its checkpoint is recognised, not taken for a cloud");
    fails(FROM, folder, "contains only the dynamic half", "but refused");
    fails(FROM, new_folder(), "contains no chkpnt<N>.pth", "an empty folder");
    fails(FROM, "no/such.pth", "no/such.pth", "a missing file");
    fails("realtime4dgs", file, "Hybrid 3D-4DGS (--from hybrid4dgs)",
          "Realtime-4DGS says whose checkpoint it is");
}

/* ---- Checkpoints made here ------------------------------------------------------------------- */

enum { N_MOVING = 5, N_STILL = 3, N_ITEMS = 28 };

static void list_items(int n_moving, int n_still, int rest, struct item items[N_ITEMS])
{
    static const int widths[] = {3, 1, 0, 3, 4, 1}; /* of items 1 to 6, and 19 to 24 */

    for (int i = 0; i < N_ITEMS; i++)
        items[i] = (struct item){'n', 0, 0, 0};
    items[0] = (struct item){'i', 3, 0, 0};
    for (int i = 0; i < 6; i++) {
        int width = i == 2 ? rest : widths[i], depth = i == 1 || i == 2 ? 3 : 0;

        items[1 + i] = (struct item){'t', n_moving, n_moving ? width : 0, n_moving ? depth : 0};
        items[i == 3   ? 22
              : i == 4 ? 23
              : i == 5 ? 24
                       : 19 + i] =
            (struct item){'t', n_still, n_still ? width : 0, n_still ? depth : 0};
    }
    items[13] = items[14] = (struct item){'t', n_moving, n_moving ? 1 : 0, 0};
    items[15] = (struct item){'t', n_moving, n_moving ? 4 : 0, 0};
    items[16] = (struct item){'b', 1, 0, 0};
    items[18] = (struct item){'i', 2, 0, 0};
}

/* A small model with one item changed. */
static const char *write_model(const char *path, int index, struct item other, float value)
{
    struct item items[N_ITEMS];

    list_items(N_MOVING, N_STILL, 15, items);
    if (index >= 0)
        items[index] = other;
    return write_items(path, items, N_ITEMS, value);
}

static void test_checkpoints(void)
{
    static const struct {
        int index;
        struct item item;
        const char *word, *what;
    } cases[] = {
        {0, {'i', 4, 0, 0}, "active SH degree", "degree 4"},
        {1,
         {'n', 0, 0, 0},
         "features_dc is not empty, but xyz is",
         "no dynamic centres, but all else"},
        {3, {'t', N_MOVING, 14, 3}, "15 rows", "SH of no degree"},
        {5, {'t', N_MOVING, 3, 0}, "tensor 'rotation'", "quaternions of three numbers"},
        {13, {'t', N_MOVING + 1, 1, 0}, "tensor 't'", "another number of times"},
        {15, {'t', 0, 0, 0}, "right quaternions are empty", "no right quaternions"},
        {16, {'i', 1, 0, 0}, "item 16 (rot_4d) is an int", "rot_4d that is no bool"},
        {16, {'b', 0, 0, 0}, "but rot_4d is false", "static Gaussians without 4-D rotations"},
        {18, {'i', 3, 0, 0}, "temporal SH degree", "temporal degree 3"},
        {19,
         {'t', 0, 0, 0},
         "static features_dc is not empty, but static xyz is",
         "no static centres, but all else"},
        {19, {'t', N_STILL, 2, 0}, "tensor 'static xyz'", "flat static centres"},
        {20, {'t', 0, 0, 0}, "tensor 'static features_dc'", "no static colours"},
        {21, {'t', N_STILL, 8, 3}, "16 rows of SH and static ones 9", "SH of two degrees"},
        {22, {'t', N_STILL + 1, 3, 0}, "tensor 'static scaling'", "another number of scales"},
        {23,
         {'t', N_STILL, 3, 0},
         "tensor 'static rotation'",
         "static quaternions of three numbers"},
        {24, {'n', 0, 0, 0}, "static opacity", "no static opacities"},
    };
    const char *folder = new_folder(), *path = path_in(folder, "chkpnt7.pth");
    const char *range[] = {"time-duration", "0,2", NULL};
    struct item items[N_ITEMS + 1] = {{0}};
    struct spin_splats s = {0};
    struct run run;

    write_model(path, -1, (struct item){0}, 1);
    ok(model_open(FROM, path, range, &run) == SPIN_OK &&
           strstr(run.sequence.variant, "iteration 123, 5 dynamic and 3 static") &&
           run.importer->frame(run.self, 0, 1, run.sequence.columns, &s) == SPIN_OK && s.n == 8,
       "a checkpoint made here is read");
    check_sane(&s, run.sequence.columns, "and sane");
    ok(s.log_scales[3 * 7] == 1 && fabs(s.logit_opacities[7] - 1) < 1e-5,
       "static: scale and opacity as stored");
    ok(run.importer->frame(run.self, 0, 1e6, run.sequence.columns, &s) == SPIN_OK && s.n == 3,
       "long after, the static ones are left");
    run_close(&run);
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        write_model(path, cases[i].index, cases[i].item, 1);
        fails(FROM, path, cases[i].word, cases[i].what);
        ok(strstr(spin_last_error(), "chkpnt7.pth") != NULL, "  and the file is named");
    }
    write_model(path, -1, (struct item){0}, NAN);
    fails(FROM, path, "none of the 8 Gaussians has finite values", "NaN everywhere");

    list_items(0, N_STILL, 15, items);
    write_items(path, items, N_ITEMS, 1);
    ok(run_open(FROM, path, &run) == SPIN_OK && !run.sequence.continuous &&
           run.sequence.n_frames == 1 && run.sequence.counts[0] == N_STILL &&
           run.importer->frame(run.self, 0, 0, run.sequence.columns, &s) == SPIN_OK &&
           s.n == N_STILL,
       "static Gaussians alone are one frame");
    check_sane(&s, run.sequence.columns, "  and sane");
    run_close(&run);
    items[13] = (struct item){'t', N_MOVING, 1, 0};
    write_items(path, items, N_ITEMS, 1);
    fails(FROM, path, "t is not empty, but xyz is", "but not with times of dynamic ones");
    list_items(N_MOVING, 0, 47, items);
    items[16].a = 0;
    write_items(path, items, N_ITEMS, 1);
    ok(model_open(FROM, path, range, &run) == SPIN_OK &&
           strstr(run.sequence.variant, "with time") &&
           run.importer->frame(run.self, 0, 1, run.sequence.columns, &s) == SPIN_OK &&
           s.n == N_MOVING,
       "dynamic ones alone, without 4-D rotations");
    /* cosines of 0 are 1 and fold as 1 + 1 + 1 */
    near(s.sh[0], 3, 1e-5, "  with colours in time");
    run_close(&run);
    list_items(0, 0, 15, items);
    write_items(path, items, N_ITEMS, 1);
    fails(FROM, path, "0 Gaussians", "neither");
    write_items(path, items, 19, 1);
    fails(FROM, path, "Realtime-4DGS (--from realtime4dgs)", "a checkpoint of Realtime-4DGS");
    write_items(path, items, 27, 1);
    fails(FROM, path, "the model is a tuple of 27 items", "one of no method that is known");
    spin_splats_free(&s);
}

/* The form that training reads as loaded_pth. */
static void test_dict(void)
{
    static const struct {
        const char *key;
        int b, c;
    } keys[] = {{"xyz", 3, 0},     {"features_dc", 3, 1}, {"features_rest", 3, 15},
                {"scaling", 3, 0}, {"rotation", 4, 0},    {"opacity", 1, 0},
                {"t", 1, 0},       {"scaling_t", 1, 0},   {"rotation_r", 4, 0}};
    const char *path = path_in(new_folder(), "init.pth");
    struct spin_splats s = {0};
    struct writer w;
    struct run run;

    for (int n_still = 0; n_still <= 2; n_still += 2) {
        begin_stream(&w, path);
        PUT(&w, "}(");
        for (size_t i = 0; i < sizeof keys / sizeof *keys; i++) {
            put_text(&w, keys[i].key);
            put_tensor(&w, 4, keys[i].b, keys[i].c);
        }
        for (size_t i = 0; i < 6; i++) {
            char key[32];

            snprintf(key, sizeof key, "static_%s", keys[i].key);
            put_text(&w, key);
            if (n_still > 0)
                put_tensor(&w, n_still, keys[i].b, keys[i].c);
            else
                PUT(&w, "N");
        }
        PUT(&w, "u");
        end_stream(&w, 1);
        ok(run_open(NULL, path, &run) == SPIN_OK && !strcmp(run.importer->name, FROM) &&
               run.importer->frame(run.self, 0, 1, run.sequence.columns, &s) == SPIN_OK &&
               s.n == 4 + (size_t)n_still && s.sh_degree == 3,
           "the dict of loaded_pth, %d static Gaussians", n_still);
        if (!run.self)
            printf("#   %s\n", spin_last_error());
        run_close(&run);
        fails("realtime4dgs", path, "--from hybrid4dgs",
              "  which Realtime-4DGS does not take for its own");
    }
    spin_splats_free(&s);
}

TAP_MAIN
{
    const char **names = check_cases("hybrid4dgs", "expected.npz");
    const char *root = check_fixture("hybrid4dgs");

    spin_log_set_level(-2);
    test_checkpoints();
    test_dict();
    if (!root) {
        skip("hybrid4dgs fixtures", "there are none here");
        return;
    }
    for (size_t i = 0; names[i]; i++) {
        const char *file = golden_path(path_in(root, names[i]), "model/chkpnt*");

        ok(read_truncations(FROM, file) == 0, "%s: no truncation can be read", names[i]);
        survive_flips(FROM, file);
        if (strcmp(names[i], "nan_static") == 0 || strcmp(names[i], "small") == 0)
            test_folders(path_in(root, names[i]));
    }
    free(names);
}
