/* tc3dgs: masks of every shape, and malformed masks.
 * K: tc3dgs d3dgs import */
#include "tests/importers/models.h"

/* ---- Files made here ------------------------------------------------------------------------- */

enum { T = 3, N = 4 };

static float numbers[T * N * 4], mask[T * N];

/* A small complete run with a mask of this shape (n_dims 0: none). */
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

    ok(model_open("tc3dgs", path, mode, &run) == SPIN_E_USAGE &&
           strstr(spin_last_error(), "'soft'"),
       "an unknown mode is named");
    ok(model_open("tc3dgs", path, threshold, &run) == SPIN_E_USAGE &&
           strstr(spin_last_error(), "'a lot'"),
       "so is a threshold that is no number");
    ok(model_open("tc3dgs", path, beyond, &run) == SPIN_E_USAGE, "or is not a probability");
}

/* A presence of exactly the threshold: training draws a Gaussian whose presence is above it, and
 * the pruning before its tests removes those whose presence is below it. */
static void test_equality(void)
{
    static const char *const modes[] = {"frame", "avg", "any", "all"};
    const uint64_t shape[] = {T, N, 1};
    const char *path;

    for (int i = 0; i < T * N; i++)
        mask[i] = i % N == 0 ? 0.0f : i % N == 1 ? -0.001f : i % N == 2 ? 0.001f : 1.0f;
    path = make_run(3, shape);
    for (int k = 0; k < 4; k++) {
        const char *options[] = {"tc-mask", modes[k], "tc-threshold", "0.5", NULL};
        struct spin_splats s = {0};
        struct run run;

        if (!ok(model_open("tc3dgs", path, options, &run) == SPIN_OK, "opens: %s",
                spin_last_error()))
            continue;
        ok(run.sequence.counts[0] == (k == 0 ? 2 : 3) && run.sequence.counts[2] == (k == 0 ? 2 : 3),
           "%s: the threshold itself %s", modes[k], k == 0 ? "hides" : "does not hide");
        ok(run.importer->frame(run.self, 1, 0, SPIN_COL_MEANS, &s) == SPIN_OK &&
               s.n == run.sequence.counts[1] && s.means[0] == numbers[3 * N + (k == 0 ? 6 : 0)],
           "and a frame has as many rows");
        run_close(&run);
        spin_splats_free(&s);
    }
    fill();
}

TAP_MAIN
{
    const char *root = check_fixture("tc3dgs");

    spin_log_set_level(-1);
    fill();
    test_shapes();
    test_options();
    test_equality();
    if (root)
        ok(read_truncations("tc3dgs", path_in(root, "trained/params.npz")) == 0,
           "no truncation of a fixture can be read");
    else
        skip("tc3dgs fixtures", "there are none here");
}
