/* freetimegs: the number of frames of a clip, files of another writer, and malformed files.
 * K: freetimegs ftgs_ply ftgs import 4d */
#include "tests/importers/models.h"
#include "scene/probe.h"
#include "tests/importers/slices.h"

#define FROM "freetimegs"

static void test_frames(const char *path, const char *folder, const char *name)
{
    spin_json *manifest = load_manifest(folder);
    double n_frames = 300;
    struct run run;

    spin_json_number(spin_json_get(manifest, "n_frames"), &n_frames);
    ok(run_open(FROM, path, &run) == SPIN_OK && run.sequence.n_clip_frames == (int)n_frames &&
           run.sequence.time_first == 0 && run.sequence.time_last == 1,
       "%s: %g frames from 0 to 1", name, n_frames);
    spin_json_free(manifest);
    run_close(&run);
}

/* ---- Malformed checkpoints --------------------------------------------------------------------
 */

static void load(const char *path, struct pth *pth)
{
    struct spin_torch torch;

    memset(pth, 0, sizeof *pth);
    if (spin_torch_open(path, &torch) != SPIN_OK)
        exit(1);
    pth_load_dict(&torch, spin_value_get(torch.root, "splats"), 0, pth);
    pth->within = "splats";
    spin_torch_close(&torch);
}

static void test_checkpoint(const char *from)
{
    static const struct {
        const char *drop, *put;
        int n_dims;
        uint64_t shape[3]; /* 0: of all Gaussians */
        const char *key, *text, *number, *yes, *word, *what;
    } lies[] = {
        {"velocities", NULL, 0, {0}, 0, 0, 0, 0, "gsplat without time", "no velocities"},
        {"means", NULL, 0, {0}, 0, 0, 0, 0, "'means'", "no means"},
        {NULL, "marginal_gates", 2, {0, 1}, 0, 0, 0, 0, "marginal_gates", "a tenth tensor"},
        {NULL, "shN", 3, {0, 4, 3}, 0, 0, 0, 0, "shN has 4 rows", "SH of no degree"},
        {NULL, "scales", 2, {7, 3}, 0, 0, 0, 0, "scales", "another number of scales"},
        {NULL, "quats", 2, {0, 3}, 0, 0, 0, 0, "quats", "quaternions of three"},
        {NULL, NULL, 0, {0}, "time_units", "seconds", 0, 0, "'seconds'", "times in seconds"},
        {NULL,
         NULL,
         0,
         {0},
         "duration_activation",
         "softplus",
         0,
         0,
         "'softplus'",
         "durations of another kind"},
        {NULL, NULL, 0, {0}, "model_spec", "v2", 0, 0, "'model_spec'", "a model of another kind"},
        {NULL, NULL, 0, {0}, 0, 0, 0, "model_spec", "'model_spec'", "one that is said by a number"},
        {NULL,
         NULL,
         0,
         {0},
         0,
         0,
         "use_color_velocity",
         0,
         "use_color_velocity",
         "colours that move"},
        {NULL, NULL, 0, {0}, "use_velocity", "False", 0, 0, "'use_velocity'", "a text for a bool"},
        {NULL, NULL, 0, {0}, 0, 0, "n_frames", 0, "'n_frames' is -1", "frames below 1"},
        {NULL, NULL, 0, {0}, 0, 0, 0, "use_marginal_gating", "use_marginal_gating", "gates"},
    };
    const char *path = path_in(new_folder(), "ckpt_7.pt");
    struct pth pth;
    struct run run;
    size_t n;

    for (size_t i = 0; i < sizeof lies / sizeof *lies; i++) {
        uint64_t shape[3];

        load(from, &pth);
        n = pth_find(&pth, "means")->shape[0];
        for (int d = 0; d < 3; d++)
            shape[d] = d == 0 && lies[i].shape[0] == 0 ? n : lies[i].shape[d];
        if (lies[i].drop)
            pth_drop(&pth, lies[i].drop);
        if (lies[i].put)
            pth_put(&pth, lies[i].put, lies[i].n_dims, shape);
        pth.key = lies[i].key;
        pth.text = lies[i].text;
        pth.number = lies[i].number;
        pth.yes = lies[i].yes;
        pth_save(&pth, path);
        fails(FROM, path, lies[i].word, lies[i].what);
        pth_free(&pth);
    }
    load(from, &pth);
    pth.yes = "color_correction";
    pth_save(&pth, path);
    pth_free(&pth);
    ok(run_open(NULL, path, &run) == SPIN_OK && strstr(run.sequence.notes, "'color_correction'"),
       "colours that were corrected for each camera are noted");
    run_close(&run);
    load(from, &pth);
    pth_find(&pth, "means")->values[0] = NAN;
    memset(pth_find(&pth, "quats")->values + 4, 0, 4 * sizeof(float));
    pth_find(&pth, "durations")->values[2] = 200;
    pth_find(&pth, "durations")->values[3] = -INFINITY;
    pth_find(&pth, "durations")->n_dims = 1;
    pth_save(&pth, path);
    pth_free(&pth);
    ok(run_open(NULL, path, &run) == SPIN_OK && !strcmp(run.importer->name, FROM) &&
           strstr(run.sequence.notes, "3 of ") != NULL,
       "NaN, no rotation and a duration beyond floats are dropped and counted; durations may be "
       "flat");
    printf("# %s\n", run.sequence.notes);
    run_close(&run);
    ok(read_truncations(FROM, from) == 0, "no truncation of a checkpoint can be read");
    survive_flips(FROM, from);
}

/* ---- Malformed PLYs ---------------------------------------------------------------------------
 */

static void test_ply(const char *path)
{
    static const struct {
        const char *line, *other, *word, *what;
    } lies[] = {
        {"comment ftgs_version 1\n", "", "no comment 'ftgs_version'", "no version"},
        {"ftgs_version 1", "ftgs_version 2", "ftgs_version is 2", "a later version"},
        {"units normalized", "units seconds", "'seconds'", "another unit of time"},
        {"units normalized", "units normalized2", "'normalized2", "and one that begins alike"},
        {"comment sh_degree", "comment duration_activation softplus\ncomment sh_degree",
         "'softplus'", "durations of another kind"},
        {"comment sh_degree", "comment model_spec v2\ncomment sh_degree", "'model_spec'",
         "another model"},
        {"sh_degree ", "sh_degree 9 ", "'sh_degree'", "a degree that is none"},
        {"min_duration ", "min_duration 0 ", "'min_duration'", "no least duration"},
        {"min_duration ", "min_duration -", "'min_duration'", "a least duration below 0"},
        {"opacity_floor ", "opacity_floor 1", "'opacity_floor'", "a floor that is a ceiling"},
        {"comment use_velocity ", "comment use_speed ", "'use_velocity'", "not said if it moves"},
        {"property float log_duration", "property float lag_duration", "log_duration",
         "a property of another name"},
        {"property float rot_3", "property int rot_3", "'rot_3'", "a property of another type"},
        {"property float f_dc_2", "property float f_dd_2", "'f_dc_2'", "no blue"},
        {"n_frames ", "n_frames 1e12 ", "'n_frames'", "more frames than there can be"},
    };

    for (size_t i = 0; i < sizeof lies / sizeof *lies; i++)
        fails(NULL, with_line(path, lies[i].line, lies[i].other), lies[i].word, lies[i].what);
    ok(read_truncations(FROM, path) == 0, "no truncation of a PLY can be read");
    survive_flips(FROM, path);
}

/* Other methods use the same names of folders and checkpoints. */
static void test_foreign_folder(const char *checkpoint)
{
    const char *run = new_folder(), *alone = new_folder();
    const struct spin_importer *found = NULL;

    if (spin_folder_make(path_in(run, "ckpts")) != SPIN_OK)
        exit(1);
    write_text(path_in(run, "ckpts/ckpt_6999.pt"), "means scales quats opacities sh0 shN");
    write_text(path_in(alone, "ckpt_6999.pt"), "means scales quats opacities sh0 shN");
    ok(spin_importer_find(run, NULL, false, &found) == SPIN_E_NOT_RECOGNISED &&
           spin_importer_find(alone, NULL, false, &found) == SPIN_E_NOT_RECOGNISED,
       "a folder with the checkpoint of another method is not recognised");
    copy_file(checkpoint, path_in(alone, "ckpt_6999.pt"));
    ok(spin_importer_find(alone, NULL, false, &found) == SPIN_OK && !strcmp(found->name, FROM),
       "and one with its own checkpoint is");
}

TAP_MAIN
{
    const char **names = check_cases("freetimegs", "expected.npz");
    const char **clouds = check_cases("ftgs_ply", "expected.npz");
    const char *root = check_fixture("freetimegs"), *plys = check_fixture("ftgs_ply"), *file = NULL;

    spin_log_set_level(-2);
    fails(FROM, new_folder(), "contains no ckpt_<step>.pt", "a folder without checkpoints");
    if (!root || !plys) {
        skip("freetimegs fixtures", "there are none here");
        return;
    }
    for (size_t i = 0; names[i]; i++)
        test_frames(path_in(root, names[i]), path_in(root, names[i]), names[i]);
    for (size_t i = 0; clouds[i]; i++) {
        file = path_in(path_in(plys, clouds[i]), "scene.ftgs.ply");
        test_frames(file, path_in(plys, clouds[i]), clouds[i]);
    }
    if (file && spin_path_exists(path_in(plys, "sh1_clamped/scene.ftgs.ply")))
        test_ply(path_in(plys, "sh1_clamped/scene.ftgs.ply"));
    if (names[0]) {
        const char *folder = path_in(path_in(root, names[0]), "ckpts"), *first = NULL;
        char **entries;
        size_t n;

        if (spin_folder_list(folder, &entries, &n) != SPIN_OK || n == 0)
            exit(1);
        first = path_in(folder, entries[n - 1]);
        test_checkpoint(first);
        test_foreign_folder(first);
        spin_folder_list_free(entries);
    }
    free(names);
    free(clouds);
}
