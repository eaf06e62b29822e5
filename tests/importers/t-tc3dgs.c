/* tc3dgs: a real-shaped run in every reading of its mask against the method's own loader, and masks
 * that lie.
 * K: tc3dgs d3dgs import */
#include "tests/importers/runs.h"

static spin_status open_with(const char *path, const char *const *pairs, struct run *run)
{
    struct spin_plugin_values values = {pairs};
    spin_status status;

    memset(run, 0, sizeof *run);
    SPIN_TRY(spin_importer_find(path, "tc3dgs", false, &run->importer));
    status = run->importer->open(path, &values, &run->self, &run->sequence);
    if (status != SPIN_OK)
        run_close(run);
    return status;
}

/* Rows of the expected arrays that are visible, all of them without 'visible'. */
struct rows {
    double *visible; /* [T][N] or NULL */
    size_t n;
};

/* The visible rows of one frame of [T][N][width], packed. */
static double *pick(struct spin_npz *npz, const char *key, const struct rows *rows, size_t frame,
                    size_t width, size_t *n_picked)
{
    struct spin_array info;
    double *all = check_load(npz, key, &info);
    double *out = malloc(rows->n * width * sizeof *out + 1);
    size_t n = 0;

    for (size_t i = 0; all && i < rows->n; i++) {
        if (rows->visible && rows->visible[frame * rows->n + i] == 0)
            continue;
        memcpy(out + width * n++, all + (frame * rows->n + i) * width, width * sizeof *out);
    }
    free(all);
    *n_picked = n;
    return out;
}

static void compare_rows(struct spin_npz *npz, const char *key, const struct rows *rows,
                         size_t frame, size_t width, const float *got, size_t n_got,
                         const char *name)
{
    size_t n;
    double *want = pick(npz, key, rows, frame, width, &n);
    float *turned = malloc(n_got * width * sizeof *turned + 1);
    char what[300];

    memcpy(turned, got, n_got * width * sizeof *turned);
    for (size_t i = 0; width == 4 && i < n_got && i < n; i++) { /* q and -q are one rotation */
        double dot = 0;

        for (size_t c = 0; c < 4; c++)
            dot += want[4 * i + c] * turned[4 * i + c];
        for (size_t c = 0; c < 4 && dot < 0; c++)
            turned[4 * i + c] = -turned[4 * i + c];
    }
    snprintf(what, sizeof what, "%s, frame %zu: %s", name, frame, key);
    if (n != n_got)
        ok(0, "%s: %zu rows, expected %zu", what, n_got, n);
    else
        check_close(turned, want, n * width, 3e-6, 3e-5, what);
    free(turned);
    free(want);
}

static void compare_frame(struct run *run, struct spin_npz *npz, const struct rows *rows, int frame,
                          const char *name)
{
    struct spin_splats s = {0};
    float *scales, *opacities;
    size_t f = (size_t)frame;

    if (!ok(run->importer->frame(run->self, frame, 0, run->sequence.columns, &s) == SPIN_OK &&
                s.n == run->sequence.counts[frame],
            "%s: frame %d has as many rows as were announced", name, frame)) {
        printf("#   %s\n", spin_last_error());
        return;
    }
    scales = map_values(s.log_scales, 3 * s.n, exp);
    opacities = map_values(s.logit_opacities, s.n, sigmoid);
    compare_rows(npz, "means", rows, f, 3, s.means, s.n, name);
    compare_rows(npz, "quats_wxyz", rows, f, 4, s.quats, s.n, name);
    compare_rows(npz, "scales", rows, f, 3, scales, s.n, name);
    compare_rows(npz, "opacities", rows, f, 1, opacities, s.n, name);
    compare_rows(npz, "sh_dc", rows, f, 3, s.sh, s.n, name);
    free(scales);
    free(opacities);
    spin_splats_free(&s);
}

static void test_mode(const char *folder, const char *file, const char *mode, const char *threshold)
{
    const char *pairs[] = {"tc-mask", mode, "tc-threshold", threshold, NULL};
    struct spin_array info = {0};
    struct rows rows = {0};
    struct spin_npz npz;
    struct run run;
    double *means;

    if (!ok(spin_npz_open(path_in(folder, file), &npz) == SPIN_OK, "%s is there", file))
        return;
    if (!ok(open_with(path_in(folder, "params.npz"), mode ? pairs : NULL, &run) == SPIN_OK,
            "%s: opens", file)) {
        printf("#   %s\n", spin_last_error());
        spin_npz_close(&npz);
        return;
    }
    means = check_load(&npz, "means", &info);
    free(means);
    rows.n = (size_t)info.shape[1];
    if (spin_npz_has(&npz, "visible"))
        rows.visible = check_load(&npz, "visible", &info);
    for (int f = 0; f < run.sequence.n_frames; f++)
        compare_frame(&run, &npz, &rows, f, file);
    free(rows.visible);
    run_close(&run);
    spin_npz_close(&npz);
}

static void test_fixture(const char *folder)
{
    const struct spin_importer *found = NULL;
    const char *path = path_in(folder, "params.npz");

    ok(spin_importer_find(path, NULL, false, &found) == SPIN_OK && !strcmp(found->name, "tc3dgs"),
       "the file is recognised");
    ok(spin_importer_find(folder, NULL, false, &found) == SPIN_OK && !strcmp(found->name, "tc3dgs"),
       "so is its folder");
    test_mode(folder, "expected_ste_0.1.npz", NULL, NULL);
    test_mode(folder, "expected_ste_0.01.npz", "frame", "0.01");
    test_mode(folder, "expected_prune_avg_0.1.npz", "avg", "0.1");
    test_mode(folder, "expected_prune_any_0.1.npz", "any", "0.1");
    test_mode(folder, "expected_prune_all_0.1.npz", "all", "0.1");
    test_mode(folder, "expected_nomask.npz", "none", "0.1");
    ok(read_truncations("tc3dgs", path) == 0, "no truncation of it can be read");
}

/* ---- Files made here ------------------------------------------------------------------------- */

enum { T = 3, N = 4 };

static float numbers[T * N * 4], mask[T * N];

/* A small whole run with a mask of this shape (n_dims 0: none). */
static const char *make_run(int n_dims, const uint64_t *shape)
{
    const char *path = path_in(new_folder(), "params.npz");
    const uint64_t t3[] = {T, N, 3}, t4[] = {T, N, 4}, one[] = {N, 1}, three[] = {N, 3};
    struct spin_zip_writer w;

    if (spin_zip_writer_open(path, true, &w) != SPIN_OK ||
        spin_npz_write(&w, "means3D", "<f4", 3, t3, numbers) != SPIN_OK ||
        spin_npz_write(&w, "rgb_colors", "<f4", 3, t3, numbers) != SPIN_OK ||
        spin_npz_write(&w, "unnorm_rotations", "<f4", 3, t4, numbers) != SPIN_OK ||
        spin_npz_write(&w, "logit_opacities", "<f4", 2, one, numbers) != SPIN_OK ||
        (n_dims && spin_npz_write(&w, "mask", "<f4", n_dims, shape, mask) != SPIN_OK) ||
        spin_npz_write(&w, "log_scales", "<f4", 2, three, numbers) != SPIN_OK ||
        spin_zip_writer_commit(&w) != SPIN_OK)
        exit(1);
    return path;
}

static void fill(void)
{
    for (int i = 0; i < T * N * 4; i++)
        numbers[i] = 0.25f + 0.01f * (float)i;
    for (int i = 0; i < T * N; i++)
        mask[i] = i % 3 ? 1.0f : -8.0f; /* hidden: 0 3, 2, 1 */
}

static void test_shapes(void)
{
    const uint64_t per_frame[] = {T, N, 1}, flat[] = {T, N}, still[] = {N, 1};
    const uint64_t short_t[] = {T - 1, N, 1}, short_n[] = {T, N - 1, 1}, wide[] = {T, N / 2, 2};
    struct spin_splats s = {0};
    struct run run;

    ok(run_open("tc3dgs", make_run(3, per_frame), &run) == SPIN_OK && run.sequence.counts[0] == 2 &&
           run.sequence.counts[1] == 3 && run.sequence.counts[2] == 3,
       "counts what each frame shows");
    ok(run.importer->frame(run.self, 0, 0, SPIN_COL_MEANS, &s) == SPIN_OK && s.n == 2 &&
           s.means[0] == numbers[3] && s.means[3] == numbers[6],
       "rows that are hidden are left out");
    ok(run.sequence.static_columns == 0, "nothing is still, as the rows differ");
    run_close(&run);
    ok(run_open("tc3dgs", make_run(2, flat), &run) == SPIN_OK && run.sequence.counts[1] == 3,
       "a mask [T, N]");
    run_close(&run);
    ok(run_open("tc3dgs", make_run(2, still), &run) == SPIN_OK && run.sequence.counts[0] == 2 &&
           run.sequence.counts[2] == 2 && run.sequence.static_columns != 0,
       "a mask [N, 1] is the same in all frames");
    run_close(&run);
    for (int i = 0; i < N; i++)
        mask[N + i] = -30;
    ok(run_open("tc3dgs", make_run(3, per_frame), &run) == SPIN_OK && run.sequence.counts[1] == 0 &&
           run.importer->frame(run.self, 1, 0, run.sequence.columns, &s) == SPIN_OK && s.n == 0,
       "a frame that shows nothing is empty");
    run_close(&run);
    fill();
    fails("tc3dgs", make_run(3, short_t), "array 'mask' has shape [2, 4, 1]", "too few frames");
    fails("tc3dgs", make_run(3, short_n), "expected [3, 4, 1]", "too few Gaussians");
    fails("tc3dgs", make_run(3, wide), "shape", "two numbers a Gaussian");
    fails("tc3dgs", make_run(0, NULL), "--from d3dgs", "no mask at all");
    mask[5] = NAN;
    fails("tc3dgs", make_run(3, per_frame), "array 'mask' has 1 values in frame 1 that are NaN",
          "NaN in the mask");
    mask[5] = INFINITY;
    ok(read_all("tc3dgs", make_run(3, per_frame)) == SPIN_OK, "infinity is certain");
    fill();
    spin_splats_free(&s);
}

static void test_options(void)
{
    const uint64_t shape[] = {T, N, 1};
    const char *path = make_run(3, shape);
    const char *mode[] = {"tc-mask", "soft", NULL};
    const char *threshold[] = {"tc-threshold", "a lot", NULL};
    const char *beyond[] = {"tc-threshold", "1.5", NULL};
    struct run run;

    ok(open_with(path, mode, &run) == SPIN_E_USAGE && strstr(spin_last_error(), "'soft'"),
       "an unknown mode is named");
    ok(open_with(path, threshold, &run) == SPIN_E_USAGE && strstr(spin_last_error(), "'a lot'"),
       "so is a threshold that is no number");
    ok(open_with(path, beyond, &run) == SPIN_E_USAGE, "or is not a probability");
}

TAP_MAIN
{
    const char *root = check_fixture("tc3dgs");

    spin_log_set_level(-1);
    fill();
    test_shapes();
    test_options();
    if (root)
        test_fixture(path_in(root, "trained"));
    else
        skip("tc3dgs fixtures", "there are none here");
}
