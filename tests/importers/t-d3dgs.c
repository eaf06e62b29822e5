/* d3dgs: layouts, the altered files of the fixtures, and malformed files.
 * K: d3dgs import */
#include <sys/resource.h>

#include "tests/importers/golden.h"

static void test_input(const char *folder, const char *name, const spin_json *manifest)
{
    const struct spin_importer *found = NULL;
    const char *path = path_in(folder, spin_json_string(spin_json_get(manifest, "input")));
    double frames = -1, gaussians = -1;
    struct run run;

    ok(spin_importer_find(path, NULL, false, &found) == SPIN_OK && !strcmp(found->name, "d3dgs"),
       "%s: the file is recognised", name);
    if (strcmp(spin_path_name(path), "params.npz") == 0)
        ok(spin_importer_find(folder, NULL, false, &found) == SPIN_OK &&
               !strcmp(found->name, "d3dgs") && read_all("d3dgs", folder) == SPIN_OK,
           "%s: so is its folder", name);
    if (run_open("d3dgs", path, &run) == SPIN_OK) {
        spin_json_number(spin_json_get(manifest, "frames"), &frames);
        spin_json_number(spin_json_get(manifest, "gaussians"), &gaussians);
        near(run.sequence.n_frames, frames, 0, "as many frames as the manifest says");
        near((double)run.sequence.counts[0], gaussians, 0,
             "as many Gaussians as the manifest says");
        ok(run.sequence.static_columns == (SPIN_COL_LOG_SCALES | SPIN_COL_LOGIT_OPACITIES),
           "%s: scales and opacities are still", name);
        run_close(&run);
    }
    ok(run.sequence.sh_degree == 0, "%s: has degree-0 SH", name);
    ok(read_truncations("d3dgs", path) == 0, "%s: no truncation of it can be read", name);
}

/* cases: file, expect "error" or "same_as:<name>...", why */
static void test_cases(const char *folder, const spin_json *manifest, const char *siblings)
{
    const spin_json *cases = spin_json_get(manifest, "cases");

    for (size_t i = 0; i < spin_json_length(cases); i++) {
        const spin_json *c = spin_json_at(cases, i);
        const char *file = spin_json_string(spin_json_get(c, "file"));
        const char *expect = spin_json_string(spin_json_get(c, "expect"));
        const char *why = spin_json_string(spin_json_get(c, "why"));
        const char *path = path_in(folder, file), *base;
        char what[700], name[64] = "";

        snprintf(what, sizeof what, "%s: %s", file, why ? why : "");
        if (strcmp(expect, "error") == 0) {
            fails("d3dgs", path, NULL, what);
        } else if (sscanf(expect, "same_as:%63[A-Za-z0-9_.-]", name) == 1) {
            base = path_in(siblings, name);
            golden_as("d3dgs", path, NULL, base, 0, file);
        } else {
            read_all("d3dgs", path);
            ok(1, "%s is survived (expect '%s')", what, expect);
        }
    }
}

/* ---- Files made here ------------------------------------------------------------------------- */

enum { T = 3, N = 4 };

struct member {
    const char *name, *descr;
    int n_dims;
    uint64_t shape[3];
    const void *data;
};

static float numbers[T * N * 4];
static double doubles[T * N * 4];

/* A small complete run; `change` replaces the member of its name (data NULL: drops it). */
static const char *make_run(const struct member *change)
{
    static const char *folder;
    static int count;
    const char *path;
    char name[40];
    struct member m[] = {
        {"means3D", "<f4", 3, {T, N, 3}, numbers},
        {"rgb_colors", "<f4", 3, {T, N, 3}, numbers},
        {"unnorm_rotations", "<f4", 3, {T, N, 4}, numbers},
        {"logit_opacities", "<f4", 2, {N, 1}, numbers},
        {"log_scales", "<f4", 2, {N, 3}, numbers},
    };
    struct spin_zip_writer w;
    bool known = false;

    if (!folder)
        folder = new_folder();
    snprintf(name, sizeof name, "run-%d.npz", count++);
    path = path_in(folder, name);
    if (spin_zip_writer_open(path, true, &w) != SPIN_OK)
        exit(1);
    for (size_t i = 0; i <= sizeof m / sizeof *m; i++) {
        const struct member *now = i < sizeof m / sizeof *m ? &m[i] : change;

        if (i < sizeof m / sizeof *m && change && strcmp(change->name, m[i].name) == 0) {
            now = change;
            known = true;
        } else if (i == sizeof m / sizeof *m && (!change || known)) {
            break;
        }
        if (now->data && spin_npz_write(&w, now->name, now->descr, now->n_dims, now->shape,
                                        now->data) != SPIN_OK)
            exit(1);
    }
    if (spin_zip_writer_commit(&w) != SPIN_OK)
        exit(1);
    return path;
}

static void fill_numbers(void)
{
    for (int i = 0; i < T * N * 4; i++)
        doubles[i] = numbers[i] = 0.25f + 0.01f * (float)i;
}

static void test_layouts(void)
{
    struct member f8 = {"means3D", "<f8", 3, {T, N, 3}, doubles};
    struct member moving = {"log_scales", "<f4", 3, {T, N, 3}, numbers};
    struct spin_splats s = {0};
    struct run run;

    ok(run_open("d3dgs", make_run(&f8), &run) == SPIN_OK &&
           run.importer->frame(run.self, 2, 0, SPIN_COL_MEANS, &s) == SPIN_OK,
       "reads float64");
    check_same_bits(s.means, numbers + 2 * N * 3, N * 3 * sizeof(float), "and rounds to float32");
    run_close(&run);
    ok(run_open("d3dgs", make_run(&moving), &run) == SPIN_OK &&
           run.sequence.static_columns == SPIN_COL_LOGIT_OPACITIES &&
           run.importer->frame(run.self, 1, 0, SPIN_COL_LOG_SCALES, &s) == SPIN_OK,
       "reads scales per frame");
    check_same_bits(s.log_scales, numbers + N * 3, N * 3 * sizeof(float), "of the right frame");
    run_close(&run);
    ok(run_open("d3dgs", make_run(NULL), &run) == SPIN_OK &&
           run.importer->frame(run.self, 0, 0, SPIN_COL_QUATS, &s) == SPIN_OK,
       "reads a file of ours");
    near(s.quats[0] * s.quats[0] + s.quats[1] * s.quats[1] + s.quats[2] * s.quats[2] +
             s.quats[3] * s.quats[3],
         1, 1e-6, "quaternions are of unit length");
    ok(run.importer->frame(run.self, T, 0, SPIN_COL_MEANS, &s) == SPIN_E_NOT_FOUND,
       "there is no frame behind the last");
    run_close(&run);
    memset(numbers, 0, 4 * sizeof *numbers);
    ok(run_open("d3dgs", make_run(NULL), &run) == SPIN_OK &&
           run.importer->frame(run.self, 0, 0, SPIN_COL_QUATS, &s) == SPIN_OK && s.quats[0] == 1 &&
           s.quats[1] == 0,
       "a zero quaternion is identity");
    run_close(&run);
    spin_splats_free(&s);
    fill_numbers();
}

static void test_lies(void)
{
    static const char *const key[] = {"means3D", "rgb_colors", "unnorm_rotations",
                                      "logit_opacities", "log_scales"};
    static const uint64_t width[] = {3, 3, 4, 1, 3};
    int whole[T * N * 4] = {0};
    char what[100];

    for (int i = 0; i < 5; i++) {
        struct member none = {key[i], "<f4", 0, {0}, NULL};
        struct member few = {key[i],
                             "<f4",
                             i < 3 ? 3 : 2,
                             {i < 3 ? T : N - 1, i < 3 ? N - 1 : width[i], width[i]},
                             numbers};
        struct member narrow = {key[i], "<f4", 3, {T, N, width[i] + 1}, numbers};
        struct member ints = {key[i], "<i4", 3, {T, N, width[i]}, whole};
        struct member late = {key[i], "<f4", 3, {T - 1, N, width[i]}, numbers};

        snprintf(what, sizeof what, "names a missing '%s'", key[i]);
        fails("d3dgs", make_run(&none), key[i], what);
        snprintf(what, sizeof what, "'%s' of too few Gaussians", key[i]);
        fails("d3dgs", make_run(&few), "shape", what);
        if (width[i] < 4) {
            snprintf(what, sizeof what, "'%s' with too many numbers a Gaussian", key[i]);
            fails("d3dgs", make_run(&narrow), key[i], what);
        }
        snprintf(what, sizeof what, "'%s' of whole numbers", key[i]);
        fails("d3dgs", make_run(&ints), key[i], what);
        snprintf(what, sizeof what, "'%s' of too few frames", key[i]);
        fails("d3dgs", make_run(&late), "shape", what);
        numbers[width[i] * N - 1] = NAN;
        snprintf(what, sizeof what, "NaN in '%s'", key[i]);
        fails("d3dgs", make_run(NULL), "frame 0", what);
        fill_numbers();
    }
    struct member still_means = {"means3D", "<f4", 2, {N, 3}, numbers};
    struct member collapsed = {"means3D", "<f4", 3, {T, 0, 3}, numbers};
    struct member empty = {"means3D", "<f4", 3, {0, N, 3}, numbers};
    struct member splatam = {"cam_unnorm_rots", "<f4", 3, {1, 4, T}, numbers};
    struct member flat = {"logit_opacities", "<f4", 1, {N}, numbers};

    fails("d3dgs", make_run(&still_means), "[T, N, 3]", "positions without frames");
    fails("d3dgs", make_run(&collapsed), "training collapsed", "no Gaussians");
    fails("d3dgs", make_run(&empty), "0 frames", "no frames");
    fails("d3dgs", make_run(&splatam), "SplaTAM", "a map of SplaTAM");
    fails(NULL, make_run(&splatam), "SplaTAM", "and without --from");
    fails("d3dgs", make_run(&flat), "shape", "opacities [N] are not [N, 1]");
    fails("d3dgs", "no/such/params.npz", "no/such/params.npz", "a missing file is named");
    fails(NULL, check_truncated(make_run(NULL), 600), "cannot read",
          "a cut file is still recognised");
}

/* Zeros, which deflate to a thousandth: a frame of BOMB Gaussians, with a last array of width
 * `narrow`. */
enum { BOMB = 1500000 };

static const char *make_bomb(const char *name, uint64_t narrow)
{
    static const char *const key[] = {"means3D", "rgb_colors", "unnorm_rotations",
                                      "logit_opacities", "log_scales"};
    static float zeros[4 * BOMB];
    const char *path = path_in(new_folder(), name);
    struct spin_zip_writer w;

    if (spin_zip_writer_open(path, true, &w) != SPIN_OK)
        exit(1);
    for (int i = 0; i < 5; i++) {
        uint64_t shape[] = {1, BOMB, i == 2 ? 4 : i == 3 ? 1 : i == 4 ? narrow : 3};

        if (spin_npz_write_begin_deflated(&w, key[i], "<f4", 3, shape) != SPIN_OK ||
            spin_zip_member_write(&w, zeros, BOMB * shape[2] * sizeof *zeros) != SPIN_OK ||
            spin_zip_member_end(&w) != SPIN_OK)
            exit(1);
    }
    if (spin_zip_writer_commit(&w) != SPIN_OK)
        exit(1);
    return path;
}

static rlim_t address_space(void)
{
    unsigned long pages = 0;
    FILE *file = fopen("/proc/self/statm", "r");

    if (!file || fscanf(file, "%lu", &pages) != 1)
        exit(1);
    fclose(file);
    return (rlim_t)pages * (rlim_t)sysconf(_SC_PAGESIZE);
}

/* The size of an array is compared with the available memory before anything is unpacked. */
static void test_bomb(void)
{
#ifdef __SANITIZE_ADDRESS__
    skip("a bomb", "the address sanitiser needs more address space than a limit leaves");
#else
    const char *bomb = make_bomb("bomb.npz", 3), *narrow = make_bomb("narrow.npz", 2);
    struct rlimit before, limit;
    struct run run;
    size_t peak = spin_memory_peak();

    fails("d3dgs", narrow, "log_scales", "a bomb with one array of another shape");
    getrlimit(RLIMIT_AS, &before);
    limit = before;
    limit.rlim_cur = address_space() + (120u << 20);
    setrlimit(RLIMIT_AS, &limit);
    ok(spin_memory_available() <= 120u << 20 && spin_memory_available() > 60u << 20,
       "the memory that is there ends where the address space is limited");
    fails("d3dgs", bomb,
          "its arrays unpack to 84.0 MB and a frame requires another 84.0 MB, but only 12",
          "arrays and a frame that the memory does not hold");
    ok(spin_memory_peak() < peak + (20u << 20), "neither was unpacked to see that");
    limit.rlim_cur = address_space() + (300u << 20);
    setrlimit(RLIMIT_AS, &limit);
    ok(run_open("d3dgs", bomb, &run) == SPIN_OK, "with more memory it is read");
    run_close(&run);
    setrlimit(RLIMIT_AS, &before);
#endif
}

TAP_MAIN
{
    const char *root = check_fixture("d3dgs");
    char **names = NULL;
    size_t n = 0;

    spin_log_set_level(-1);
    fill_numbers();
    test_layouts();
    test_lies();
    test_bomb();
    if (!root || spin_folder_list(root, &names, &n) != SPIN_OK) {
        skip("d3dgs fixtures", "there are none here");
        return;
    }
    for (size_t i = 0; i < n; i++) {
        const char *folder = path_in(root, names[i]);
        spin_json *manifest = load_manifest(folder);

        if (!manifest)
            continue;
        if (spin_json_string(spin_json_get(manifest, "input")))
            test_input(folder, names[i], manifest);
        if (spin_json_get(manifest, "cases"))
            test_cases(folder, manifest, root);
        spin_json_free(manifest);
    }
    spin_folder_list_free(names);
}
