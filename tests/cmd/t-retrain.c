/* Every option of spin-retrain changes what it claims to change: views, losses, initial values,
 * learning rates, shapes, files. Runs the command and reads its log and its bundle.
 * K: long retrain options */
#include <signal.h>
#include <unistd.h>

#include "io/image.h"
#include "base/number.h"
#include "model/field.h"
#include "scene/dataset.h"
#include "tests/cmd/command.h"

enum { MOST_STEPS = 64, MOST_VIEWS = 8, TRAINING = 6, TESTING = 2 };

/* Two frames of the clip, 40 x 23 pixels, a small network. Four steps of three views are one epoch.
 */
static const char base[] =
    "--preset paper --device cpu --threads 1 --range 1:3 --scale 0.25 --levels 4 --hash-log2 10 "
    "--finest-resolution 32 --hidden 16 --iterations 4 --precision full -q";
static const int training[TRAINING] = {3, 7, 12, 19, 23, 27}, testing[TESTING] = {0, 15};

struct step {
    double loss, l1, ssim;
    int n, view[MOST_VIEWS][2]; /* frame, camera */
};

/* One run of the command, and its outputs. */
struct run {
    int n;
    struct step step[MOST_STEPS];
    int n_tests, test[MOST_STEPS]; /* iterations after which the test views were measured */
    const spin_json *meta, *network, *options;
    struct spin_bundle bundle;
    struct spin_field field;
    float *table, *heads;
    size_t n_table;
};

/* ---- Running -----------------------------------------------------------------------------------
 */

static void read_step(struct run *r, const spin_json *line)
{
    const spin_json *views = spin_json_get(line, "views");
    struct step *s = &r->step[r->n];
    double iteration = 0, value;

    spin_json_number(spin_json_get(line, "iteration"), &iteration);
    if (spin_json_number(spin_json_get(line, "test_psnr"), &value) && r->n_tests < MOST_STEPS)
        r->test[r->n_tests++] = (int)iteration;
    if (!spin_json_number(spin_json_get(line, "loss"), &s->loss) || r->n == MOST_STEPS)
        return;
    spin_json_number(spin_json_get(line, "l1"), &s->l1);
    spin_json_number(spin_json_get(line, "ssim"), &s->ssim);
    s->n = (int)spin_json_length(views);
    for (int i = 0; i < s->n && i < MOST_VIEWS; i++)
        for (size_t k = 0; k < 2; k++) {
            spin_json_number(spin_json_at(spin_json_at(views, (size_t)i), k), &value);
            s->view[i][k] = (int)value;
        }
    r->n++;
}

static void read_log(struct run *r, const char *path)
{
    static char line[1 << 16];
    FILE *f = fopen(path, "r");

    while (f && fgets(line, sizeof line, f)) {
        spin_json *j = NULL;

        if (spin_json_parse("log", line, strlen(line), &j) == SPIN_OK)
            read_step(r, j);
        spin_json_free(j);
    }
    if (f)
        fclose(f);
}

static void free_run(struct run *r)
{
    free(r->table);
    free(r->heads);
    spin_bundle_close(&r->bundle);
    memset(r, 0, sizeof *r);
}

static void read_bundle(struct run *r, const char *path)
{
    size_t n_heads;
    bool there;

    if (!ok(spin_bundle_open(path, &r->bundle) == SPIN_OK, "%s is a bundle", path)) {
        printf("#   %s\n", spin_last_error());
        exit(tap_done());
    }
    r->meta = r->bundle.json;
    r->network = spin_json_get(r->meta, "trained");
    r->options = spin_json_get(r->network, "options");
    if (!r->network)
        return;
    if (!ok(spin_field_from_json(r->network, &r->field, &there) == SPIN_OK,
            "what was trained is told"))
        exit(tap_done());
    if (!there)
        return;
    r->table = check_values(&r->bundle, "trained/table", &r->n_table);
    r->heads = check_values(&r->bundle, "trained/heads", &n_heads);
}

/* The command with the base options and these, which override them. */
static struct run *retrain(const char *more)
{
    struct run *r = calloc(1, sizeof *r);
    char path[600];

    snprintf(path, sizeof path, "%s/run.log", folder);
    if (!r || !ok(shell("%s/spin-retrain %s/in.spin -o %s/run.spin --log %s %s --force %s", bin,
                        folder, folder, path, base, more) == 0,
                  "spin-retrain %s", more)) {
        printf("#   %s\n", said);
        exit(tap_done());
    }
    read_log(r, path);
    snprintf(path, sizeof path, "%s/run.spin", folder);
    read_bundle(r, path);
    return r;
}

static void drop(struct run *r)
{
    free_run(r);
    free(r);
}

/* Largest difference of two arrays. */
static double farthest(const float *a, const float *b, size_t first, size_t end)
{
    double most = 0;

    for (size_t i = first; i < end; i++)
        most = larger(most, fabs((double)a[i] - (double)b[i]));
    return most;
}

static float *array_of(struct run *r, const char *key, size_t *n)
{
    return check_values(&r->bundle, key, n);
}

/* ---- Views --------------------------------------------------------------------------------------
 */

static bool among(int camera, const int *list, int n)
{
    for (int i = 0; i < n; i++)
        if (list[i] == camera)
            return true;
    return false;
}

/* Iterations first..end-1 show every frame of 1..2 from every listed camera once, and nothing
 * else. */
static bool is_epoch(const struct run *r, int first, int end, const int *cameras, int n)
{
    int seen[2][32] = {{0}}, total = 0;

    for (int s = first; s < end; s++)
        for (int i = 0; i < r->step[s].n; i++) {
            const int *view = r->step[s].view[i];

            if (s >= r->n || view[0] < 1 || view[0] > 2 || !among(view[1], cameras, n) ||
                seen[view[0] - 1][view[1]]++)
                return false;
            total++;
        }
    return total == 2 * n;
}

/* The order of views from iteration first on equals that of `other` from its own start on. */
static bool same_order(const struct run *a, int first, const struct run *b, int from, int steps)
{
    for (int s = 0; s < steps; s++)
        if (memcmp(a->step[first + s].view, b->step[from + s].view, sizeof a->step[0].view) != 0)
            return false;
    return true;
}

static bool one_frame_a_step(const struct run *r)
{
    for (int s = 0; s < r->n; s++)
        for (int i = 1; i < r->step[s].n; i++)
            if (r->step[s].view[i][0] != r->step[s].view[0][0])
                return false;
    return true;
}

static bool in_order(const struct run *r, int steps)
{
    int last = -1;

    for (int s = 0; s < steps; s++)
        for (int i = 0; i < r->step[s].n; i++) {
            int at = r->step[s].view[i][0] * 100 + r->step[s].view[i][1];

            if (at < last)
                return false;
            last = at;
        }
    return true;
}

/* The cameras of each iteration are in ascending order. */
static bool cameras_ascend(const struct run *r)
{
    for (int s = 0; s < r->n; s++)
        for (int i = 1; i < r->step[s].n; i++)
            if (r->step[s].view[i][1] < r->step[s].view[i - 1][1])
                return false;
    return true;
}

/* The iterations of every epoch of four visit frame after frame. */
static bool frames_ascend(const struct run *r)
{
    for (int s = 1; s < r->n; s++)
        if (s % 4 != 0 && r->step[s].view[0][0] < r->step[s - 1].view[0][0])
            return false;
    return true;
}

static void test_views(void)
{
    static const int others[] = {0, 7, 12, 15, 23, 27};
    struct run *one = retrain("--iterations 8"), *seed = retrain("--iterations 8 --seed 1"),
               *again = retrain("--iterations 8 --seed 1"), *cams = retrain("--test-cams 3,19"),
               *frames = retrain("--views-per-frame 3"),
               *groups = retrain("--views-per-frame 3 --iterations 16"),
               *pairs = retrain("--batch 4 --views-per-frame 2"),
               *two = retrain("--batch 2 --iterations 6"), *range = retrain("--range 4:6:1");

    ok(one->n == 8 && one->step[0].n == 3, "--iterations: a line a step, of three views");
    ok(is_epoch(one, 0, 4, training, TRAINING), "an epoch: every training view once, no test view");
    ok(is_epoch(one, 4, 8, training, TRAINING), "and so is the second");
    ok(!in_order(one, 4), "views are shuffled");
    ok(!same_order(one, 0, one, 4, 4), "in every epoch anew");
    ok(is_epoch(seed, 0, 4, training, TRAINING) && !same_order(one, 0, seed, 0, 4),
       "--seed: another order");
    ok(same_order(again, 0, seed, 0, 8), "the same seed: the same order");
    ok(number(seed->options, "seed") == 1, "--seed is in the bundle, a number");
    ok(is_epoch(cams, 0, 4, others, 6), "--test-cams: exactly those listed are held out");
    ok(number_at(cams->options, "test_cameras", 0) == 3 &&
           number_at(cams->options, "test_cameras", 1) == 19 &&
           spin_json_length(spin_json_get(cams->options, "test_cameras")) == 2,
       "--test-cams is in the bundle");
    ok(is_epoch(frames, 0, 4, training, TRAINING) && one_frame_a_step(frames) &&
           !one_frame_a_step(one),
       "--views-per-frame: a step's views are of one frame");
    ok(!in_order(frames, 4), "and shuffled");
    ok(!cameras_ascend(groups) && !frames_ascend(groups),
       "the views of a frame, and the frames as well");
    ok(pairs->step[0].n == 4 && is_epoch(pairs, 0, 3, training, TRAINING),
       "--views-per-frame 2 of --batch 4: an epoch");
    for (int s = 0; s < 3; s++)
        ok(pairs->step[s].view[0][0] == pairs->step[s].view[1][0] &&
               pairs->step[s].view[2][0] == pairs->step[s].view[3][0],
           "step %d: two views of a frame side by side", s + 1);
    ok(two->n == 6 && two->step[0].n == 2 && is_epoch(two, 0, 6, training, TRAINING),
       "--batch 2: two views a step");
    ok(range->step[0].view[0][0] >= 4 && range->step[0].view[1][0] >= 4 &&
           spin_json_length(spin_json_get(range->meta, "frames")) == 2 &&
           number(spin_json_at(spin_json_get(range->meta, "frames"), 1), "number") == 5,
       "--range: frames 4 and 5");
    drop(one), drop(seed), drop(again), drop(cams), drop(frames), drop(groups), drop(pairs),
        drop(two), drop(range);
}

/* ---- The loss -----------------------------------------------------------------------------------
 */

static void is_mix(const struct run *r, double lambda)
{
    bool good = true;

    for (int s = 0; s < r->n; s++)
        good = good && fabs(r->step[s].loss - (1 - lambda) * r->step[s].l1 -
                            lambda * (1 - r->step[s].ssim)) < 1e-6;
    ok(r->n == 4 && good, "the loss is (1 - %g) l1 + %g (1 - ssim)", lambda, lambda);
    near(number(r->options, "lambda_dssim"), lambda, 0, "as the bundle says");
}

static void test_loss(void)
{
    struct run *one = retrain(""), *l1 = retrain("--lambda-dssim 0"),
               *ssim = retrain("--lambda-dssim 1"), *white = retrain("--background white"),
               *ones = retrain("--background 1,1,1"), *red = retrain("--background 1,0,0.5"),
               *blue = retrain("--background 0.5,0,1"), *moving = retrain("--dynamic-weight 4"),
               *anti = retrain("--antialias on"), *small = retrain("--scale 0.5");
    bool flag = false;

    is_mix(one, 0.2);
    is_mix(l1, 0);
    is_mix(ssim, 1);
    ok(farthest(l1->heads, ssim->heads, 0, one->field.n_heads) > 1e-4, "and reaches the gradient");
    ok(same_order(one, 0, white, 0, 4) && fabs(white->step[0].l1 - one->step[0].l1) > 0.01 &&
           fabs(white->step[3].l1 - one->step[3].l1) > 0.01,
       "--background reaches the loss");
    ok(white->step[0].l1 == ones->step[0].l1, "white is 1,1,1");
    ok(fabs(red->step[0].l1 - blue->step[0].l1) > 1e-3, "each of its channels");
    ok(number_at(red->options, "background", 0) == 1 &&
           number_at(red->options, "background", 1) == 0 &&
           number_at(red->options, "background", 2) == 0.5,
       "--background is in the bundle");
    ok(fabs(moving->step[0].l1 - one->step[0].l1) > 1e-3, "--dynamic-weight weighs the loss");
    near(number(moving->options, "dynamic_weight"), 4, 0, "and is in the bundle");
    ok(fabs(anti->step[0].l1 - one->step[0].l1) > 1e-4, "--antialias draws otherwise");
    ok(spin_json_bool(spin_json_get(anti->network, "antialias"), &flag) && flag &&
           !spin_json_get(one->network, "antialias"),
       "and is in the bundle");
    ok(fabs(small->step[0].l1 - one->step[0].l1) > 1e-4 &&
           number(small->options, "image_scale") == 0.5,
       "--scale: other images");
    drop(l1), drop(ssim), drop(white), drop(ones), drop(red), drop(blue), drop(moving), drop(anti),
        drop(small);
    drop(one);
}

/* ---- Rates --------------------------------------------------------------------------------------
 */

/* Adam's first step changes every parameter that has a gradient by the learning rate, so the
 * largest difference from a run with rate 0 is the rate. With one step of warm-up it is the
 * given rate. */
static const char still[] =
    "--iterations 1 --warmup 1 --lr-table 0 --head-lr-factor 0 --lr-position 0";
/* The table has large values from the first iteration on, so that the second one shows the
 * change of positions. */
static const char wide[] = "--iterations 2 --warmup 0 --lr-table 0.5";

static double moved(const struct run *a, const struct run *b, int head)
{
    return farthest(a->heads, b->heads, a->field.heads.offset[head],
                    a->field.heads.offset[head + 1]);
}

static double moved_array(struct run *a, struct run *b, const char *key)
{
    size_t n, m;
    float *x = array_of(a, key, &n), *y = array_of(b, key, &m);
    double most = ok(n == m && n > 0, "%s: as many", key) ? farthest(x, y, 0, n) : NAN;

    free(x);
    free(y);
    return most;
}

static void test_rates(void)
{
    static const char rates[] =
        "--lr-table 0.01 --lr-sh 0.002 --lr-scale 0.003 --lr-rotation 0.004 "
        "--lr-opacity 0.005 --lr-position 0.001";
    struct run *zero = retrain(still), *one, *half, *twice;
    char more[400];
    double extent = number(zero->options, "spatial_extent");

    ok(moved_array(zero, zero, "trained/means/00000") == 0, "a run compares with itself");
    snprintf(more, sizeof more, "--iterations 1 --warmup 1 %s", rates);
    one = retrain(more);
    near(farthest(one->table, zero->table, 0, one->n_table), 0.01, 1e-5, "--lr-table");
    near(moved(one, zero, SPIN_HEAD_SH), 0.002, 1e-6, "--lr-sh is the colour head's");
    near(moved(one, zero, SPIN_HEAD_SCALE), 0.003, 1e-6, "--lr-scale is the scale head's");
    near(moved(one, zero, SPIN_HEAD_ROTATION), 0.004, 1e-6, "--lr-rotation is the rotation head's");
    near(moved(one, zero, SPIN_HEAD_OPACITY), 0.005, 1e-6, "--lr-opacity is the opacity head's");
    near(fmax(moved_array(one, zero, "trained/means/00000"),
              moved_array(one, zero, "trained/means/00001")) /
             extent,
         0.001, 1e-5, "--lr-position is the positions', times the extent");
    drop(one);

    /* The first step of a warm-up of four. */
    snprintf(more, sizeof more, "--iterations 1 --warmup 4 %s", rates);
    half = retrain(more);
    near(farthest(half->table, zero->table, 0, half->n_table), 0.01 / 4, 1e-5,
         "--warmup: a quarter");
    near(moved(half, zero, SPIN_HEAD_OPACITY), 0.005 / 4, 1e-6, "--warmup: of all rates");
    drop(half);

    /* The last step of a run, after its warm-up, has the common final rate. */
    snprintf(more, sizeof more, "--iterations 1 --warmup 0 %s", rates);
    half = retrain(more);
    near(farthest(half->table, zero->table, 0, half->n_table), 1e-7, 1e-9, "all rates end at 1e-7");
    drop(half);

    snprintf(more, sizeof more, "--iterations 1 --warmup 1 --head-lr-factor 2 %s", rates);
    twice = retrain(more);
    near(moved(twice, zero, SPIN_HEAD_SH), 0.004, 1e-6,
         "--head-lr-factor doubles the colour head's");
    near(moved(twice, zero, SPIN_HEAD_SCALE), 0.006, 1e-6, "the scale head's");
    near(moved(twice, zero, SPIN_HEAD_ROTATION), 0.008, 1e-6, "the rotation head's");
    near(moved(twice, zero, SPIN_HEAD_OPACITY), 0.01, 1e-6, "the opacity head's");
    near(farthest(twice->table, zero->table, 0, twice->n_table), 0.01, 1e-5, "and not the table's");
    drop(twice);
    drop(zero);
}

/* By default the warm-up is a fortieth of the iterations, and the rates are the paper's. */
static void test_defaults(void)
{
    struct run *one = retrain("--iterations 40"), *said_so, *two;

    said_so =
        retrain("--iterations 40 --warmup 1 --lr-table 8e-3 --lr-sh 1e-3 --lr-scale 3e-4 "
                "--lr-rotation 3e-5 --lr-opacity 8e-4 --lr-position 1.6e-4 --head-lr-factor 1 "
                "--lambda-dssim 0.2 --seed 0 --batch 3 --views-per-frame 1 --sh-degree 3 "
                "--features 4 "
                "--scene-normalise off --residual off --activation gelu --sh-increase-every 0 "
                "--dynamic-weight 1 --background black "
                "--method network --refine 0 --pair auto --preset paper --test-cams 0,15");
    two = retrain("--iterations 40 --warmup 2");
    ok(moved_array(one, said_so, "trained/table") == 0 &&
           moved_array(one, said_so, "trained/heads") == 0,
       "spelling out the defaults changes nothing");
    ok(moved_array(one, two, "trained/table") > 1e-6, "another warm-up does");
    drop(one), drop(said_so), drop(two);
}

/* ---- Residual values of each splat */

/* With --residual points splats start almost transparent, except those that no training camera
 * sees, which keep the source's opacity: without gradients they would stay transparent. */
static void test_unseen(void)
{
    char more[300];
    struct spin_views views = {0};
    struct spin_splats source = {0};
    size_t n, unseen = 0, wrong = 0;
    struct run *r;
    float *values;
    char *data = NULL;

    snprintf(more, sizeof more,
             "%s --residual points --range 1:2 --lr-residual 0 --test-cams 0,3,7,12,15,19", still);
    r = retrain(more);
    values = array_of(r, "trained/residual/00000", &n);
    if (!ok(spin_bundle_data_path(&r->bundle, &data) == SPIN_OK &&
                spin_views_open(data, NULL, &views, NULL, 0) == SPIN_OK &&
                spin_bundle_frame(&r->bundle, 0, SPIN_COL_MEANS | SPIN_COL_LOGIT_OPACITIES,
                                  &source) == SPIN_OK &&
                n == 11 * source.n,
            "views and source"))
        source.n = 0;
    for (size_t i = 0; i < source.n; i++) {
        bool seen = false;

        for (const struct spin_view *v = spin_views_row(&views, 1);
             v < views.view + views.n && v->dataset_frame == 1; v++) {
            double at[3];

            seen |= (v->camera_id == 23 || v->camera_id == 27) &&
                    spin_camera_project(&v->camera, source.means + 3 * i, at) && at[0] >= 0 &&
                    at[1] >= 0 && at[0] < v->camera.width && at[1] < v->camera.height;
        }
        unseen += !seen;
        wrong += !(fabsf(values[11 * i + 10] - (seen ? -2.1972246f : source.logit_opacities[i])) <
                   1e-5f);
    }
    ok(unseen > 10 && unseen < source.n, "%zu splats are in no training picture", unseen);
    ok(wrong == 0, "they begin with the source's opacity, all others faint (%zu do not)", wrong);
    free(values);
    spin_splats_free(&source);
    spin_views_free(&views);
    free(data);
    drop(r);
}

static void test_own(void)
{
    static const char *const word[] = {"points", "source"};
    static const double rate[] = {5e-3, 1e-3, 2.5e-3, 0.05};
    static const size_t first[] = {0, 3, 7, 10, 11};
    size_t n, m;
    float *opacity[2];
    struct run *off;

    for (int k = 0; k < 2; k++) {
        char more[300];
        struct run *stay, *go;
        float *a, *b;

        snprintf(more, sizeof more, "%s --residual %s --range 1:2 --lr-residual 0", still, word[k]);
        stay = retrain(more);
        snprintf(more, sizeof more, "%s --residual %s --range 1:2 --lr-residual 0.5", still,
                 word[k]);
        go = retrain(more);
        a = array_of(stay, "trained/residual/00000", &n);
        b = array_of(go, "trained/residual/00000", &m);
        for (int g = 0; g < 4 && ok(n == m && n == 11 * 2940, "eleven values a splat"); g++) {
            double most = 0;

            for (size_t i = 0; i < n / 11; i++)
                most = larger(most, farthest(a + 11 * i, b + 11 * i, first[g], first[g + 1]));
            near(most, 0.5 * rate[g], 2e-3 * rate[g], "--lr-residual is on 3DGS's rates");
        }
        is_text(spin_json_string(spin_json_get(go->options, "residual")), word[k], "--residual");
        near(number(go->options, "lr_residual"), 0.5, 0, "--lr-residual is in the bundle");
        opacity[k] = a;
        if (k == 1) {
            float *source = array_of(stay, "source/logit_opacities", &m);
            bool same = m * 11 == n;

            for (size_t i = 0; i < m && same; i++)
                same = fabsf(a[11 * i + 10] - source[i]) < 1e-5f;
            ok(same, "--residual source: the source's opacities");
            free(source);
        }
        free(b);
        drop(stay), drop(go);
    }
    ok(farthest(opacity[0], opacity[1], 0, n) > 0.1, "points' values are not the source's");
    off = retrain("--preset short --iterations 1 --residual off");
    ok(!spin_npz_has(&off->bundle.npz, "trained/residual/00000"),
       "--residual off: nothing, whatever the preset");
    drop(off);
    free(opacity[0]);
    free(opacity[1]);
}

/* ---- Camera colours -----------------------------------------------------------------------------
 */

/* The images of a camera, darkened by a fifth, or (corners) by a sixth of r^2, see
 * math/exposure.h. */
static bool darken(const char *data, int camera, bool corners, bool red)
{
    for (int f = 8; f < 14; f++) {
        char path[700];
        int width, height;
        uint8_t *rgb;

        snprintf(path, sizeof path, "%s/%s/ims/%d/%06d.jpg", folder, data, camera, f);
        if (spin_image_read(path, NULL, &width, &height, &rgb) != SPIN_OK)
            return false;
        for (int i = 0; i < 3 * width * height; i++) {
            double x = 2.0 * (i / 3 % width) / width - 1,
                   y = (2.0 * (i / 3 / width) - height) / width;

            if (!red || i % 3 == 0)
                rgb[i] = (uint8_t)(rgb[i] * (corners ? 1 - (x * x + y * y) / 6 : 0.8));
        }
        remove(path);
        if (spin_image_write(path, width, height, rgb, false) != SPIN_OK)
            return false;
        free(rgb);
    }
    return true;
}

/* c1 (k 0) or c2 of the only lens. */
static double lens_value(const struct run *r, size_t k, size_t c)
{
    return number_at(spin_json_at(spin_json_get(r->bundle.json, "lenses"), 0), k ? "c2" : "c1", c);
}

static void test_auto_exposure(void)
{
    static const char one[] = "--device cpu --threads 1 --scale 0.5 --iterations 1 -v --force";
    struct run r = {0};
    char path[600];

    ok(shell("%s/spin-retrain %s/in.spin -o %s/plain.spin %s", bin, folder, folder, one) == 0 &&
           strstr(said, "no exposure is learned"),
       "cameras alike: %s", said);
    snprintf(path, sizeof path, "%s/plain.spin", folder);
    read_bundle(&r, path);
    ok(!strcmp(spin_json_string(spin_json_get(r.options, "learn_exposure")), "off"),
       "and so it stands in the bundle");
    free_run(&r);
    ok(shell("cp -r %s %s/tinted && chmod -R u+w %s/tinted", clip, folder, folder) == 0 &&
           darken("tinted", 7, false, false),
       "a clip with a darker camera");
    ok(shell("%s/spin-retrain %s/in.spin --data %s/tinted -o %s/tinted.spin %s", bin, folder,
             folder, folder, one) == 0 &&
           strstr(said, "cameras differ in colour by ") &&
           strstr(said, "no falloff is measured (") &&
           strstr(said, "): learning an exposure for each camera\n"),
       "a darker camera is seen, and no falloff: %s", said);
    snprintf(path, sizeof path, "%s/tinted.spin", folder);
    read_bundle(&r, path);
    ok(!strcmp(spin_json_string(spin_json_get(r.options, "learn_exposure")), "on") &&
           spin_json_length(spin_json_get(r.network, "cameras")) == TRAINING,
       "and learned");
    ok(lens_value(&r, 0, 0) == 0 && lens_value(&r, 1, 0) == 0, "without a falloff");
    free_run(&r);
    ok(shell("cp -r %s %s/red && chmod -R u+w %s/red", clip, folder, folder) == 0 &&
           darken("red", 7, false, true) &&
           shell("%s/spin-retrain %s/in.spin --data %s/red -o %s/red.spin %s", bin, folder, folder,
                 folder, one) == 0 &&
           strstr(said, "cameras differ in colour by "),
       "so is one that is darker in red alone: %s", said);
    ok(shell("%s/spin-retrain %s/in.spin --data %s/tinted -o %s/tinted.spin %s "
             "--learn-exposure off",
             bin, folder, folder, folder, one) == 0 &&
           !strstr(said, "cameras differ"),
       "--learn-exposure off: not looked for");
    ok(shell("%s/spin-retrain %s/in.spin --data %s/tinted -o %s/tinted.spin %s --test-cams "
             "0,3,12,15,19,23",
             bin, folder, folder, folder, one) == 0 &&
           strstr(said, "no point is visible in three training cameras") &&
           strstr(said, "no exposure is learned") && !strstr(said, "cameras differ"),
       "two cameras have no mean to differ from: %s", said);
    ok(shell("%s/spin-retrain %s/in.spin --data %s/tinted -o %s/tinted.spin %s --test-cams "
             "0,3,12,15,19,23 --learn-exposure on",
             bin, folder, folder, folder, one) == 0 &&
           strstr(said, "exposures and falloff start from neutral values") &&
           !strstr(said, "cameras differ"),
       "and learn all the same when that is asked for: %s", said);
    ok(shell("%s/spin-eval %s/tinted.spin --data %s/tinted --device cpu --threads 1", bin, folder,
             folder) == 0 &&
           !strstr(said, "another lens"),
       "lenses of scaled pictures are found in those of full size: %s", said);
}

/* The focal lengths of the test camera at a frame, times factor. */
static bool zoom(const char *data, int place, double factor)
{
    char path[700];

    snprintf(path, sizeof path, "%s/%s/test_meta.json", folder, data);
    return shell("python3 -c \"import json; m = json.load(open('%s')); "
                 "[f[%d].__setitem__(0, [f[%d][0][0] * %g] + f[%d][0][1:]) for f in m['k']]; "
                 "json.dump(m, open('%s', 'w'))\"",
                 path, place, place, factor, place, path) == 0;
}

/* All cameras of a clip have the same lens, which darkens the corners: the falloff is found from
 * the points alone, and both spin-eval and spin-retrain apply it to test views. */
static void test_falloff(void)
{
    static const char one[] =
        "--device cpu --threads 1 --iterations 1 --force --lr-exposure 0 --precision full "
        "--backdrop off";
    struct run r = {0};
    char path[600];
    double corner, psnr, drawn = 0, plain;
    bool dark = shell("cp -r %s %s/lens && chmod -R u+w %s/lens", clip, folder, folder) == 0;

    for (int k = 0; k < TRAINING; k++)
        dark &= darken("lens", training[k], true, false);
    ok(dark, "a clip with dark corners");
    ok(shell("%s/spin-retrain %s/in.spin --data %s/lens -o %s/lens.spin %s", bin, folder, folder,
             folder, one) == 0 &&
           strstr(said, "% of the brightness in the corners: learning an exposure"),
       "dark corners are seen: %s", said);
    snprintf(path, sizeof path, "%s/lens.spin", folder);
    read_bundle(&r, path);
    corner = 1;
    for (size_t c = 0; c < 3; c++)
        corner += (1.31640625 * lens_value(&r, 0, c) + 1.7329 * lens_value(&r, 1, c)) / 3;
    ok(fabs(corner - (1 - 1.31640625 / 6)) < 0.08, "how dark they are: %.3f of %.3f", corner,
       1 - 1.31640625 / 6);
    ok(spin_json_length(spin_json_get(r.meta, "lenses")) == 1, "cameras of one kind share a lens");
    psnr = number(spin_json_get(r.network, "test"), "psnr");
    free_run(&r);
    ok(shell("%s/spin-eval %s/lens.spin --data %s/lens --device cpu --threads 1 --json", bin,
             folder, folder) == 0 &&
           strstr(said, "\"psnr\":"),
       "spin-eval --json");
    drawn = strtod(strstr(said, "\"psnr\":") + 7, NULL);
    ok(shell("%s/spin-retrain %s/in.spin --data %s/lens -o %s/plain.spin %s --learn-exposure off",
             bin, folder, folder, folder, one) == 0 &&
           shell("%s/spin-eval %s/plain.spin --data %s/lens --device cpu --threads 1 --json", bin,
                 folder, folder) == 0,
       "the same without a falloff");
    plain = said_number("psnr");
    ok(psnr < plain - 0.2, "test cameras, which are not darker, show it: %.4f dB, %.4f without it",
       psnr, plain);
    ok(fabs(drawn - psnr) < 1e-3, "spin-eval draws through the lens as well: %.4f dB, %.4f", drawn,
       psnr);
    ok(shell("%s/spin-export %s/lens.spin --to ply -o %s/lens-ply", bin, folder, folder) == 0 &&
           strstr(said, "exporting without the lens falloff") &&
           strstr(said, "exporting the colours of the mean camera: "),
       "an export says that it has no falloff, and no camera's own colours");
    ok(shell("%s/spin-eval %s/lens.spin --data %s/lens --device cpu --threads 1 --scale 0.5", bin,
             folder, folder) == 0 &&
           !strstr(said, "another lens"),
       "and those of full size in scaled pictures");
    ok(strstr(said, "images of a different size: --scale 1 measures at the same size") != NULL,
       "which the training has not seen, as is said");
    ok(!strstr(said, "exposure was learned"), "of test cameras no exposure was learned");
    ok(shell("%s/spin-eval %s/lens.spin --data %s/lens --device cpu --threads 1 --split all", bin,
             folder, folder) == 0 &&
           strstr(said, "36 of 48 views belong to cameras whose exposure was learned"),
       "of the others it was, and they are drawn without it: %s", said);
    ok(shell("%s/spin-eval %s/lens.spin --source --data %s/lens --device cpu --threads 1 --json",
             bin, folder, folder) == 0,
       "spin-eval --source");
    drawn = said_number("psnr");
    ok(shell("%s/spin-eval %s/in.spin --data %s/lens --device cpu --threads 1 --json", bin, folder,
             folder) == 0 &&
           fabs(said_number("psnr") - drawn) < 1e-9,
       "draws what was imported as it is, without a falloff");
    ok(shell("%s/spin-export %s/lens.spin --source --to ply -o %s/lens-source", bin, folder,
             folder) == 0 &&
           !strstr(said, "falloff"),
       "which is not told of it either");
    ok(zoom("lens", 1, 2) &&
           shell("%s/spin-eval %s/lens.spin --data %s/lens --device cpu --threads 1", bin, folder,
                 folder) == 0 &&
           strstr(said, "warning: camera 15 matches none of the learned lenses"),
       "a camera with another lens is told, which need not be the first: %s", said);
    ok(zoom("lens", 0, 2) &&
           shell("%s/spin-eval %s/lens.spin --data %s/lens --device cpu --threads 1", bin, folder,
                 folder) == 0 &&
           strstr(said, "warning: camera 0 matches none of the learned lenses"),
       "a camera with another lens is told: %s", said);
}

/* 4D splats inherit the cameras and the lens of the clip they are made from, and are rendered
 * through that lens. */
static void test_rows_4d(void)
{
    struct run tracks = {0}, rows = {0};
    const spin_json *before, *after;
    char path[600];
    double psnr, drawn, most = 0, falloff = 0;
    bool dark = shell("cp -r %s %s/rows && chmod -R u+w %s/rows", clip, folder, folder) == 0;

    for (int k = 0; k < TRAINING; k++)
        dark &= darken("rows", training[k], true, k == 0);
    ok(dark, "a clip with dark corners");
    ok(shell("%s/spin-retrain %s/in.spin --data %s/rows -o %s/tracks.spin --device cpu --threads 1 "
             "--iterations 60 --learn-exposure on --lr-exposure 0.02 --seed 2 --method tracks",
             bin, folder, folder, folder) == 0,
       "tracks of it: %s", said);
    ok(shell("%s/spin-retrain %s/tracks.spin --data %s/rows -o %s/rows.spin --device cpu --threads "
             "1 --iterations 1 --learn-exposure on --lr-exposure 0 --method 4d --precision full",
             bin, folder, folder, folder) == 0,
       "and 4D splats: %s", said);
    snprintf(path, sizeof path, "%s/tracks.spin", folder);
    read_bundle(&tracks, path);
    snprintf(path, sizeof path, "%s/rows.spin", folder);
    read_bundle(&rows, path);
    before = spin_json_get(tracks.network, "cameras");
    after = spin_json_get(spin_json_get(rows.bundle.json, "trained_4d"), "cameras");
    ok(spin_json_length(after) == TRAINING, "which know the training cameras");
    for (size_t i = 0; i < TRAINING; i++)
        for (size_t c = 0; c < 3; c++)
            most = larger(most, fabs(number_at(spin_json_at(before, i), "log_gain", c) -
                                     number_at(spin_json_at(after, i), "log_gain", c)));
    for (size_t c = 0; c < 3; c++)
        falloff = larger(falloff, fabs(lens_value(&tracks, 0, c) - lens_value(&rows, 0, c)));
    ok(most < 1e-6 && falloff < 1e-6, "as the tracks left them: gains to %.2g, falloff to %.2g",
       most, falloff);
    psnr = number(spin_json_get(spin_json_get(rows.bundle.json, "trained_4d"), "test"), "psnr");
    ok(shell("%s/spin-eval %s/rows.spin --data %s/rows --device cpu --threads 1 --json", bin,
             folder, folder) == 0,
       "spin-eval of them");
    drawn = said_number("psnr");
    ok(fabs(drawn - psnr) < 1e-3, "draws through the lens: %.4f dB, %.4f", drawn, psnr);
    ok(shell("%s/spin-export %s/rows.spin --to ply -o %s/rows-ply", bin, folder, folder) == 0 &&
           strstr(said, "exporting without the lens falloff"),
       "an export says that it has no falloff");
    free_run(&tracks);
    free_run(&rows);
}

/* The distance by which the first step moved a camera. */
static double gain_moved(const spin_json *cameras, const spin_json *first, size_t i, size_t c)
{
    return number_at(spin_json_at(cameras, i), "log_gain", c) -
           number_at(spin_json_at(first, i), "log_gain", c);
}

static void test_cameras(void)
{
    struct run *none = retrain(""), *one, *all, *start;
    const spin_json *cameras, *first;

    ok(spin_json_length(spin_json_get(none->network, "cameras")) == 0,
       "cameras have no colours by default");
    drop(none);
    all = retrain("--learn-exposure on --lr-exposure 0.01 --warmup 0 --iterations 12");
    cameras = spin_json_get(all->network, "cameras");
    ok(spin_json_length(cameras) == TRAINING, "--learn-exposure: one a training camera");
    for (size_t i = 0; i < TRAINING; i++) {
        const spin_json *camera = spin_json_at(cameras, i);

        ok(number(camera, "camera") == training[i], "camera %d", training[i]);
        for (size_t j = 0; j < i; j++) {
            double most = 0;

            for (size_t c = 0; c < 3; c++)
                most = larger(most, fabs(number_at(camera, "log_gain", c) -
                                         number_at(spin_json_at(cameras, j), "log_gain", c)));
            ok(most > 1e-4, "cameras %d and %d have different colours", training[j], training[i]);
        }
    }
    drop(all);

    /* One step at --lr-exposure changes the used cameras by the rate; then the mean over all
     * cameras is subtracted. */
    one = retrain(
        "--learn-exposure on --lr-exposure 0.01 --iterations 1 --warmup 1 --views-per-frame 3");
    cameras = spin_json_get(one->network, "cameras");
    start = retrain(
        "--learn-exposure on --lr-exposure 0 --iterations 1 --warmup 1 --views-per-frame 3");
    first = spin_json_get(start->network, "cameras");
    for (size_t c = 0; c < 3; c++) {
        double mean = 0, unseen = NAN;

        for (size_t i = 0; i < TRAINING; i++)
            mean += number_at(spin_json_at(cameras, i), "log_gain", c) / TRAINING;
        near(mean, 0, 1e-7, "their mean is 0");
        for (size_t i = 0; i < TRAINING; i++) {
            double value = gain_moved(cameras, first, i, c);
            bool seen = false;

            for (int k = 0; k < one->step[0].n; k++)
                seen = seen || one->step[0].view[k][1] == training[i];
            if (!seen)
                unseen = value;
        }
        for (size_t i = 0; i < TRAINING; i++) {
            double value = gain_moved(cameras, first, i, c);
            bool seen = false;

            for (int k = 0; k < one->step[0].n; k++)
                seen = seen || one->step[0].view[k][1] == training[i];
            near(fabs(value - unseen), seen ? 0.01 : 0, 1e-6,
                 seen ? "a camera of the step moves by --lr-exposure" : "others do not move");
        }
    }
    for (size_t k = 0; k < 2; k++)
        for (size_t c = 0; c < 3; c++)
            near(fabs(lens_value(one, k, c) - lens_value(start, k, c)), 0.01, 1e-6,
                 "the lens they share moves by --lr-exposure");
    drop(one);
    drop(start);
}

/* ---- Shapes and initial values */

static float most_of(const float *p, size_t n)
{
    float most = 0;

    for (size_t i = 0; i < n; i++)
        most = larger(most, fabsf(p[i]));
    return most;
}

/* Bias of the scale head's last layer. */
static double bias_of(const struct run *r)
{
    return (double)r->heads[r->field.heads.offset[SPIN_HEAD_SCALE + 1] - 1];
}

/* The median of each axis over both frames, and the inverse of the radius that contains nine
 * points in ten. */
static void norm_of(struct run *r, float centre[3], double *inverse)
{
    float *p[2], *value;
    size_t n[2], total;

    for (int f = 0; f < 2; f++)
        p[f] = array_of(r, f ? "trained/means/00001" : "trained/means/00000", &n[f]);
    total = (n[0] + n[1]) / 3;
    value = malloc(total * sizeof *value);
    for (size_t c = 0; c < 3; c++) {
        for (size_t i = 0; i < total; i++)
            value[i] = i < n[0] / 3 ? p[0][3 * i + c] : p[1][3 * (i - n[0] / 3) + c];
        qsort(value, total, sizeof *value, spin_by_float);
        centre[c] = value[total / 2];
    }
    for (size_t i = 0; i < total; i++) {
        const float *x = i < n[0] / 3 ? p[0] + 3 * i : p[1] + 3 * (i - n[0] / 3);

        value[i] = sqrtf((x[0] - centre[0]) * (x[0] - centre[0]) +
                         (x[1] - centre[1]) * (x[1] - centre[1]) +
                         (x[2] - centre[2]) * (x[2] - centre[2]));
    }
    qsort(value, total, sizeof *value, spin_by_float);
    *inverse = 1 / (double)value[(size_t)(0.9 * (double)(total - 1))];
    free(value), free(p[0]), free(p[1]);
}

static void test_network(void)
{
    char more[500];
    struct run *one = retrain(still), *r;
    float centre[3];
    double inverse;
    bool flag = false;

    ok(one->field.grid.n_levels == 4 && one->field.grid.n_features == 4 &&
           one->field.heads.hidden == 16 && one->field.sh_degree == 3,
       "the network's shape");
    ok(one->n_table == 4 * 4 * 1024, "of 2^10 rows a level");
    ok(one->field.grid.res[0][0] == 8 && one->field.grid.res[0][3] == 8 &&
           one->field.grid.res[3][0] == 32 && one->field.grid.res[3][3] == 16,
       "and its resolutions");
    ok(most_of(one->table, one->n_table) <= 1e-4f && most_of(one->table, one->n_table) > 0.9e-4f,
       "first values of the table lie in 1e-4");
    near(bias_of(one), -5, 0, "the first log scale is -5");
    ok(one->field.transform.inv_radius == 1 && !one->field.transform.raw && !one->field.heads.relu,
       "nothing is normalised, and the heads are GELU's");

    snprintf(more, sizeof more,
             "%s --levels 6 --features 2 --hash-log2 9 --hidden 8 --sh-degree 1 "
             "--finest-resolution 20,21,22,9 --activation relu",
             still);
    r = retrain(more);
    ok(r->field.grid.n_levels == 6, "--levels");
    ok(r->field.grid.n_features == 2, "--features");
    ok(r->n_table <= 6 * 2 * 512 && r->n_table > 5 * 2 * 512,
       "--hash-log2: at most 2^9 rows a level");
    ok(r->field.heads.hidden == 8, "--hidden");
    ok(r->field.sh_degree == 1, "--sh-degree");
    ok(r->field.grid.res[5][0] == 20 && r->field.grid.res[5][1] == 21 &&
           r->field.grid.res[5][2] == 22 && r->field.grid.res[5][3] == 9,
       "--finest-resolution, axis by axis");
    ok(r->field.heads.relu, "--activation relu");
    ok(fabs(r->step[0].l1 - one->step[0].l1) > 1e-3, "and the network draws otherwise");
    drop(r);

    snprintf(more, sizeof more, "%s --seed 1", still);
    r = retrain(more);
    ok(farthest(one->table, r->table, 0, one->n_table) > 1e-4 &&
           farthest(one->heads, r->heads, 0, one->field.n_heads) > 0.1,
       "--seed: other first values");
    drop(r);

    snprintf(more, sizeof more, "%s --scene-normalise auto", still);
    r = retrain(more);
    norm_of(r, centre, &inverse);
    ok(fabs((double)r->field.transform.inv_radius / inverse - 1) < 1e-4 &&
           memcmp(r->field.transform.centre, centre, sizeof centre) == 0,
       "--scene-normalise auto: from the points");
    drop(r);
    drop(one);
    snprintf(more, sizeof more, "%s", wide);
    one = retrain(more);
    snprintf(more, sizeof more, "%s --scene-normalise none", wide);
    r = retrain(more);
    ok(spin_json_bool(
           spin_json_get(spin_json_get(spin_json_get(r->network, "field"), "norm"), "raw"),
           &flag) &&
           flag,
       "--scene-normalise none: without the contraction");
    ok(fabs(r->step[1].l1 - one->step[1].l1) > 1e-6, "which draws otherwise");
    drop(r);
    snprintf(more, sizeof more, "%s --activation relu", wide);
    r = retrain(more);
    ok(fabs(r->step[1].l1 - one->step[1].l1) > 1e-6, "--activation alone draws otherwise");
    drop(r), drop(one);
}

/* Weights of the colour head's last layer behind the first degree. */
static float rest_of(const struct run *r)
{
    size_t hidden = (size_t)r->field.heads.hidden, n = (size_t)r->field.heads.n_out[SPIN_HEAD_SH];
    const float *w = r->heads + r->field.heads.offset[SPIN_HEAD_SH + 1] - n * (hidden + 1);

    return most_of(w + 3 * hidden, (n - 3) * hidden);
}

static void test_sh_every(void)
{
    struct run *never = retrain("--sh-increase-every 100"),
               *soon = retrain("--sh-increase-every 1");

    ok(rest_of(never) == 0, "--sh-increase-every 100: four steps know no direction");
    ok(rest_of(soon) > 0, "--sh-increase-every 1: they do");
    near(number(never->options, "sh_increase_every"), 100, 0,
         "--sh-increase-every is in the bundle");
    drop(never), drop(soon);
}

/* ---- Files, plans, the machine ------------------------------------------------------------------
 */

static void test_files(void)
{
    char more[700];
    struct run *one = retrain("");

    ok(one->n_tests == 1 && one->test[0] == 4, "test views are measured at the end");
    drop(one);
    snprintf(more, sizeof more, "--iterations 5 --eval-every 2 --preview %s/preview", folder);
    one = retrain(more);
    ok(one->n_tests == 3 && one->test[0] == 2 && one->test[1] == 4 && one->test[2] == 5,
       "--eval-every 2: after 2, 4 and the last");
    for (int i = 2; i <= 6; i += 2)
        for (int c = 0; c < TESTING; c++) {
            char name[80];

            snprintf(name, sizeof name, "cam_%02d_frame_00002_iteration_%07d.png", testing[c],
                     i < 6 ? i : 5);
            ok(is_png("preview", name, 3 * 40 + 2 * 4, 23), "--preview: %s", name);
        }
    ok(shell("test $(ls %s/preview | wc -l) = 6", folder) == 0, "and no other picture");
    drop(one);
}

static void test_plan(void)
{
    double memory;

    shell("%s/spin-retrain %s/in.spin --dry-run --json -q", bin, folder);
    ok(said_text("preset", "quick") && said_text("method", "tracks") &&
           said_number("iterations") == 1000 && said_number("densify_every") == 50 &&
           said_number("frames") == 6 && said_number("refine") == 0,
       "--dry-run without a preset: quick, by the numbers of frames and cameras");
    shell("%s/spin-retrain %s/in.spin --dry-run --json -q --preset best --range 1:3", bin, folder);
    ok(said_text("preset", "best") && said_number("iterations") == 1000 &&
           said_number("densify_every") == 50,
       "--preset best: no more for so few cameras");
    shell("%s/spin-retrain %s/in.spin --data renders --data-from renders:seed=0 --range 1:3 "
          "--dry-run --json -q",
          bin, folder);
    ok(said_number("iterations") == 1700 && said_number("densify_every") == 85,
       "with 24 cameras: by the number of frames that are used");
    shell("%s/spin-retrain %s/in.spin --dry-run --json -q --iterations 40", bin, folder);
    ok(said_number("iterations") == 40 && said_number("densify_every") == 2,
       "--iterations 40: densified by them");
    shell("%s/spin-retrain %s/in.spin --dry-run --json -q --densify-every 600", bin, folder);
    ok(said_number("densify_every") == 0, "the first densification would be as late as the last");
    shell("%s/spin-retrain %s/in.spin --dry-run --json -q --densify-every 599", bin, folder);
    ok(said_number("densify_every") == 599, "a step earlier there is one");
    shell("%s/spin-retrain %s/in.spin --dry-run --json -q --densify-until 0", bin, folder);
    ok(said_number("densify_every") == 0, "--densify-until 0: none");
    ok(shell("%s/spin-retrain %s/in.spin --dry-run --max-points 2940", bin, folder) == 0 &&
           strstr(said, "every 50 iterations, pruning only: --max-points is reached\n"),
       "as many splats as there may be: %s", said);
    ok(shell("%s/spin-retrain %s/in.spin --dry-run --max-points 2941", bin, folder) == 0 &&
           strstr(said, "every 50 iterations\n"),
       "one more: %s", said);
    shell("%s/spin-retrain %s/in.spin --dry-run --json -q --tracks auto --densify-every 9 "
          "--refine 5",
          bin, folder);
    ok(said_number("densify_every") == 0, "frames that were refined are not densified again");
    shell("%s/spin-retrain %s/in.spin --dry-run --json -q --refine 5", bin, folder);
    ok(said_text("preset", "paper") && said_text("method", "network") &&
           said_number("iterations") == 40000,
       "--refine without a preset: the paper's");
    shell("%s/spin-retrain %s/in.spin --dry-run --json -q --refine 0", bin, folder);
    ok(said_text("preset", "quick"), "but not --refine 0");
    shell("%s/spin-retrain %s/in.spin --dry-run --json -q --method tracks", bin, folder);
    ok(said_text("preset", "quick"), "nor --method tracks");
    shell("%s/spin-retrain %s/in.spin --dry-run --json -q --method=network", bin, folder);
    ok(said_text("preset", "paper") && said_number("iterations") == 40000,
       "--method network without a preset: the paper's");
    memory = said_number("bytes_needed");
    shell("%s/spin-retrain %s/in.spin --dry-run --json -q --preset short", bin, folder);
    ok(said_number("iterations") == 1500 && said_number("bytes_needed") < memory / 2,
       "--preset short");
    shell("%s/spin-retrain %s/in.spin --dry-run --json -q --preset=short", bin, folder);
    ok(said_number("iterations") == 1500, "or --preset=short");
    shell("%s/spin-retrain %s/in.spin --dry-run --json -q --method frames", bin, folder);
    ok(said_text("method", "frames") && said_text("preset", "paper") &&
           said_number("refine") == 2000,
       "--method frames: 2000 a frame");
    shell("%s/spin-retrain %s/in.spin --dry-run --json -q --method frames --refine 7", bin, folder);
    ok(said_number("refine") == 7, "--refine 7");
    shell("%s/spin-retrain %s/in.spin --dry-run --json -q --threads 1", bin, folder);
    ok(said_text("device", "cpu") && said_text("device", ", 1 thread)"), "--threads 1");
    shell("%s/spin-retrain %s/in.spin --dry-run --json -q --threads 3 --device cpu", bin, folder);
    ok(said_text("device", ", 3 threads)"), "--threads 3");
}

/* How the data set is read: its kind, its path, how frames are paired with its rows. */
/* The warnings of --dry-run with these options: all lines, or "". */
static void warns(const char *given, const char *want)
{
    shell("%s/spin-retrain %s/in.spin --dry-run %s 2>&1 >/dev/null", bin, folder, given);
    is_text(said, want, given);
}

static void test_idle(void)
{
    warns("", "");
    warns("--hash-log2 19 --lr-table=0.01",
          "warning: --hash-log2, --lr-table have no effect without a network\n");
    warns("--preset short --hash-log2 19 --lr-table 0.01 --iterations 3 --lr-residual 2", "");
    warns("--preset short --lr-track 1 --densify-every 5",
          "warning: --lr-track, --densify-every have no effect without tracks\n");
    warns("--lr-track 1 --densify-every 5 --average 0.5", "");
    warns("--preset short --average 0.5",
          "warning: --average has no effect without --method tracks or 4d\n");
    warns("--refine-start source --densify off",
          "warning: --refine-start, --densify have no effect without --refine\n");
    warns("--refine 5 --refine-start source --densify off --sh-degree 1", "");
    warns("--method frames --iterations 5 --lr-position 0",
          "warning: --iterations, --lr-position have no effect with --method frames\n");
    warns("--method frames --sh-degree 1 --sh-increase-every 5", "");
    warns("--sh-degree 1", "warning: --sh-degree has no effect with --method tracks\n");
    warns("--method frames --refine 1000 --sh-degree 1",
          "warning: --sh-degree has no effect if --refine ends before the first increase of the SH "
          "degree\n");
    warns("--method frames --refine 1001 --sh-degree 1", "");
    warns("--method frames --refine 5 --refine-start source --sh-degree 1 --sh-increase-every 2",
          "warning: --sh-increase-every has no effect with --refine-start source\n");
    warns("--method frames --save-every 5 --eval-every 5",
          "warning: --eval-every, --save-every have no effect with --method frames\n");
    warns("--save-every 5 --eval-every 5 --max-points 100", "");
    warns("--max-points 100 --densify-every 0",
          "warning: --max-points has no effect without densification\n");
    warns("--preset short --max-points 100",
          "warning: --max-points has no effect without densification\n");
    warns("--preset short --max-points 100 --refine 5", "");
    warns("--method frames --max-points 100", "");
    warns("--tracks auto --densify-every 9 --refine 5 --densify off --max-points 100",
          "warning: --max-points has no effect without densification\n");
    warns("--method frames --max-points 100 --densify off",
          "warning: --max-points has no effect without densification\n");
    warns("--learn-exposure off --lr-exposure 0.1",
          "warning: --lr-exposure has no effect without --learn-exposure\n");
    warns("--lr-exposure 0.1", "");
    warns("--residual off",
          "warning: --residual has no effect with tracks, which have their own values\n");
    warns("--residual source", "");
    warns("--method frames --tracks auto",
          "warning: --tracks has no effect with --method frames\n");
}

static void test_data(void)
{
    static struct run paired[3];
    struct run *r;
    char more[700];

    ok(shell("%s/spin-retrain %s/in.spin -o %s/x.spin %s --data-from transforms", bin, folder,
             folder, base) == 1 &&
           strstr(said, "transforms"),
       "--data-from: another reader looks for other files");
    ok(shell("%s/spin-retrain %s/in.spin -o %s/x.spin %s --data %s", bin, folder, folder, base,
             folder) == 1 &&
           strstr(said, folder),
       "--data: another folder is none");
    snprintf(more, sizeof more, "--data %s --data-from panoptic", clip);
    r = retrain(more);
    is_text(spin_json_string(spin_json_get(spin_json_get(r->meta, "data"), "from")), "panoptic",
            "--data and --data-from");
    drop(r);
    /* Two frames whose numbers are those of the data set's rows 1 and 3; by order they are rows 0
     * and 1. */
    if (!ok(shell("%s/spin-export %s/in.spin --to ply -o %s/ply --range 1:4:2", bin, folder,
                  folder) == 0 &&
                shell("cd %s/ply && rm sequence.json && mv frame_00001.ply frame_00009.ply && mv "
                      "frame_00003.ply frame_00011.ply",
                      folder) == 0 &&
                shell("%s/spin-import %s/ply -o %s/two.spin", bin, folder, folder) == 0,
            "two frames with numbers"))
        printf("#   %s\n", said);
    for (int i = 0; i < 3; i++) {
        static const char *const pair[] = {"--pair number", "--pair order", ""};

        if (!ok(shell("%s/spin-retrain %s/two.spin -o %s/run.spin --force --data %s --log "
                      "%s/pair.log %s --range 0:99 %s",
                      bin, folder, folder, clip, folder, base, pair[i]) == 0,
                "two frames of six: %s", *pair[i] ? pair[i] : "auto"))
            printf("#   %s\n", said);
        snprintf(more, sizeof more, "%s/pair.log", folder);
        memset(&paired[i], 0, sizeof paired[i]);
        read_log(&paired[i], more);
    }
    ok(paired[0].step[0].l1 != paired[1].step[0].l1,
       "--pair: rows by number are not rows by order");
    ok(paired[0].step[0].l1 == paired[2].step[0].l1, "auto: by number, where both have numbers");
}

/* A long run saves a checkpoint every 7 iterations. */
static void test_save_every(void)
{
    char path[600];
    spin_json *state = NULL;
    struct spin_npz part;
    pid_t pid = fork();

    if (pid == 0) {
        char command[1500];

        snprintf(command, sizeof command,
                 "exec %s/spin-retrain %s/in.spin -o %s/long.spin %s --iterations 1000000 "
                 "--save-every 7",
                 bin, folder, folder, base);
        execl("/bin/sh", "sh", "-c", command, (char *)NULL);
        _exit(127);
    }
    snprintf(path, sizeof path, "%s/long.spin.part", folder);
    for (int i = 0; i < 6000 && !spin_path_exists(path) && waitpid(pid, NULL, WNOHANG) == 0; i++)
        usleep(10000);
    kill(pid, SIGKILL);
    waitpid(pid, NULL, 0);
    if (spin_npz_open(path, &part) == SPIN_OK)
        state = json_in(&part, "state.json");
    if (ok(state != NULL, "--save-every 7: a state long before five minutes"))
        ok(number(state, "iteration") > 0 && fmod(number(state, "iteration"), 7) == 0,
           "of a seventh step");
    spin_json_free(state);
    spin_npz_close(&part);
    ok(shell("%s/spin-import --from d3dgs %s --data %s --positions-only -o %s/bare.spin", bin, clip,
             clip, folder) == 0,
       "the same clip without its attributes");
    for (int i = 0; i < 2; i++)
        ok(shell("timeout 20 %s/spin-retrain %s/%s -o %s/long.spin %s --iterations 1000000 "
                 "--save-every 7 "
                 "--resume %s",
                 bin, folder, i ? "bare.spin" : "in.spin", folder, base,
                 i ? "" : "--lr-table 0.5") == 2 &&
               strstr(said, "the options or the images differ"),
           "--resume refuses %s", i ? "another input" : "other rates");
}

/* ---- Frame by frame -----------------------------------------------------------------------------
 */

/* Cameras and losses in the log of a run with --method frames. */
struct refined {
    int n, n_cameras[32];
    double first, clones;
};

static struct refined refine(const char *more)
{
    static char line[4096];
    struct refined r = {0};
    char path[600];
    FILE *f;

    snprintf(path, sizeof path, "%s/refine.log", folder);
    if (!ok(shell("%s/spin-retrain %s/in.spin -o %s/refined.spin --log %s --device cpu --range 1:2 "
                  "--scale 0.25 --method frames --force -q %s",
                  bin, folder, folder, path, more) == 0,
            "spin-retrain --method frames %s", more)) {
        printf("#   %s\n", said);
        exit(tap_done());
    }
    f = fopen(path, "r");
    while (f && fgets(line, sizeof line, f)) {
        spin_json *j = NULL;
        double camera = -1;

        spin_json_parse("log", line, strlen(line), &j);
        if (spin_json_get(j, "refine") &&
            spin_json_number(spin_json_at(spin_json_at(spin_json_get(j, "views"), 0), 1),
                             &camera)) {
            if (r.n++ == 0)
                spin_json_number(spin_json_get(j, "loss"), &r.first);
            r.n_cameras[camera >= 0 && camera < 32 ? (int)camera : 31]++;
            if (spin_json_get(j, "clones"))
                r.clones += number(j, "clones") + number(j, "splits");
        }
        spin_json_free(j);
    }
    if (f)
        fclose(f);
    return r;
}

static bool sees_only(const struct refined *r, const int *cameras, int n)
{
    int seen = 0;

    for (int i = 0; i < n; i++)
        seen += r->n_cameras[cameras[i]] > 0 ? r->n_cameras[cameras[i]] : -r->n;
    return seen == r->n;
}

static void test_refine(void)
{
    static const int others[] = {0, 7, 12, 15, 23, 27};
    struct refined one = refine("--refine 12"), cams = refine("--refine 12 --test-cams 3,19"),
                   white = refine("--refine 12 --background white"),
                   dssim = refine("--refine 12 --lambda-dssim 0"),
                   source = refine("--refine 12 --refine-start source"),
                   anti = refine("--refine 12 --antialias on"),
                   seed = refine("--refine 12 --seed 2"), grown = refine("--refine 136"),
                   kept = refine("--refine 136 --densify off");

    ok(one.n == 12, "--refine 12: so many lines");
    ok(sees_only(&one, training, TRAINING),
       "frames are refined from every training view, no test view");
    ok(sees_only(&cams, others, 6), "--test-cams: exactly those listed are held out");
    ok(one.first != seed.first, "--seed: another first view");
    ok(fabs(white.first - one.first) > 0.01, "--background reaches its loss");
    ok(fabs(dssim.first - one.first) > 1e-3, "--lambda-dssim as well");
    ok(fabs(source.first - one.first) > 1e-3, "--refine-start source starts elsewhere");
    ok(fabs(anti.first - one.first) > 1e-5, "--antialias draws otherwise");
    ok(grown.clones > 0 && kept.clones == 0, "--densify");
}

/* ---- Tracks
 * -------------------------------------------------------------------------------------- */

/* Largest difference of columns [first, end) of the tracks' rows from `row` to `last`, or with b
 * NULL their largest size. */
static double farthest_rows(struct run *a, struct run *b, size_t row, size_t last, size_t first,
                            size_t end)
{
    size_t n, n_b;
    float *of_a = array_of(a, "trained/tracks", &n),
          *of_b = b ? array_of(b, "trained/tracks", &n_b) : NULL;
    double most = 0;

    for (size_t i = 0; i < n; i++)
        if (i / 14 >= row && i / 14 < last && i % 14 >= first && i % 14 < end)
            most = larger(most, fabs((double)of_a[i] - (of_b ? (double)of_b[i] : 0)));
    free(of_a);
    free(of_b);
    return most;
}

static double farthest_tracks(struct run *a, struct run *b, size_t first, size_t end)
{
    return farthest_rows(a, b, 0, SIZE_MAX, first, end);
}

/* Compares rows of residual values without their rotations, for which the bundle has the
 * rotation of neighbours. */
static double largest(struct run *r, const char *key)
{
    size_t n;
    float *values = array_of(r, key, &n);
    double most = 0;

    for (size_t i = 0; i < n; i++)
        if (i % SPIN_RESIDUAL < 3 || i % SPIN_RESIDUAL >= 7)
            most = larger(most, fabs((double)values[i]));
    free(values);
    return most;
}

static size_t length_of(struct run *r, const char *key)
{
    size_t n;

    free(array_of(r, key, &n));
    return n;
}

static double splats_of(const struct run *r) { return number_at(r->network, "splats", 0); }

static void test_tracks(void)
{
    struct run *off = retrain(""), *all = retrain("--tracks auto --warmup 0"),
               *only = retrain("--method tracks --warmup 0"),
               *fixed = retrain("--method tracks --warmup 0 --lr-track 0 --lr-displacement 0"),
               *values = retrain("--method tracks --warmup 0 --lr-displacement 0"),
               *places = retrain("--method tracks --warmup 0 --lr-track 0"),
               *shared = retrain("--method tracks --warmup 0 --dynamic-residual off"),
               *zero = retrain("--method tracks --warmup 0 --lr-residual 0"),
               *slow = retrain("--method tracks --warmup 0 --lr-tracked 0"),
               *grown =
                   retrain("--method tracks --warmup 0 --densify-every 2 --densify-threshold 1e-9 "
                           "--densify-until 1"),
               *capped =
                   retrain("--method tracks --warmup 0 --densify-every 2 --densify-threshold 1e-9 "
                           "--densify-until 1 --max-points 1"),
               *early =
                   retrain("--method tracks --warmup 0 --densify-every 2 --densify-threshold 1e-9 "
                           "--densify-until 0.4"),
               *calm = retrain("--method tracks --warmup 0 --densify-every 2 --densify-threshold 1 "
                               "--densify-until 1"),
               *soon = retrain("--method tracks --warmup 0 --track-iterations 2"),
               *soon_grown =
                   retrain("--method tracks --warmup 0 --track-iterations 2 --densify-every 2 "
                           "--densify-threshold 1e-9 --densify-until 1"),
               *two = retrain("--method tracks --warmup 0 --iterations 2"),
               *last = retrain("--method tracks --warmup 0 --iterations 1 --average 0.3"),
               *none = retrain("--method tracks --warmup 0 --iterations 1 --average 0"),
               *mean = retrain("--method tracks --warmup 0 --average 1 --densify-every 0"),
               *ends = retrain("--method tracks --warmup 0 --average 0.01 --densify-every 0");
    const spin_json *tracks = spin_json_get(all->network, "tracks");
    double n = number(tracks, "n");
    size_t moving = (size_t)number(tracks, "moving");

    ok(!spin_json_get(off->network, "tracks") && !spin_npz_has(&off->bundle.npz, "trained/tracks"),
       "no tracks by default");
    ok(n > 0 && n == splats_of(all) && length_of(all, "trained/tracks") == 14 * (size_t)n,
       "--tracks auto: rows of this run are the same Gaussians, a track each");
    ok(length_of(all, "trained/track/00000") == (size_t)n &&
           !spin_npz_has(&all->bundle.npz, "trained/track/00001"),
       "whose numbers stand there once for all frames");
    ok(length_of(all, "trained/means/00000") == 3 * (size_t)number(tracks, "moving"),
       "frames have places of tracks that move");
    ok(all->n_table == off->n_table, "and the network is there");
    ok(!spin_npz_has(&only->bundle.npz, "trained/table"), "--method tracks: it is not");
    ok(farthest_tracks(only, NULL, 3, 14) > 0 && farthest_tracks(only, fixed, 3, 14) > 1e-3 &&
           farthest_tracks(only, fixed, 0, 3) > 1e-6,
       "tracks are trained");
    ok(farthest_tracks(values, fixed, 0, 3) == 0 && farthest_tracks(values, fixed, 3, 14) > 1e-3,
       "--lr-displacement 0: their places stay");
    ok(farthest_tracks(places, fixed, 3, 14) == 0 && farthest_tracks(places, fixed, 0, 3) > 1e-6,
       "--lr-track 0: their values stay");
    ok(number(tracks, "varying") > 0 && length_of(shared, "trained/residual/00000") == 0 &&
           length_of(only, "trained/residual/00000") == 11 * (size_t)number(tracks, "varying"),
       "--dynamic-residual");
    ok(largest(only, "trained/residual/00000") > 1e-4 &&
           largest(zero, "trained/residual/00000") == 0,
       "--lr-residual 0: values of single frames stay");
    ok(largest(slow, "trained/residual/00000") == 0 && farthest_tracks(slow, fixed, 3, 14) > 1e-3,
       "--lr-tracked 0: those of tracks stay");
    ok(splats_of(grown) > splats_of(only) && splats_of(calm) <= splats_of(only),
       "--densify-every, --densify-threshold: %g splats, %g before", splats_of(grown),
       splats_of(only));
    ok(splats_of(capped) <= splats_of(only), "--max-points");
    ok(splats_of(early) == splats_of(only), "--densify-until");
    ok(farthest_tracks(last, fixed, 3, 14) > 1e-3 && farthest_tracks(none, fixed, 3, 14) < 1e-5,
       "rates end at zero with --average 0 alone");
    ok(farthest_tracks(mean, ends, 3, 14) > 1e-3, "--average: a mean of more steps is another");
    ok(farthest_tracks(soon, fixed, 3, 14) > 1e-3 &&
           farthest_rows(soon, two, moving, SIZE_MAX, 0, 14) < 1e-5 &&
           farthest_rows(soon, two, 0, moving, 3, 14) > 1e-3 &&
           farthest_tracks(soon, only, 3, 14) > 1e-3 &&
           largest(soon, "trained/residual/00000") > 1e-4,
       "--track-iterations 2: after two steps tracks that stand still stay, the others do not");
    ok(splats_of(soon_grown) == splats_of(only), "nor are they densified then");
    drop(off), drop(all), drop(only), drop(fixed), drop(values), drop(places), drop(shared),
        drop(zero), drop(slow);
    drop(last), drop(none), drop(mean), drop(ends);
    drop(grown), drop(capped), drop(early), drop(calm);
}

/* ---- All ----------------------------------------------------------------------------------------
 */

/* ---- When tracks are densified
 * -------------------------------------------------------------------- */

/* One epoch without motion, then a densification. */
struct densified {
    int clones, splits, tracks;
    float *values; /* of the tracks, groups one after the other */
};

static struct densified densify(int batch, int steps, const char *more)
{
    struct densified d = {-1, -1, -1, NULL};
    struct spin_bundle bundle;
    char path[600];
    const char *line;
    size_t n;

    ok(shell("%s/spin-retrain %s/in.spin -o %s/run.spin --force --preset paper --device cpu "
             "--threads 1 --range 1:3 "
             "--scale 0.25 --precision full --method tracks --warmup 0 --lr-track 0 "
             "--lr-displacement 0 --lr-residual 0 "
             "--lr-position 0 --densify-until 1 -v --batch %d --iterations %d --track-iterations "
             "%d --densify-every %d %s",
             bin, folder, folder, batch, steps + 1, steps + 1, steps, more) == 0,
       "batches of %d, %s", batch, more);
    line = strstr(said, "clones,");
    while (line && line > said && line[-1] != '\n')
        line--;
    if (line)
        sscanf(line, "iteration %*d: %d clones, %d splits, %*d pruned; now %d tracks", &d.clones,
               &d.splits, &d.tracks);
    snprintf(path, sizeof path, "%s/run.spin", folder);
    if (spin_bundle_open(path, &bundle) != SPIN_OK)
        exit(1);
    d.values = check_values(&bundle, "trained/tracks", &n);
    spin_bundle_close(&bundle);
    return d;
}

static void test_densify(void)
{
    struct densified one = densify(1, 12, ""), three = densify(3, 4, ""), six = densify(6, 2, ""),
                     low = densify(3, 4, "--densify-threshold 1e-9"),
                     most = densify(3, 4, "--max-points 3000"),
                     none = densify(3, 4, "--densify-threshold 1"),
                     again = densify(3, 4, "--seed 1"), other = densify(3, 4, "--seed 2");
    double far = 0;
    int before = three.tracks - three.splits;

    ok(one.splits > 50 && one.splits == three.splits && six.splits == one.splits,
       "a view counts alike in batches of 1, 3 and 6: %d splits", one.splits);
    ok(low.splits > three.splits, "--densify-threshold");
    ok(most.tracks == 3000 && before < 3000, "--max-points: %d of %d tracks", most.tracks,
       three.tracks);
    for (int i = 0; i < 14 * again.tracks; i++)
        far = larger(far, fabs((double)again.values[i] - (double)other.values[i]));
    ok(again.tracks == other.tracks && far == 0, "the seed does not choose what is split, and how");
    ok(one.clones + three.clones + low.clones == 0 && none.splits == 0, "tracks are not cloned");
    free(none.values), free(one.values), free(three.values), free(six.values), free(low.values);
    free(most.values), free(again.values), free(other.values);
}

/* The opacity logits of the backdrop's tracks, which are the last ones: whether all are
 * unchanged, and the sum of their colours. */
static bool stays_opaque(struct run *r, size_t backdrop, double *colour)
{
    size_t length;
    float *rows = check_values(&r->bundle, "trained/tracks", &length);
    bool all = length >= 14 * backdrop && backdrop > 0;

    *colour = 0;
    for (size_t i = length - 14 * backdrop; all && i < length; i += 14) {
        all = rows[i + 13] == 5;
        *colour += (double)rows[i + 10];
    }
    free(rows);
    return all;
}

/* The number of splats that spin-export omits from one frame, or -1. */
static double left_out(const char *options)
{
    return shell("rm -rf %s/plys; %s/spin-export %s/run.spin --to ply -o %s/plys --range 1:2 -q "
                 "--json %s",
                 folder, bin, folder, folder, options) == 0
               ? said_number("filtered")
               : -1;
}

static void test_backdrop(void)
{
    static const char tracks[] = "--method tracks --warmup 0 --densify-every 0 --backdrop";
    static const char grown[] = "--method tracks --warmup 0 --densify-every 2 --densify-threshold "
                                "1e-9 --densify-until 1 --backdrop on";
    char options[300];
    struct run *off, *on, *found, *more, *paper = retrain("--tracks auto");
    size_t n, n_more;
    double before, after;

    snprintf(options, sizeof options, "%s off", tracks);
    off = retrain(options);
    snprintf(options, sizeof options, "%s auto", tracks);
    found = retrain(options);
    more = retrain(grown);
    snprintf(options, sizeof options, "%s on --lr-track 0", tracks);
    on = retrain(options);
    n = (size_t)number(spin_json_get(on->network, "tracks"), "backdrop");
    n_more = (size_t)number(spin_json_get(more->network, "tracks"), "backdrop");
    ok(!spin_json_get(spin_json_get(paper->network, "tracks"), "backdrop"),
       "the paper's recipe has no backdrop");
    ok(n > 200 && splats_of(on) - splats_of(off) == (double)n,
       "--backdrop on adds %zu splats to a frame", n);
    ok((size_t)number(spin_json_get(found->network, "tracks"), "backdrop") == n,
       "auto: so does an image whose border shows a room");
    ok(stays_opaque(on, n, &before) && stays_opaque(found, n, &after) && before != after,
       "they keep their opacity and learn a colour");
    ok(n_more == n && splats_of(more) > splats_of(on) && stays_opaque(more, n, &after),
       "they are not split where others are");
    ok(left_out("--backdrop auto") == 0 && left_out("--backdrop off") == (double)n,
       "spin-export --backdrop off leaves them out");
    free_run(off), free_run(on), free_run(found), free_run(more), free_run(paper);
    free(off), free(on), free(found), free(more), free(paper);
}

TAP_MAIN
{
    begin_commands();
    PART(test_backdrop);
    PART(test_views);
    PART(test_loss);
    PART(test_rates);
    PART(test_defaults);
    PART(test_own);
    PART(test_unseen);
    PART(test_cameras);
    PART(test_auto_exposure);
    PART(test_falloff);
    PART(test_rows_4d);
    PART(test_network);
    PART(test_sh_every);
    PART(test_files);
    PART(test_plan);
    PART(test_idle);
    PART(test_data);
    PART(test_save_every);
    PART(test_refine);
    PART(test_tracks);
    PART(test_densify);
}
