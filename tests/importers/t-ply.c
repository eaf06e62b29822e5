/* ply: every writer's layout against what the INRIA reader yields, sequences, and files that lie.
 * K: ply import */
#include "tests/importers/expected_clouds.h"

#include <sys/stat.h>

/* ---- Fixtures -------------------------------------------------------------------------------- */

static void test_files(const char *folder, const char *name, const spin_json *manifest)
{
    const spin_json *files = spin_json_get(manifest, "files"),
                    *n = spin_json_get(manifest, "gaussians");
    const char *first = path_in(folder, spin_json_string(spin_json_at(files, 0)));
    const struct spin_importer *found = NULL;
    struct run run;

    ok(spin_importer_find(folder, NULL, false, &found) == SPIN_OK && !strcmp(found->name, "ply"),
       "%s: the folder is recognised", name);
    ok(spin_importer_find(first, NULL, false, &found) == SPIN_OK && !strcmp(found->name, "ply"),
       "%s: so is a file", name);
    if (run_open("ply", folder, &run) == SPIN_OK) {
        near(run.sequence.n_frames, (double)spin_json_length(files), 0,
             "has every file as a frame");
        for (int f = 0; f < run.sequence.n_frames; f++) {
            double count = -1;

            spin_json_number(spin_json_at(n, (size_t)f), &count);
            near((double)run.sequence.counts[f], count, 0,
                 "knows a frame's count before reading it");
        }
        run_close(&run);
    }
    compare_run("ply", folder, path_in(folder, "expected.npz"), manifest, 0, name);
    ok(read_truncations("ply", first) == 0, "%s: no truncation of a file can be read", name);
}

static void test_cases(const char *folder, const spin_json *manifest)
{
    const spin_json *cases = spin_json_get(manifest, "cases");

    compare_run("ply", path_in(folder, "base.ply"), path_in(folder, "expected.npz"), manifest, 0,
                "base.ply");
    for (size_t i = 0; i < spin_json_length(cases); i++) {
        const spin_json *c = spin_json_at(cases, i);
        const char *file = spin_json_string(spin_json_get(c, "file"));
        const char *expect = spin_json_string(spin_json_get(c, "expect"));
        const char *why = spin_json_string(spin_json_get(c, "why"));
        const char *path = path_in(folder, file), *tolerance = strstr(expect, "tolerance ");
        char what[700];

        snprintf(what, sizeof what, "%s: %s", file, why ? why : "");
        if (strcmp(expect, "error") == 0) {
            fails("ply", path, NULL, what);
        } else if (strncmp(expect, "same_as:base", 12) == 0) {
            compare_run("ply", path, path_in(folder, "expected.npz"), manifest,
                        tolerance ? atof(tolerance + 10) : 0, file);
        } else {
            read_all("ply", path);
            ok(1, "%s is survived (expect '%s')", what, expect);
        }
        if (strcmp(file, "missing_opacity.ply") == 0)
            fails("ply", path, "'opacity'", "the missing property is named");
    }
}

/* ---- Files made here ------------------------------------------------------------------------- */

static const char gaussian[] =
    "x y z f_dc_0 f_dc_1 f_dc_2 opacity scale_0 scale_1 scale_2 rot_0 rot_1 "
    "rot_2 rot_3";

/* folder/name as a text PLY: float properties named in `names`, then the rows. */
static const char *write_ply(const char *folder, const char *name, const char *names, int n,
                             const char *rows)
{
    const char *path = path_in(folder, name);
    FILE *file = fopen(path, "wb");
    char copy[2000];

    if (!file)
        exit(1);
    snprintf(copy, sizeof copy, "%s", names);
    fprintf(file, "ply\nformat ascii 1.0\ncomment element vertex 9 end_header\nelement vertex %d\n",
            n);
    for (char *word = strtok(copy, " "); word; word = strtok(NULL, " "))
        fprintf(file, "property %s %s\n", strstr("red green blue", word) ? "uchar" : "float", word);
    fprintf(file, "end_header\n%s", rows);
    fclose(file);
    return path;
}

static void test_points(void)
{
    const char *folder = new_folder();
    struct spin_splats s = {0};
    struct run run;
    const char *path;

    write_ply(folder, "frame_9.ply", "x y z", 1, "1 2 3\n");
    write_ply(folder, "frame_12.ply", "x y z", 2, "4 5 6\n7 8 9\n");
    write_ply(folder, "frame_10.ply", "x y z", 0, "");
    write_ply(folder, "input.ply", "x y", 1, "1 2\n");
    ok(run_open(NULL, folder, &run) == SPIN_OK && run.sequence.n_frames == 3 &&
           run.sequence.columns == SPIN_COL_MEANS && run.sequence.sh_degree == -1,
       "points are positions only");
    ok(run.sequence.numbers && run.sequence.numbers[0] == 9 && run.sequence.numbers[1] == 10 &&
           run.sequence.numbers[2] == 12,
       "frames go by number, and input.ply is none");
    ok(strstr(run.sequence.notes, "gaps") && strstr(run.sequence.notes, "first is 11"),
       "a gap is noted");
    ok(run.importer->frame(run.self, 1, 0, SPIN_COL_MEANS, &s) == SPIN_OK && s.n == 0,
       "an empty frame of a sequence is legal");
    ok(run.importer->frame(run.self, 2, 0, SPIN_COL_MEANS, &s) == SPIN_OK && s.n == 2 &&
           s.means[3] == 7,
       "the last frame is the right file");
    run_close(&run);
    write_ply(folder, "other_012.ply", "x y z", 1, "1 2 3\n");
    fails("ply", folder, "both frame 12", "two files of one number");
    fails("ply", write_ply(folder, "a.ply", "x y z", 0, ""), "0 vertices", "an empty single file");
    remove(path_in(folder, "other_012.ply"));
    fails("ply", folder, "no frame number", "a file without a number among numbered ones");

    path = write_ply(new_folder(), "c.ply", "x y z red green blue", 1, "1 2 3 255 0 51\n");
    ok(run_open("ply", path, &run) == SPIN_OK &&
           run.sequence.columns == (SPIN_COL_MEANS | SPIN_COL_RGB) && !run.sequence.numbers &&
           run.importer->frame(run.self, 0, 0, run.sequence.columns, &s) == SPIN_OK,
       "coloured points");
    near(s.rgb[0], 1, 1e-6, "a byte of 255 is 1");
    near(s.rgb[2], 0.2, 1e-6, "a byte of 51 is 0.2");
    run_close(&run);
    spin_splats_free(&s);
}

static void test_values(void)
{
    const char *folder = new_folder();
    struct spin_splats s = {0};
    struct run run;
    const char *path;

    path = write_ply(folder, "g.ply", gaussian, 2,
                     "0 0 0 0 0 0 inf -3 -3 -3 0 0 0 0\n0 0 0 0 0 0 -inf -3 -3 -3 0 0 0 2\n");
    ok(run_open("ply", path, &run) == SPIN_OK &&
           run.importer->frame(run.self, 0, 0, run.sequence.columns, &s) == SPIN_OK &&
           s.logit_opacities[0] == 30 && s.logit_opacities[1] == -30,
       "infinite opacities are clamped");
    ok(s.quats[0] == 1 && s.quats[4] == 0 && s.quats[7] == 1,
       "rotations are made unit quaternions");
    run_close(&run);
    spin_splats_free(&s);
    path = write_ply(folder, "nan.ply", gaussian, 2,
                     "0 0 0 0 0 0 0 -3 -3 -3 1 0 0 0\n0 0 nan 0 0 0 0 -3 -3 -3 1 0 0 0\n");
    fails("ply", path, "row 1", "NaN in a position, with its row");
    path = write_ply(folder, "nan2.ply", gaussian, 1, "0 0 0 0 0 0 nan -3 -3 -3 1 0 0 0\n");
    fails("ply", path, "opacity", "NaN in an opacity");
    path = write_ply(folder, "inf.ply", gaussian, 1, "0 0 0 0 0 0 1 inf -3 -3 1 0 0 0\n");
    fails("ply", path, "scale", "an infinite scale");
}

static void test_refused(void)
{
    static const struct {
        const char *names, *word, *what;
    } cases[] = {
        {"x y", "'z'", "no z"},
        {"x y z f_dc_0 f_dc_1 f_dc_2 opacity scale_0 scale_1 rot_0 rot_1 rot_2 rot_3", "2DGS",
         "2DGS"},
        {"x y z f_dc_0 f_dc_1 f_dc_2 opacity scale_0 scale_1 scale_2 rot_0 rot_1 rot_2", "'rot_3'",
         "no rot_3"},
        {"x y z f_dc_0 f_dc_1 opacity scale_0 scale_1 scale_2 rot_0 rot_1 rot_2 rot_3", "'f_dc_2'",
         "no f_dc_2"},
        {"x y z t f_dc_0 opacity scale_0 scale_1 scale_2 scale_t rot_0 rot_r_0", "Realtime-4DGS",
         "a 4D model of Realtime-4DGS"},
        {"x y z trbf_center motion_0 omega_0 opacity", "SpacetimeGaussians",
         "a 4D model of SpacetimeGaussians"},
        {"x y z f_dc_0 f_dc_1 f_dc_2 f_rest_0 opacity scale_0 scale_1 scale_2 rot_0 rot_1 rot_2 "
         "rot_3",
         "expected 0, 9", "one f_rest"},
        {"x y z packed_position", "packed_rotation", "half of a compressed PLY"},
    };
    const char *folder = new_folder();

    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++)
        fails("ply", write_ply(folder, "r.ply", cases[i].names, 0, ""),
              i == 7 ? "compressed" : cases[i].word, cases[i].what);
    remove(path_in(folder, "r.ply"));
    write_ply(folder, "1.ply", "x y z", 1, "1 2 3\n");
    write_ply(folder, "2.ply", "x y z nx", 1, "1 2 3 4\n");
    fails("ply", folder, "other vertex properties", "frames with different properties");
    fails("ply", new_folder(), "holds neither", "an empty folder");
    fails("ply", "no/such.ply", "no/such.ply", "a missing file is named");
}

/* model/frame7/point_cloud/iteration_<n>/point_cloud.ply */
static void test_tree(void)
{
    const char *folder = new_folder();
    struct spin_splats s = {0};
    struct run run;

    spin_folder_make(path_in(folder, "frame7/point_cloud/iteration_7000"));
    spin_folder_make(path_in(folder, "frame7/point_cloud/iteration_30000"));
    spin_folder_make(path_in(folder, "frame7/point_cloud/iteration_40000/added"));
    write_ply(folder, "frame7/point_cloud/iteration_7000/point_cloud.ply", "x y z", 1, "1 0 0\n");
    write_ply(folder, "frame7/point_cloud/iteration_30000/point_cloud.ply", "x y z", 1, "2 0 0\n");
    ok(run_open("ply", folder, &run) == SPIN_OK && run.sequence.n_frames == 1 &&
           run.sequence.numbers && run.sequence.numbers[0] == 7 &&
           run.importer->frame(run.self, 0, 0, SPIN_COL_MEANS, &s) == SPIN_OK && s.means[0] == 2,
       "a per-frame folder gives its largest iteration");
    run_close(&run);
    ok(run_open("ply", path_in(folder, "frame7"), &run) == SPIN_OK && run.sequence.n_frames == 1,
       "so does a model's own folder");
    run_close(&run);
    spin_splats_free(&s);
}

TAP_MAIN
{
    const char *root = check_fixture("ply");
    char **names = NULL;
    size_t n = 0;

    spin_log_set_level(-1);
    test_points();
    test_values();
    test_refused();
    test_tree();
    if (!root || spin_folder_list(root, &names, &n) != SPIN_OK) {
        skip("ply fixtures", "there are none here");
        return;
    }
    for (size_t i = 0; i < n; i++) {
        const char *folder = path_in(root, names[i]);
        spin_json *manifest = load_manifest(folder);

        if (!manifest)
            continue;
        if (spin_json_get(manifest, "files"))
            test_files(folder, names[i], manifest);
        if (spin_json_get(manifest, "cases"))
            test_cases(folder, manifest);
        spin_json_free(manifest);
    }
    spin_folder_list_free(names);
}
