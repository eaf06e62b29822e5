/* Refinement of one frame: iterations with densifications compared with the reference, identical
 * bits for any number of threads, and the guarantees of the options.
 * K: golden threads refine */
#include "tests/train/one_frame.h"
#include "base/number.h"
#include "tests/device/strict.h"

/* STEPS: for runs without a reference. */
enum { MOST_VIEWS = 16, MOST_STEPS = 1000, STEPS = 40, MOST_DENSIFY = 16 };

struct fixture {
    struct spin_npz npz;
    int views, steps, n_densify;
    struct spin_camera view[MOST_VIEWS];
    size_t pixels;   /* of a view */
    float *truth;    /* [views][3][height][width] */
    bool upper_half; /* only these pixels count */
    int densify_at[MOST_DENSIFY];
    float *noise[MOST_DENSIFY];
    size_t n_noise[MOST_DENSIFY];
    int order[MOST_STEPS];
    struct spin_refine_cloud start;
};

/* What the observer recorded. */
struct log {
    struct fixture *f;
    struct one_step step[MOST_STEPS];
    int n;
    int cancel_at;
};

static void load_camera(struct fixture *f, int k)
{
    struct spin_camera *c = &f->view[k];
    double *v[4];
    const char *part[4] = {"intr", "R", "t", "size"};

    for (int i = 0; i < 4; i++) {
        char key[32];

        snprintf(key, sizeof key, "cam%d_%s", k, part[i]);
        v[i] = check_load(&f->npz, key, NULL);
    }
    c->width = (int)v[3][0], c->height = (int)v[3][1];
    c->fx = v[0][0], c->fy = v[0][1], c->cx = v[0][2], c->cy = v[0][3];
    for (int i = 0; i < 3; i++) {
        for (int j = 0; j < 3; j++)
            c->w2c[4 * i + j] = v[1][3 * i + j];
        c->w2c[4 * i + 3] = v[2][i];
    }
    for (int i = 0; i < 4; i++)
        free(v[i]);
}

static double setting(const char *path) { return check_setting("refine.npz", path); }

static void load_densifications(struct fixture *f)
{
    const spin_json *at = spin_json_get(check_meta("refine.npz"), "densify_iterations");

    f->n_densify = (int)spin_json_length(at);
    ok(f->n_densify > 0 && f->n_densify <= MOST_DENSIFY, "%d densifications", f->n_densify);
    for (int i = 0; i < f->n_densify; i++) {
        struct spin_array info;
        char key[32];
        int64_t iteration = 0;

        spin_json_integer(spin_json_at(at, (size_t)i), &iteration);
        f->densify_at[i] = (int)iteration;
        ok(f->densify_at[i] == (i + 1) * f->densify_at[0], "the same number of iterations apart");
        snprintf(key, sizeof key, "noise_%d", f->densify_at[i]);
        f->noise[i] = check_load_f32(&f->npz, key, &info);
        f->n_noise[i] = (size_t)info.shape[0];
    }
}

static void load(struct fixture *f)
{
    struct spin_array info;
    float *xyz, *colour;
    double *order = check_load(&f->npz, "order", &info);
    size_t n;

    f->steps = (int)info.count;
    for (int i = 0; i < f->steps && i < MOST_STEPS; i++)
        f->order[i] = (int)order[i];
    f->truth = check_load_f32(&f->npz, "gt", &info);
    f->views = (int)info.shape[0];
    f->pixels = (size_t)(info.shape[2] * info.shape[3]);
    if (!ok(f->steps <= MOST_STEPS && f->views <= MOST_VIEWS, "%d iterations, %d views", f->steps,
            f->views))
        exit(tap_done());
    for (int k = 0; k < f->views; k++)
        load_camera(f, k);
    load_densifications(f);
    xyz = check_load_f32(&f->npz, "xyz0", &info);
    n = (size_t)info.shape[0];
    colour = check_load_f32(&f->npz, "color_u8", NULL);
    for (size_t i = 0; i < 3 * n; i++)
        colour[i] /= 255;
    ok(spin_refine_init_from_points(NULL, n, xyz, colour, &f->start) == SPIN_OK,
       "starts from points and colours");
    free(xyz);
    free(colour);
    free(order);
}

static void given_normals(void *context, int iteration, size_t n, float *out)
{
    struct fixture *f = ((struct log *)context)->f;
    int k = 0;

    while (k + 1 < f->n_densify && f->densify_at[k] != iteration)
        k++;
    if (ok(iteration == f->densify_at[k] && n == f->n_noise[k], "iteration %d splits %zu points",
           iteration, n / 2))
        memcpy(out, f->noise[k], n * 3 * sizeof *out);
}

static void watch(void *context, const struct one_step *step)
{
    struct log *log = context;

    if (log->n < MOST_STEPS)
        log->step[log->n++] = *step;
    if (log->cancel_at == step->iteration)
        spin_cancel();
}

/* "1.6e-4*2 -> 1.6e-6*2 log-linear over 40": rates times the scale of the scene. */
static void position_rates(double *from, double *to)
{
    const spin_json *lr = spin_json_get(check_meta("refine.npz"), "lr");
    const char *text = spin_json_string(spin_json_get(lr, "xyz"));
    double a, b, scale_a, scale_b;

    *from = *to = NAN;
    if (ok(text && sscanf(text, "%lf*%lf -> %lf*%lf", &a, &scale_a, &b, &scale_b) == 4,
           "the manifest says how positions are learned")) {
        *from = a * scale_a;
        *to = b * scale_b;
    }
}

/* The fixture's settings, from its manifest: densification uses another extent than the rates. */
static struct one_frame fixture_options(struct fixture *f, struct log *log)
{
    const spin_json *background = spin_json_get(check_meta("refine.npz"), "background");
    struct one_frame o;
    double from, to, value;

    position_rates(&from, &to);
    one_frame_defaults(&o, f->steps, setting("extent"));
    o.rates.position = from;
    o.rates.position_end = to;
    o.rates.residual[SPIN_HEAD_SCALE] = setting("lr.scaling");
    o.rates.residual[SPIN_HEAD_ROTATION] = setting("lr.rotation");
    o.rates.residual[SPIN_HEAD_SH] = setting("lr.f_dc");
    o.rates.residual[SPIN_HEAD_OPACITY] = setting("lr.opacity");
    for (size_t c = 0; c < 3; c++)
        if (spin_json_number(spin_json_at(background, c), &value))
            o.background[c] = (float)value;
    o.schedule = (struct spin_schedule){0, f->densify_at[f->n_densify - 1] + 1, f->densify_at[0]};
    o.no_final_prune = true;
    o.densify.gradient_threshold = setting("threshold");
    o.densify.percent_dense = setting("percent_dense");
    o.densify.prune_opacity = setting("prune_opacity");
    o.densify.normals = given_normals;
    o.densify.context = log;
    o.watch = watch;
    o.context = log;
    return o;
}

static struct one_frame plain_options(struct log *log)
{
    struct one_frame o;

    one_frame_defaults(&o, STEPS, 2);
    o.schedule.every = 5;
    o.watch = watch;
    o.context = log;
    return o;
}

static struct spin_refine_cloud copy_of(const struct spin_refine_cloud *from)
{
    struct spin_refine_cloud c = {0};

    if (spin_refine_cloud_reserve(&c, from->n) != SPIN_OK)
        exit(1);
    memcpy(c.point, from->point, from->n * sizeof *c.point);
    c.n = from->n;
    if (from->sh_degree > 0 && spin_refine_add_sh(from->sh_degree, NULL, &c) != SPIN_OK)
        exit(1);
    return c;
}

static spin_status run_on(struct spin_device *d, struct fixture *f, const struct one_frame *o,
                          const int *order, struct log *log, struct spin_refine_cloud *cloud,
                          struct one_stats *stats)
{
    struct spin_image_store photos;
    uint8_t *mask = calloc(f->pixels / 8 + 1, 1);
    spin_status status;

    for (size_t i = f->pixels / 2; i < f->pixels; i++)
        mask[i / 8] |= (uint8_t)(1 << i % 8);
    log->f = f;
    *cloud = copy_of(&f->start);
    ok(spin_image_store_open(&photos, d, (size_t)f->views, f->pixels, SPIN_IMAGE_F32,
                             f->upper_half) == SPIN_OK,
       "room for the pictures");
    photos.images.mask_weight[1] = 0;
    for (int k = 0; k < f->views; k++)
        spin_image_store_put(&photos, (uint32_t)k, f->pixels, f->truth + (size_t)k * 3 * f->pixels,
                             f->upper_half ? mask : NULL);
    status = one_frame_run(d, o, &photos.images, f->view, f->views, order, cloud, stats);
    free(mask);
    spin_image_store_close(&photos);
    return status;
}

static spin_status run(struct fixture *f, const struct one_frame *o, const int *order,
                       int n_threads, struct log *log, struct spin_refine_cloud *cloud,
                       struct one_stats *stats)
{
    struct spin_device *d = check_device(n_threads);
    spin_status status = run_on(d, f, o, order, log, cloud, stats);

    check_device_free(d);
    return status;
}

/* Adam turns tiny gradients into full steps, so a few values may diverge in float32, but not 95
 * of 100. The manifest allows ten times the deviation of PyTorch's own float32 in the worst
 * group; here each group has ten times its own. `first` and `width` are floats of a row. */
static void check_group(struct fixture *f, const struct spin_refine_cloud *c, const char *group,
                        size_t first, size_t width)
{
    struct spin_array info;
    char key[32], path[48];
    double torch_p95, *want, *off;
    size_t n, at;

    snprintf(key, sizeof key, "final_%s", group);
    snprintf(path, sizeof path, "float32_p95.%s", group);
    torch_p95 = setting(path);
    want = check_load(&f->npz, key, &info);
    n = (size_t)info.count;

    if (!ok(n == c->n * width, "%s: as many points", key))
        return;
    off = malloc(n * sizeof *off);
    for (size_t i = 0; i < n; i++)
        off[i] = fabs(((const float *)&c->point[i / width].p)[first + i % width] - want[i]);
    qsort(off, n, sizeof *off, spin_by_double);
    at = (size_t)(0.95 * (double)n);
    if (!ok(off[at] <= 10 * torch_p95 &&
                off[at] <= check_tolerance("refine.npz", "final_p95_abs", 8.4e-3),
            "%s: 95 of 100 within ten times what PyTorch's float32 does", key))
        printf("#   median %.3g, p95 %.3g (limit %.3g), largest %.3g\n", off[n / 2], off[at],
               10 * torch_p95, off[n - 1]);
    free(off);
    free(want);
}

static void check_losses(struct fixture *f, const struct log *log)
{
    double *loss = check_load(&f->npz, "loss", NULL), *count = check_load(&f->npz, "count", NULL);
    double tolerance = check_tolerance("refine.npz", "loss_abs", 7e-5), worst = 0;
    int counts = 1, views = 1;

    for (int i = 0; i < f->steps; i++) {
        worst = larger(worst, fabs(log->step[i].loss - loss[i]));
        counts &= log->step[i].n == (size_t)count[i];
        views &= log->step[i].view == f->order[i];
    }
    if (!ok(worst <= tolerance, "every loss as the reference's"))
        printf("#   off by up to %.3g, allowed %.3g\n", worst, tolerance);
    ok(counts, "as many points in every iteration");
    ok(views, "the views in the order given");
    free(loss);
    free(count);
}

/* The densifications listed in the manifest: clones, splits, points pruned. */
static void check_change(struct fixture *f, const struct log *log, int k, size_t *clones)
{
    const spin_json *list = spin_json_get(check_meta("refine.npz"), "clone_split_prune");
    const spin_json *row = spin_json_at(list, (size_t)k);
    const struct one_step *step = &log->step[f->densify_at[k] - 1];
    int64_t want[3] = {-1, -1, -1};

    for (size_t i = 0; i < 3; i++)
        spin_json_integer(spin_json_at(row, i), &want[i]);
    ok(step->densified && (int64_t)step->change.clones == want[0] &&
           (int64_t)step->change.splits == want[1] && (int64_t)step->change.pruned == want[2],
       "iteration %d: %d clones, %d splits, %d pruned", f->densify_at[k], (int)want[0],
       (int)want[1], (int)want[2]);
    *clones += (size_t)want[0];
}

static void against_reference(struct fixture *f)
{
    static struct log log, again;
    struct one_frame o = fixture_options(f, &log);
    struct spin_refine_cloud one, many;
    struct one_stats stats;
    struct spin_array last;
    size_t clones = 0;

    ok(run(f, &o, f->order, 1, &log, &one, &stats) == SPIN_OK && log.n == f->steps, "%d iterations",
       f->steps);
    check_losses(f, &log);
    for (int k = 0; k < f->n_densify; k++)
        check_change(f, &log, k, &clones);
    free(check_load(&f->npz, "final_xyz", &last));
    ok(stats.n_first == f->start.n && stats.n_last == last.shape[0] &&
           stats.densifications == f->n_densify && stats.change.clones == clones &&
           stats.loss_last == log.step[f->steps - 1].loss,
       "the sums say the same");
    check_group(f, &one, "xyz", 0, 3);
    check_group(f, &one, "f_dc", 10, 3);
    check_group(f, &one, "opacity", 13, 1);
    check_group(f, &one, "scaling", 3, 3);
    check_group(f, &one, "rotation", 6, 4);

    o.context = o.densify.context = &again;
    ok(run(f, &o, f->order, 3, &again, &many, NULL) == SPIN_OK && many.n == one.n, "three threads");
    check_same_bits(many.point, one.point, one.n * sizeof *one.point,
                    "the same bits for any number of threads");
    spin_refine_cloud_free(&one);
    spin_refine_cloud_free(&many);
}

/* Each round contains every view once; rounds differ, and so do seeds. */
static void random_views(struct fixture *f)
{
    struct log log = {0}, same = {0}, other = {0};
    struct one_frame o = plain_options(&log);
    struct spin_refine_cloud c;
    int rounds = 1, repeats = 1, alike = 1, differ = 0;

    ok(run(f, &o, NULL, 1, &log, &c, NULL) == SPIN_OK, "draws views by itself");
    spin_refine_cloud_free(&c);
    o.context = &same;
    ok(run(f, &o, NULL, 2, &same, &c, NULL) == SPIN_OK, "and again");
    spin_refine_cloud_free(&c);
    o.context = &other;
    o.densify.frame = 1;
    ok(run(f, &o, NULL, 2, &other, &c, NULL) == SPIN_OK, "and for another frame");
    spin_refine_cloud_free(&c);
    for (int i = 0; i + f->views <= STEPS; i += f->views) {
        int seen = 0;

        for (int k = 0; k < f->views; k++) {
            seen |= 1 << log.step[i + k].view;
            repeats &= log.step[i + k].view == log.step[k].view;
        }
        rounds &= seen == (1 << f->views) - 1;
    }
    for (int i = 0; i < STEPS; i++) {
        alike &= log.step[i].view == same.step[i].view && log.step[i].loss == same.step[i].loss;
        differ |= log.step[i].view != other.step[i].view;
    }
    ok(rounds, "every view has its turn in every round");
    ok(!repeats, "rounds differ");
    ok(alike, "the same views and losses from the same seed");
    ok(differ, "other views for another frame");
}

/* The default window of K = 40: densify in (8, 30), here at every fifth iteration. */
static void window_and_cap(struct fixture *f)
{
    struct log log = {0}, capped = {0};
    struct one_frame o = plain_options(&log);
    struct spin_refine_cloud c;
    struct one_stats stats;
    int in_window = 1, below_cap = 1, faint = 0;

    ok(run(f, &o, NULL, 2, &log, &c, &stats) == SPIN_OK, "refines with the defaults");
    for (int i = 0; i < STEPS; i++) {
        int it = i + 1;

        in_window &= log.step[i].densified == (it > 8 && it < 30 && it % 5 == 0);
    }
    ok(in_window, "densifies after K/5 and before 3K/4");
    ok(stats.densifications == 4 && stats.n_last > f->start.n, "the cloud grows");
    ok(stats.loss_last < 0.9 * stats.loss_first, "the loss falls");
    ok(stats.n_last == c.n, "and the number of points is right");
    spin_refine_cloud_free(&c);

    o.context = &capped;
    o.densify.max_points = f->start.n + 10;
    o.densify.prune_opacity = 0.09;
    ok(run(f, &o, NULL, 2, &capped, &c, &stats) == SPIN_OK, "refines with a cap");
    for (int i = 0; i < STEPS; i++)
        below_cap &= capped.step[i].n <= f->start.n + 10;
    ok(below_cap, "which is kept");
    for (size_t i = 0; i < c.n; i++)
        faint |= c.point[i].p.logit_opacity < logf(0.09f / 0.91f) - 1e-5f;
    ok(!faint && stats.change.pruned > 0, "no faint point is handed on");
    spin_refine_cloud_free(&c);
}

/* The largest distance of the coefficients of a degree from 0. */
static double moved(const struct spin_refine_cloud *c, int degree)
{
    size_t first = 3 * (size_t)(degree * degree - 1), last = first + 3 * (size_t)(2 * degree + 1);
    double largest = 0;

    for (size_t i = 0; i < c->n; i++)
        for (size_t k = first; k < last; k++)
            largest = larger(largest, fabs((double)c->sh[3 * SPIN_REFINE_SH * i + k]));
    return largest;
}

/* A cloud with SH: the degree rises by one after a fixed number of iterations. Adam's first step
 * of a coefficient, in iteration k, has a length that depends on k and the rate alone. */
static void sh_rises(struct fixture *f)
{
    static const struct {
        int iterations, degree;
    } run_of[] = {{10, 0}, {11, 1}, {21, 2}, {41, 3}};
    double m = 0.1 / (1 - pow(0.9, 11)), v = 0.001 / (1 - pow(0.999, 11));
    struct log log = {0};
    struct one_frame o = plain_options(&log);
    struct spin_refine_cloud c, many;

    f->start.sh_degree = 3;
    o.sh_increase_every = 10;
    o.schedule.every = 0;
    o.rates.sh = 1e-2;
    for (size_t k = 0; k < sizeof run_of / sizeof *run_of; k++) {
        bool right = true;

        o.iterations = run_of[k].iterations;
        o.rates.iterations = o.iterations;
        ok(run(f, &o, NULL, 1, &log, &c, NULL) == SPIN_OK, "%d iterations", o.iterations);
        for (int degree = 1; degree <= 3; degree++)
            right &= (moved(&c, degree) > 0) == (degree <= run_of[k].degree);
        ok(right && spin_sh_degree_reached(3, 10, o.iterations) == run_of[k].degree,
           "SH comes to degree %d", run_of[k].degree);
        if (o.iterations == 11)
            ok(fabs(moved(&c, 1) / (1e-2 * m / sqrt(v)) - 1) < 1e-4, "by a first step of Adam");
        spin_refine_cloud_free(&c);
    }
    o.sh_increase_every = 0;
    o.iterations = 1;
    ok(run(f, &o, NULL, 1, &log, &c, NULL) == SPIN_OK && moved(&c, 3) > 0,
       "or has all degrees from the start");
    spin_refine_cloud_free(&c);
    o = plain_options(&log);
    o.sh_increase_every = 10;
    ok(run(f, &o, NULL, 1, &log, &c, NULL) == SPIN_OK && c.n > f->start.n &&
           run(f, &o, NULL, 3, &log, &many, NULL) == SPIN_OK && many.n == c.n,
       "with clones and splits, one thread and three");
    check_same_bits(many.sh, c.sh, 3 * SPIN_REFINE_SH * c.n * sizeof *c.sh, "the same bits");
    spin_refine_cloud_free(&c);
    spin_refine_cloud_free(&many);
    f->start.sh_degree = 0;
}

/* An iteration with densification keeps values and moments of the remaining points. */
static void sh_densified(struct fixture *f)
{
    struct log log = {0};
    struct one_frame o = plain_options(&log);
    struct spin_refine_cloud before, after;
    size_t kept = 0, same = 0;
    int at = STEPS + 1;

    f->start.sh_degree = 3;
    o.sh_increase_every = 5;
    o.rates.position_end = o.rates.position; /* else rates depend on the number of iterations */
    o.schedule.every = 0;
    o.no_final_prune = true;
    ok(run(f, &o, NULL, 1, &log, &before, NULL) == SPIN_OK, "%d iterations", STEPS);
    o.iterations = at;
    o.schedule = (struct spin_schedule){0, at + 1, at};
    o.densify.gradient_threshold = 5e-3; /* some stay */
    o.densify.prune_opacity = 0.09;
    ok(run(f, &o, NULL, 1, &log, &after, NULL) == SPIN_OK, "and one that densifies");
    /* remaining points come first, in their previous order */
    for (size_t i = 0; i < before.n && kept < after.n; i++) {
        if (memcmp(&after.point[kept].p, &before.point[i].p, 3 * sizeof before.point[i].p) != 0)
            continue;
        same += memcmp(after.sh + 3 * SPIN_REFINE_SH * kept++, before.sh + 3 * SPIN_REFINE_SH * i,
                       3 * SPIN_REFINE_SH * sizeof(float)) == 0;
    }
    ok(kept > 0 && kept < before.n && kept < after.n && same == kept,
       "%zu of %zu points stay, with their SH", kept, before.n);
    f->start.sh_degree = 0;
    spin_refine_cloud_free(&before);
    spin_refine_cloud_free(&after);
}

/* Views of a scene whose colours differ from side to side are fitted better with SH. */
static void sh_fits(struct fixture *f, const struct one_frame *plain, double without)
{
    struct log log = {0};
    struct one_frame o = *plain;
    struct spin_refine_cloud c;
    double with = 0;

    f->start.sh_degree = 3;
    o.sh_increase_every = 0;
    o.context = &log;
    ok(run(f, &o, NULL, 2, &log, &c, NULL) == SPIN_OK, "with SH of degree 3");
    for (int i = o.iterations - 3 * f->views; i < o.iterations; i++)
        with += log.step[i].loss;
    if (!ok(with < 0.9 * without, "the loss comes lower"))
        printf("#   %.4f without, %.4f with\n", without / (3 * f->views), with / (3 * f->views));
    f->start.sh_degree = 0;
    spin_refine_cloud_free(&c);
}

/* Cameras with different colours: gains and offsets per camera fit the frame better, and it
 * keeps the colours of the mean camera; identical bits for any number of threads. */
static void camera_colours(struct fixture *f)
{
    static const float gain[3] = {1.6f, 1, 1 / 1.6f};
    size_t values = 3 * f->pixels;
    struct fixture exposed = *f;
    struct log log = {0}, residual = {0};
    struct one_frame o = plain_options(&log);
    struct spin_refine_cloud c, many;
    double without = 0, with = 0;

    exposed.truth = malloc((size_t)f->views * values * sizeof(float));
    for (int k = 0; k < f->views; k++) {
        size_t at = (size_t)k * values;

        for (size_t i = 0; i < values; i++)
            exposed.truth[at + i] = gain[k % 3] * f->truth[at + i];
    }
    o.iterations = o.rates.iterations = 300;
    o.schedule = (struct spin_schedule){60, 225, 5};
    o.densify.max_points = 20 * f->start.n;
    ok(run(&exposed, &o, NULL, 2, &log, &c, NULL) == SPIN_OK, "views of other colours");
    spin_refine_cloud_free(&c);
    o.learns_exposure = true;
    o.rates.exposure = 1e-2;
    o.context = &residual;
    ok(run(&exposed, &o, NULL, 2, &residual, &c, NULL) == SPIN_OK, "with colours of their own");
    for (int i = 300 - 3 * f->views; i < 300; i++) {
        without += log.step[i].loss;
        with += residual.step[i].loss;
    }
    if (!ok(with < 0.9 * without, "the loss comes lower"))
        printf("#   %.4f without, %.4f with\n", without / (3 * f->views), with / (3 * f->views));
    o.learns_exposure = false;
    sh_fits(&exposed, &o, without);
    o.learns_exposure = true;
    o.rates.exposure = 1e-2;
    ok(run(&exposed, &o, NULL, 3, &residual, &many, NULL) == SPIN_OK && many.n == c.n,
       "three threads");
    check_same_bits(many.point, c.point, c.n * sizeof *c.point, "and the same bits");
    spin_refine_cloud_free(&c);
    spin_refine_cloud_free(&many);
    free(exposed.truth);
}

/* Each option has its effect. */
static void options_act(struct fixture *f)
{
    struct log log = {0}, weighted = {0}, faint = {0};
    struct one_frame o = plain_options(&log);
    struct spin_refine_cloud plain, c;

    o.schedule.every = 0;
    ok(run(f, &o, NULL, 2, &log, &plain, NULL) == SPIN_OK, "as it is");
    o.watch = watch;
    o.context = &faint;
    o.antialias = true;
    ok(run(f, &o, NULL, 2, &faint, &c, NULL) == SPIN_OK && faint.step[0].loss != log.step[0].loss,
       "antialiasing draws other pictures");
    spin_refine_cloud_free(&c);
    o.antialias = false;
    o.context = &weighted;
    f->upper_half = true;
    ok(run(f, &o, NULL, 2, &weighted, &c, NULL) == SPIN_OK &&
           weighted.step[0].loss != log.step[0].loss,
       "weights of pixels change the loss");
    f->upper_half = false;
    spin_refine_cloud_free(&c);
    spin_refine_cloud_free(&plain);
}

/* On a device that works asynchronously and whose memory the host cannot read. */
static void strictly(struct fixture *f)
{
    struct log log = {0};
    struct one_frame o = plain_options(&log);
    struct spin_refine_cloud c, late;
    struct spin_device *d = strict_open(check_device(2), 1, 1);
    int complaints = strict_complaints();

    f->start.sh_degree = 1;
    o.sh_increase_every = 5;
    o.learns_exposure = true;
    o.rates.exposure = 1e-2;
    o.schedule = (struct spin_schedule){0, 31, 15};
    ok(run(f, &o, NULL, 1, &log, &c, NULL) == SPIN_OK &&
           run_on(d, f, &o, NULL, &log, &late, NULL) == SPIN_OK && late.n == c.n,
       "refines on a strict device");
    check_same_bits(late.point, c.point, c.n * sizeof *c.point, "to the same bits");
    check_same_bits(late.sh, c.sh, c.n * 3 * SPIN_REFINE_SH * sizeof *c.sh, "of SH as well");
    f->start.sh_degree = 0;
    ok(strict_complaints() == complaints, "without a complaint");
    spin_refine_cloud_free(&c);
    spin_refine_cloud_free(&late);
    strict_close(d);
}

static void refuses(struct fixture *f)
{
    struct log log = {0};
    struct one_frame o = plain_options(&log);
    struct spin_refine_cloud c;

    o.sh_increase_every = 0;
    o.rates.sh = 1e45;
    o.iterations = 1;
    f->start.sh_degree = 1;
    ok(run(f, &o, NULL, 1, &log, &c, NULL) == SPIN_E_MALFORMED &&
           strstr(spin_last_error(), "array 'sh/00000/p' has a value that is not finite") != NULL,
       "SH that is not finite: %s", spin_last_error());
    f->start.sh_degree = 0;
    spin_refine_cloud_free(&c);
    o = plain_options(&log);
    o.schedule = (struct spin_schedule){0, 16, 15};
    o.densify.prune_opacity = 1;
    log.n = 0;
    ok(run(f, &o, NULL, 1, &log, &c, NULL) == SPIN_OK && c.n == 0 && log.n == 15,
       "a frame that loses all its points ends early");
    spin_refine_cloud_free(&c);
    o = plain_options(&log);
    o.rates.residual[SPIN_HEAD_OPACITY] = 1e45; /* overflows the floats of visible splats */
    o.schedule.every = 0;
    o.iterations = 1;
    ok(run(f, &o, NULL, 1, &log, &c, NULL) == SPIN_E_MALFORMED &&
           strstr(spin_last_error(), "array 'residual/00000/p' has a value that is not finite") !=
               NULL &&
           strstr(spin_last_error(), "iteration 1:") != NULL,
       "values that are not finite are not pruned without a word: %s", spin_last_error());
    spin_refine_cloud_free(&c);
    o = plain_options(&log);
    o.schedule = (struct spin_schedule){0, 16, 15};
    o.rates.residual[SPIN_HEAD_OPACITY] = 1e45;
    ok(run(f, &o, NULL, 1, &log, &c, NULL) == SPIN_E_MALFORMED &&
           strstr(spin_last_error(), "iteration 15:") != NULL,
       "nor by a densification: %s", spin_last_error());
    spin_refine_cloud_free(&c);
    o = plain_options(&log);
    log.cancel_at = 4; /* last: a cancelled process stays cancelled */
    log.n = 0;
    ok(run(f, &o, NULL, 1, &log, &c, NULL) == SPIN_E_CANCELLED && log.n == 4,
       "stops between iterations when asked to");
    spin_refine_cloud_free(&c);
}

TAP_MAIN
{
    static struct fixture f;
    const char *path = check_fixture("core/refine.npz");

    if (!path) {
        skip("refine", "no fixture core/refine.npz");
        return;
    }
    if (!ok(spin_npz_open(path, &f.npz) == SPIN_OK, "opens refine.npz"))
        return;
    load(&f);
    PART(against_reference, &f);
    PART(random_views, &f);
    PART(window_and_cap, &f);
    PART(camera_colours, &f);
    PART(sh_rises, &f);
    PART(sh_densified, &f);
    PART(options_act, &f);
    PART(strictly, &f);
    PART(refuses, &f);
    spin_refine_cloud_free(&f.start);
    free(f.truth);
    for (int i = 0; i < f.n_densify; i++)
        free(f.noise[i]);
    spin_npz_close(&f.npz);
}
