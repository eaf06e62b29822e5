/* realtime4dgs: both conventions of rotation, settings found and guessed, forks, and malformed
 * files.
 * K: realtime4dgs import */
#include "importers/lib/gaussian4d.h"
#include "tests/importers/edits.h"
#include "tests/importers/streams.h"

#define FROM "realtime4dgs"

/* ---- Settings -------------------------------------------------------------------------------- */

static void test_times(const char *root)
{
    const char *original = path_in(root, "rot4d_sht/chkpnt7000.pth"), *folder = new_folder();
    const char *file = path_in(folder, "renamed.pth"), *yaml;
    const char *five[] = {"time-duration", "0,5", NULL}, *wrong[] = {"time-duration", "5", NULL};
    const char *back[] = {"time-duration", "5,0", NULL};
    struct spin_splats a = {0}, b = {0};
    struct run run;

    copy_file(original, file);
    ok(run_open(NULL, file, &run) == SPIN_OK && run.sequence.time_first == 0 &&
           run.sequence.time_last == 5 && strstr(run.sequence.notes, "0,5 is assumed"),
       "without a YAML the range of times is guessed, and the notes say so");
    ok(strstr(run.sequence.notes, "colours depend on time_duration") != NULL,
       "and that colours depend on it");
    ok(strstr(run.sequence.variant, "iteration 7000") != NULL, "the iteration inside is told");
    run_close(&run);
    ok(model_open(FROM, file, five, &run) == SPIN_OK &&
           !strstr(run.sequence.notes, "time_duration is not"),
       "the range may be given");
    run.importer->frame(run.self, 0, 2, run.sequence.columns, &a);
    run_close(&run);
    fails_with(FROM, file, wrong, "expected A,B", "half a range");
    fails_with(FROM, file, back, "A < B", "a range backwards");

    yaml = path_in(new_folder(), "my.yaml");
    write_text(yaml, "ModelParams:\n  time_duration: # block\n    - 0.0\n    - 10.0\n"
                     "  frame_ratio: 2\n");
    const char *config[] = {"config", yaml, NULL};
    write_text(path_in(folder, "cfg_args"), "Namespace(sh_degree=3, frame_ratio=2)");
    ok(model_open(FROM, file, config, &run) == SPIN_OK && run.sequence.time_last == 10,
       "a YAML named by the user, as a block list");
    run.importer->frame(run.self, 0, 4, run.sequence.columns, &b);
    ok(a.n == b.n && !memcmp(a.means, b.means, 12 * a.n) && !memcmp(a.sh, b.sh, 192 * a.n),
       "frame_ratio 2: time 4 of the data set is the file's 2");
    run_close(&run);
    write_text(path_in(folder, "cfg_args"), "Namespace(frame_ratio='x')");
    fails_with(FROM, file, five, "frame_ratio", "a frame_ratio that is no number");
    write_text(yaml, "time_duration: [1, 1]\n");
    write_text(path_in(folder, "cfg_args"), "Namespace(frame_ratio=1)");
    fails_with(FROM, file, config, "time_duration is [1, 1]", "an empty time_duration");
    ok(!strstr(spin_last_error(), file), "which is not the checkpoint's: %s", spin_last_error());
    write_text(yaml, "other: 1\n");
    fails_with(FROM, file, config, "none of time_duration, frame_ratio",
               "a YAML of something else");
    remove(yaml);
    fails_with(FROM, file, config, "--config: cannot open '", "a YAML that is not there");
    ok(!strstr(spin_last_error(), file), "is not the checkpoint's fault: %s", spin_last_error());
    spin_splats_free(&a);
    spin_splats_free(&b);
}

static void test_conventions(const char *root)
{
    static const char *const names[] = {"rot4d_sht", "rot4d_noshfs", "rot4d_preflip",
                                        "rot4d_sh3d_env"};
    const char *today[] = {"convention", "today", NULL}, *older[] = {"convention", "older", NULL};
    const char *odd[] = {"convention", "new", NULL}, *rule[] = {"cull", "some", NULL};
    struct run run;

    for (int i = 0; i < 4; i++) {
        const char *path = path_in(root, names[i]);

        if (!has(root, names[i]))
            continue;
        ok(run_open(FROM, path, &run) == SPIN_OK &&
               strstr(run.sequence.notes,
                      i == 2 ? "used before September" : "used since September"),
           "%s: the convention is guessed right, and the notes say that it is a guess", names[i]);
        run_close(&run);
        ok(model_open(FROM, path, i == 2 ? today : older, &run) == SPIN_OK &&
               strstr(run.sequence.notes, "suggest the other") &&
               !strstr(run.sequence.notes, "assumed the one"),
           "%s: the wrong one may be asked for, and is doubted", names[i]);
        run_close(&run);
        ok(model_open(FROM, path, i == 2 ? older : today, &run) == SPIN_OK &&
               !strstr(run.sequence.notes, "convention"),
           "%s: the right one is not", names[i]);
        run_close(&run);
    }
    fails_with(FROM, path_in(root, "rot4d_noshfs"), rule, "expected time or none",
               "a rule that is none");
    fails_with(FROM, path_in(root, "rot4d_noshfs"), odd, "expected auto, today or older",
               "a convention that is none");
}

static void test_notes(const char *root)
{
    struct run run;

    if (has(root, "rot4d_sh3d_env")) {
        ok(run_open(FROM, path_in(root, "rot4d_sh3d_env"), &run) == SPIN_OK &&
               strstr(run.sequence.notes, "environment map is not imported"),
           "the loss of an environment map is noted");
        run_close(&run);
    }
    ok(run_open(FROM, path_in(root, "rot4d_noshfs"), &run) == SPIN_OK &&
           run.sequence.sh_degree == 2 &&
           run.sequence.columns == (SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES),
       "only the active degree is there, with all attributes");
    run_close(&run);
}

/* A checkpoint of OMG4 after its networks took over. */
static void test_stale(void)
{
    const char *folder = check_fixture("omg4/stale_chkpnt");
    struct spin_splats s = {0};
    struct run run;

    if (!folder) {
        skip("omg4/stale_chkpnt", "it is not here");
        return;
    }
    ok(run_open(NULL, folder, &run) == SPIN_OK && strstr(run.sequence.notes, "OMG4") &&
           run.sequence.columns == (SPIN_COL_MEANS | SPIN_COL_QUATS | SPIN_COL_LOG_SCALES) &&
           run.sequence.sh_degree == -1,
       "a stale checkpoint of OMG4 gives geometry only, and says so");
    ok(run.importer->frame(run.self, 0, run.sequence.time_first, run.sequence.columns, &s) ==
               SPIN_OK &&
           s.n > 0 && s.n < 120,
       "and its Gaussians come and go in time");
    check_sane(&s, run.sequence.columns, "and they are sane");
    run_close(&run);
    spin_splats_free(&s);
}

/* ---- Pickles made here ----------------------------------------------------------------------- */

struct shape {
    int n, rest, quats, right, degree, degree_t, items;
    float value;
};

/* (model, iteration) with rot_4d set. */
static const char *write_checkpoint(const char *path, const struct shape *s)
{
    struct writer w;

    begin_stream(&w, path);
    PUT(&w, "((");
    put_int(&w, s->degree);
    put_tensor(&w, s->n, 3, 0);
    put_tensor(&w, s->n, 1, 3);
    put_tensor(&w, s->n, s->rest, 3);
    put_tensor(&w, s->n, 3, 0);
    put_tensor(&w, s->n, s->quats, 0);
    put_tensor(&w, s->n, 1, 0);
    PUT(&w, "NNNN}G\0\0\0\0\0\0\0\0");
    put_tensor(&w, s->n, 1, 0);
    put_tensor(&w, s->n, 1, 0);
    put_tensor(&w, s->right, s->right ? 4 : 0, 0);
    PUT(&w, "\x88N");
    put_int(&w, s->degree_t);
    for (int i = 19; i < s->items; i++)
        PUT(&w, "N");
    PUT(&w, "t");
    put_int(&w, 123);
    PUT(&w, "t");
    end_stream(&w, s->value);
    return path;
}

/* A tuple of so many Nones in place of the model. */
static const char *write_tuple(const char *path, int n_items)
{
    struct writer w;

    begin_stream(&w, path);
    PUT(&w, "((");
    for (int i = 0; i < n_items; i++)
        PUT(&w, "N");
    PUT(&w, "tK\x01t");
    end_stream(&w, 0);
    return path;
}

static void test_refused(void)
{
    static const struct {
        int n;
        const char *of;
    } makers[] = {{14, "of 4DGaussians"},
                  {15, "has 15 items, expected the 19 (or 12)"},
                  {18, "of PVG"},
                  {28, "of Hybrid 3D-4DGS"},
                  {40, "of Ex4DGS"}};
    static const struct {
        struct shape s;
        const char *word, *what;
    } cases[] = {
        {{0, 15, 4, 0, 3, 0, 19, 1}, "0 Gaussians", "no Gaussians"},
        {{5, 15, 3, 5, 3, 0, 19, 1}, "rotation", "quaternions of three numbers"},
        {{5, 15, 4, 4, 3, 0, 19, 1}, "rotation_r", "right quaternions of another count"},
        {{5, 15, 4, 0, 3, 0, 19, 1}, "right quaternions are empty", "no right quaternions"},
        {{5, 16, 4, 5, 3, 0, 19, 1}, "17 rows", "a number of SH rows that none has"},
        {{5, 60, 4, 5, 3, 0, 19, 1}, "60 rows", "far too many SH rows"},
        {{5, 15, 4, 5, 4, 0, 19, 1}, "active SH degree", "degree 4"},
        {{5, 47, 4, 5, 3, 3, 19, 1}, "temporal SH degree", "temporal degree 3"},
        {{5, 15, 4, 5, 3, 0, 21, 1}, "21 items", "a tuple of another length"},
        {{5, 15, 4, 5, 3, 0, 19, NAN}, "finite", "NaN everywhere"},
        {{5, 15, 4, 5, 3, 0, 19, 0}, "finite", "quaternions without direction"},
        {{5, 15, 4, 5, 3, 0, 19, 400}, "finite", "scales beyond measure"},
    };
    const char *folder = new_folder(), *path = path_in(folder, "chkpnt1.pth");
    const struct shape good = {5, 47, 4, 5, 3, 2, 20, 1};
    struct spin_splats s = {0};
    struct run run;

    ok(run_open(NULL, write_checkpoint(path, &good), &run) == SPIN_OK &&
           strstr(run.sequence.notes, "a mask that a fork") &&
           strstr(run.sequence.variant, "iteration 123"),
       "a fork's 20 items are read, its mask is not");
    if (run.self) {
        ok(run.importer->frame(run.self, 0, 1, run.sequence.columns, &s) == SPIN_OK && s.n == 5,
           "and give their Gaussians");
        check_sane(&s, run.sequence.columns, "which are sane");
    } else {
        printf("#   %s\n", spin_last_error());
    }
    run_close(&run);
    spin_splats_free(&s);
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        write_checkpoint(path, &cases[i].s);
        fails(FROM, path, cases[i].word, cases[i].what);
        ok(strstr(spin_last_error(), "chkpnt1.pth") != NULL, "  and the file is named");
    }
    for (size_t i = 0; i < sizeof makers / sizeof *makers; i++)
        fails(FROM, write_tuple(path, makers[i].n), makers[i].of, "a model of another method");
    fails(FROM, write_tuple(path, 19), "xyz", "a tuple of the right length without tensors");
    fails(FROM, new_folder(), "chkpnt<N>.pth", "a folder without checkpoints");
    fails(FROM, "no/such.pth", "no/such.pth", "a missing file");
}

/* The form of loaded_pth: features with exchanged axes. */
static void test_dicts(void)
{
    const char *folder = new_folder(), *path = path_in(folder, "init.pth");
    static const struct {
        const char *key;
        int b, c;
    } items[] = {{"xyz", 3, 0},       {"features_dc", 3, 1}, {"features_rest", 3, 47},
                 {"t", 1, 0},         {"scaling", 3, 0},     {"rotation", 4, 0},
                 {"scaling_t", 1, 0}, {"rotation_r", 4, 0},  {"opacity", 1, 0}};
    struct writer w;
    struct run run;

    for (int fork = 0; fork < 2; fork++) {
        begin_stream(&w, path);
        put_bytes(&w, fork ? "(}(" : "}(", fork ? 3 : 2);
        for (size_t i = 0; i < sizeof items / sizeof *items; i++) {
            char key[32];

            snprintf(key, sizeof key, "%s%s", fork ? "_" : "", items[i].key);
            put_text(&w, key);
            if (fork && i == 1)
                put_tensor(&w, 6, 1, 3);
            else if (fork && i == 2)
                put_tensor(&w, 6, 47, 3);
            else
                put_tensor(&w, 6, items[i].b, items[i].c);
        }
        if (fork) {
            put_text(&w, "active_sh_degree");
            put_int(&w, 3);
            put_text(&w, "active_sh_degree_t");
            put_int(&w, 2);
            put_text(&w, "rot_4d");
            PUT(&w, "\x88");
        }
        PUT(&w, "u");
        if (fork) {
            put_int(&w, 77);
            PUT(&w, "t");
        }
        end_stream(&w, 1);
        ok(run_open(FROM, path, &run) == SPIN_OK && strstr(run.sequence.variant, "rot_4d") &&
               strstr(run.sequence.variant, "with time") &&
               (strstr(run.sequence.variant, "iteration 77") != NULL) == fork,
           fork ? "a fork's dict of attributes is read" : "the dict of loaded_pth is read");
        if (!run.self)
            printf("#   %s\n", spin_last_error());
        run_close(&run);
    }
}

static void test_hostile(void)
{
    const char *root = check_fixture("torch_container/malformed");
    char **names = NULL;
    size_t n = 0;

    if (!root || spin_folder_list(root, &names, &n) != SPIN_OK) {
        skip("torch_container/malformed", "it is not here");
        return;
    }
    for (size_t i = 0; i < n; i++) {
        const char *path = path_in(root, names[i]);

        if (strstr(names[i], ".pth"))
            fails(FROM, path, names[i], names[i]);
    }
    spin_folder_list_free(names);
}

/* SH of degree 2 whose rows use what the arguments select: the remaining degree, with or without
 * cosines. */
static bool zeros_leave(int used, bool cosines, int degree)
{
    struct spin_model m = {0};
    struct spin_splats_4d *s = &m.splats_4d;
    bool good = spin_splats_4d_reserve(s, 3, 1, 2, SPIN_4D_SH_COS) == SPIN_OK;
    size_t n_used = 3 * (size_t)((used + 1) * (used + 1));
    size_t width = 3 * (size_t)((degree + 1) * (degree + 1));

    for (size_t i = 0; good && i < 3; i++)
        for (size_t c = 0; c < n_used; c++)
            s->sh[27 * i + c] = (float)(100 * i + c);
    if (good && cosines)
        s->sh_cos[54 * 2 + 53] = 1;
    spin_gaussian4d_drop_zeros(&m);
    good = good && s->sh_degree == degree && (s->sh_cos != NULL) == cosines;
    for (size_t i = 0; good && i < 3; i++)
        for (size_t c = 0; c < width; c++)
            good = good && s->sh[width * i + c] == (c < n_used ? (float)(100 * i + c) : 0);
    spin_splats_4d_free(s);
    return good;
}

static void test_zeros(void)
{
    ok(zeros_leave(2, false, 2), "cosines of 0 are not kept");
    ok(zeros_leave(1, false, 1), "nor a degree that is 0 in all rows");
    ok(zeros_leave(0, false, 0), "or two");
    ok(zeros_leave(0, true, 2), "with one cosine that is not 0 all are");
}

TAP_MAIN
{
    const char *root = check_fixture("realtime4dgs");

    spin_log_set_level(-2);
    test_zeros();
    test_refused();
    test_dicts();
    test_hostile();
    test_stale();
    if (!root) {
        skip("realtime4dgs fixtures", "there are none here");
        return;
    }
    if (has(root, "rot4d_sht"))
        test_times(root);
    test_conventions(root);
    test_notes(root);
    ok(read_truncations(FROM, path_in(root, "dim3_static/chkpnt7000.pth")) == 0,
       "no truncation of a checkpoint can be read");
    survive_flips(FROM, path_in(root, "dim3_static/chkpnt7000.pth"));
}
