/* ply: every writer's layout compared with the INRIA reader, sequences, and malformed files.
 * K: ply import */
#include "tests/importers/expected_clouds.h"
#include "tests/importers/models.h"

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
    path = write_ply(new_folder(), "t.ply", "x y z t", 1, "1 2 3 4\n");
    ok(run_open("ply", path, &run) == SPIN_OK && run.sequence.columns == SPIN_COL_MEANS,
       "points with a time each are no 4D model");
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

/* ---- Flat splats, single bad splats, positions far from 0 --------------------------------------
 */

#define FLAT "x y z f_dc_0 f_dc_1 f_dc_2 opacity scale_0 scale_1 rot_0 rot_1 rot_2 rot_3"

static void test_flat(void)
{
    const char *folder = new_folder();
    struct spin_splats s = {0};
    struct run run;

    ok(run_open("ply",
                write_ply(folder, "a.ply", gaussian, 1, "0 0 0 0 0 0 1 -1 -inf -3 1 0 0 0\n"),
                &run) == SPIN_OK &&
           run.importer->frame(run.self, 0, 0, run.sequence.columns, &s) == SPIN_OK,
       "a log scale of -infinity is read");
    near(s.log_scales[1], -87.498, 1e-3, "as that of a scale of 0");
    run_close(&run);
    ok(run_open("ply", write_ply(folder, "b.ply", FLAT, 1, "0 0 0 0 0 0 1 -1 -2 1 0 0 0\n"),
                &run) == SPIN_OK &&
           run.importer->frame(run.self, 0, 0, run.sequence.columns, &s) == SPIN_OK,
       "2DGS, without scale_2, is read");
    near(s.log_scales[2], -2 - 6.907755, 1e-5, "as thin splats");
    run_close(&run);
    spin_splats_free(&s);
}

/* Writes n rows, the first n_bad of which have a nonfinite position. */
static const char *write_bad(const char *folder, int n, int n_bad)
{
    const char *path = write_ply(folder, "bad.ply", gaussian, n, "");
    FILE *file = fopen(path, "ab");

    if (!file)
        exit(1);
    for (int i = 0; i < n; i++)
        fprintf(file, "%s 0 0 0 0 0 0 -3 -3 -3 1 0 0 0\n", i < n_bad ? "nan" : "7");
    fclose(file);
    return path;
}

static void test_dropped(void)
{
    const char *const strict[] = {"strict", "", NULL};
    const char *folder = new_folder();
    struct spin_splats s = {0};
    struct run run;

    ok(run_open("ply", write_bad(folder, 2000, 2), &run) == SPIN_OK &&
           run.importer->frame(run.self, 0, 0, run.sequence.columns, &s) == SPIN_OK &&
           s.n == 1998 && s.means[0] == 7 && s.log_scales[0] == -3,
       "2 of 2,000 splats that are not finite are dropped");
    run_close(&run);
    ok(model_open("ply", path_in(folder, "bad.ply"), strict, &run) == SPIN_OK &&
           run.importer->frame(run.self, 0, 0, run.sequence.columns, &s) == SPIN_E_MALFORMED,
       "but refused with --strict");
    run_close(&run);
    fails("ply", write_bad(folder, 2997, 3), "not finite", "3 of 2,997");
    spin_splats_free(&s);
}

static void test_far(void)
{
    const char *path = write_ply(new_folder(), "far.ply", "x y z", 3,
                                 "448262.001 5411932.002 120\n448263.003 5411933.004 121\n"
                                 "448264.25 5411931.125 119\n");
    struct spin_splats s = {0};
    struct run run;

    ok(run_open("ply", path, &run) == SPIN_OK && run.sequence.shift[0] == 448263 &&
           run.sequence.shift[1] == 5411932 &&
           run.importer->frame(run.self, 0, 0, SPIN_COL_MEANS, &s) == SPIN_OK,
       "positions far from 0 are shifted");
    near(run.sequence.shift[0] + (double)s.means[0], 448262.001, 1e-6, "x keeps its digits");
    near(run.sequence.shift[1] + (double)s.means[4], 5411933.004, 1e-6, "and y");
    near(s.means[5], 121 - run.sequence.shift[2], 1e-6, "and z");
    run_close(&run);
    spin_splats_free(&s);
}

/* ---- Rare layouts */

static const char *text_in(const char *folder, const char *name, const char *text)
{
    const char *path = path_in(folder, name);
    FILE *file = fopen(path, "wb");

    if (!file || fputs(text, file) < 0 || fclose(file) != 0)
        exit(1);
    return path;
}

#define PLACE "property float x\nproperty float y\nproperty float z\n"
#define RGB16 "property ushort red\nproperty ushort green\nproperty ushort blue\n"
#define SHAPE                                                                                      \
    "property float opacity\nproperty float scale_0\nproperty float scale_1\n"                     \
    "property float scale_2\nproperty float rot_0\nproperty float rot_1\nproperty float rot_2\n"   \
    "property float rot_3\n"

/* Colours of 16 bits, whatever the largest of them is: of points, and of Gaussians without f_dc. */
static void test_colours_of_16_bits(void)
{
    static const char binary[] = "ply\nformat binary_big_endian 1.0\nelement vertex 1\n" PLACE RGB16
                                 "end_header\n\0\0\0\0\0\0\0\0\0\0\0\0\x33\x33\0\xff\xff\xff";
    const char *folder = new_folder();
    struct spin_splats s = {0};
    struct run run;
    FILE *file;

    ok(run_open(NULL,
                text_in(folder, "a.ply",
                        "ply\nformat ascii 1.0\nelement vertex 2\n" PLACE RGB16
                        "end_header\n1 2 3 65535 0 13107\n4 5 6 100 200 255\n"),
                &run) == SPIN_OK &&
           run.sequence.columns == (SPIN_COL_MEANS | SPIN_COL_RGB) &&
           run.importer->frame(run.self, 0, 0, run.sequence.columns, &s) == SPIN_OK && s.n == 2,
       "points with colours of 16 bits");
    near(s.rgb[0], 1, 1e-6, "65535 is 1");
    near(s.rgb[2], 0.2, 1e-6, "13107 is 0.2");
    near(s.rgb[5], 255 / 65535.0, 1e-6, "255 is dark");
    run_close(&run);
    file = fopen(path_in(folder, "b.ply"), "wb");
    if (!file || fwrite(binary, 1, sizeof binary - 1, file) != sizeof binary - 1 ||
        fclose(file) != 0)
        exit(1);
    ok(run_open(NULL, path_in(folder, "b.ply"), &run) == SPIN_OK &&
           run.importer->frame(run.self, 0, 0, run.sequence.columns, &s) == SPIN_OK,
       "the same in binary, the high byte first");
    near(s.rgb[0], 0.2, 1e-6, "0x3333 is 0.2");
    near(s.rgb[1], 255 / 65535.0, 1e-6, "0x00ff is dark");
    near(s.rgb[2], 1, 1e-6, "0xffff is 1");
    run_close(&run);
    ok(run_open(NULL,
                text_in(folder, "c.ply",
                        "ply\nformat ascii 1.0\nelement vertex 1\n" PLACE RGB16 SHAPE
                        "end_header\n1 2 3 51 0 200 7 -1 -1 -1 1 0 0 0\n"),
                &run) == SPIN_OK &&
           run.importer->frame(run.self, 0, 0, run.sequence.columns, &s) == SPIN_OK &&
           s.sh_degree == 0,
       "Gaussians with them");
    near(s.sh[0] * 0.28209479, 51 / 65535.0 - 0.5, 1e-6, "51 is dark, where nothing is bright");
    near(s.sh[2] * 0.28209479, 200 / 65535.0 - 0.5, 1e-6, "200 is dark");
    run_close(&run);
    spin_splats_free(&s);
}

/* Text files with other elements before and after the vertices, one of which has lists. */
static void test_second_element(void)
{
    static const char head[] =
        "ply\nformat ascii 1.0\nelement camera 2\nproperty float fx\nproperty list "
        "uchar int seen\nproperty float fy\nelement vertex 2\n" PLACE SHAPE
        "property float f_dc_0\nproperty float f_dc_1\nproperty float f_dc_2\n"
        "element face 1\nproperty list uchar int vertex_indices\nend_header\n";
    static const char rows[] = "500 2 0 1 501\n600 0 601\n1 2 3 4 -5 -6 -7 1 0 0 0 11 12 13\n"
                               "21 22 23 24 -5 -6 -7 0 1 0 0 31 32 33\n";
    char text[1200];
    const char *folder = new_folder();
    struct spin_splats s = {0};
    struct run run;

    snprintf(text, sizeof text, "%s%s3 0 1 1\n", head, rows);
    ok(run_open(NULL, text_in(folder, "a.ply", text), &run) == SPIN_OK &&
           run.importer->frame(run.self, 0, 0, run.sequence.columns, &s) == SPIN_OK && s.n == 2,
       "vertices between cameras and faces");
    ok(s.means[0] == 1 && s.means[5] == 23 && s.logit_opacities[1] == 24 && s.log_scales[2] == -7 &&
           s.quats[5] == 1 && s.sh[0] == 11 && s.sh[5] == 33,
       "are those that are read");
    run_close(&run);
    snprintf(text, sizeof text, "%s%s", head, rows);
    fails("ply", text_in(folder, "b.ply", text), "element 'face' record 0",
          "a face that is missing is named");
    snprintf(text, sizeof text, "%s%s3 0 1\n", head, rows);
    fails("ply", text_in(folder, "c.ply", text), "element 'face' record 0",
          "a list that is too short");
    spin_splats_free(&s);
}

/* A frame of SH degree 1 between frames of degree 0, read into the same columns. */
static void test_lower_degree(void)
{
    static const char rest[] =
        " f_rest_0 f_rest_1 f_rest_2 f_rest_3 f_rest_4 f_rest_5 f_rest_6 f_rest_7 f_rest_8";
    char names[300];
    const char *folder = new_folder();
    struct spin_splats s = {0};
    struct run run;
    int n_rest = 0;

    snprintf(names, sizeof names, "%s%s", gaussian, rest);
    write_ply(folder, "1.ply", gaussian, 1, "1 2 3 4 5 6 7 -1 -1 -1 1 0 0 0\n");
    write_ply(folder, "2.ply", names, 1, "1 2 3 4 5 6 7 -1 -1 -1 1 0 0 0 1 2 3 4 5 6 7 8 9\n");
    write_ply(folder, "3.ply", gaussian, 1, "9 2 3 14 15 16 7 -1 -1 -1 1 0 0 0\n");
    if (!ok(run_open(NULL, folder, &run) == SPIN_OK && run.sequence.n_frames == 3 &&
                run.sequence.sh_degree == 1 &&
                strstr(run.sequence.notes, "missing SH are set to 0"),
            "a lower SH degree before and after a higher one: the higher, and a note"))
        return;
    for (int f = 1; f <= 3; f++) {
        ok(run.importer->frame(run.self, f % 3, 0, run.sequence.columns, &s) == SPIN_OK &&
               s.sh_degree == 1 && s.sh[0] == (f == 2 ? 14 : 4),
           "frame %d", f % 3);
        for (int k = 3; k < 12; k++)
            n_rest += s.sh[k] != 0;
        if (f == 1)
            ok(n_rest == 9 && s.sh[3] == 1 && s.sh[4] == 4 && s.sh[11] == 9, "has its own SH");
    }
    ok(n_rest == 9, "the others have none, whatever was read before");
    run_close(&run);
    spin_splats_free(&s);
}
#define GAUSSIAN                                                                                   \
    "x y z f_dc_0 f_dc_1 f_dc_2 opacity scale_0 scale_1 scale_2 rot_0 rot_1 rot_2 rot_3"

static void test_refused(void)
{
    static const struct {
        const char *names, *word, *what;
    } cases[] = {
        {"x y", "'z'", "no z"},
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
        {GAUSSIAN " time log_duration velocity_0 velocity_1 velocity_2",
         "'log_duration' belongs to a 4D model, probably of FreeTimeGS", "a .ftgs.ply"},
        {GAUSSIAN " vx vy vz t_center t_sigma",
         "'t_center' belongs to a 4D model, probably of the PLY for .sogst, not",
         "the interchange PLY of .sogst"},
    };
    const char *folder = new_folder();

    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++)
        fails("ply", write_ply(folder, "r.ply", cases[i].names, 0, ""),
              i == 6 ? "compressed" : cases[i].word, cases[i].what);
    remove(path_in(folder, "r.ply"));
    write_ply(folder, "1.ply", "x y z", 1, "1 2 3\n");
    write_ply(folder, "2.ply", "x y z nx", 1, "1 2 3 4\n");
    fails("ply", folder, "other vertex properties", "frames with different properties");
    fails("ply", new_folder(), "contains neither", "an empty folder");
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
    test_flat();
    test_dropped();
    test_far();
    test_colours_of_16_bits();
    test_second_element();
    test_lower_degree();
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
