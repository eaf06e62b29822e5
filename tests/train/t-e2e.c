/* Whole training iterations compared with PyTorch: the loss of each, the first image, the first
 * gradients and the final weights; and identical bits for any number of threads, and on a device
 * that works asynchronously and whose memory the host cannot read.
 * K: golden threads e2e */
#include "train/step.h"
#include "base/number.h"
#include "render/image_store.h"
#include "tests/check.h"
#include "tests/device/strict.h"
#include "tests/tap.h"

enum { MOST = 16 }; /* frames, cameras, images of a batch */

static const char *const head_name[SPIN_HEADS] = {"scale", "rot", "sh", "opacity"};
static const char *const part_name[6] = {"w1", "b1", "w2", "b2", "w3", "b3"};

struct fixture {
    struct spin_npz npz;
    int frames, cameras, batch, steps, sh_degree;
    float background[3];
    size_t points[MOST], at[MOST + 1]; /* of a frame; floats of positions before it */
    struct spin_camera camera[MOST];
    float *photos; /* [frames][cameras][3][height][width] */
    double *order;
    float *table0, *heads0;
};

struct result {
    double *loss;
    float *image0, *table, *heads, *g1_table, *g1_heads;
    float *pos, *g1_pos; /* of all frames, one after the other */
    struct spin_field field;
};

static struct spin_camera load_camera(struct fixture *f, int k)
{
    char key[32];
    struct spin_camera c;
    double *v;

    snprintf(key, sizeof key, "cam%d_intr", k);
    v = check_load(&f->npz, key, NULL);
    c.fx = v[0], c.fy = v[1], c.cx = v[2], c.cy = v[3];
    free(v);
    snprintf(key, sizeof key, "cam%d_size", k);
    v = check_load(&f->npz, key, NULL);
    c.width = (int)v[0], c.height = (int)v[1];
    free(v);
    snprintf(key, sizeof key, "cam%d_R", k);
    v = check_load(&f->npz, key, NULL);
    for (int i = 0; i < 9; i++)
        c.w2c[i / 3 * 4 + i % 3] = v[i];
    free(v);
    snprintf(key, sizeof key, "cam%d_t", k);
    v = check_load(&f->npz, key, NULL);
    for (int i = 0; i < 3; i++)
        c.w2c[i * 4 + 3] = v[i];
    free(v);
    return c;
}

/* The shape of an array: its first two numbers. */
static void shape_of(struct fixture *f, const char *key, int shape[2])
{
    struct spin_array info;

    free(check_load(&f->npz, key, &info));
    shape[0] = (int)info.shape[0];
    shape[1] = (int)info.shape[1];
}

/* The grid of the fixture, and a network of its size. */
static void load_model(struct fixture *f, struct spin_field *field)
{
    const int base[4] = {2, 2, 2, 2};
    double *scale = check_load(&f->npz, "scale_l", NULL), *res = check_load(&f->npz, "res", NULL);
    double *offset = check_load(&f->npz, "offset", NULL);
    int levels[2], table[2], hidden[2];

    shape_of(f, "scale_l", levels);
    shape_of(f, "table0", table);
    shape_of(f, "init_scale_w1", hidden);
    ok(spin_field_plan(field, levels[0], table[1], 10, hidden[0], f->sh_degree, base, base) ==
           SPIN_OK,
       "plans the network");
    for (int l = 0; l < levels[0]; l++) {
        uint64_t product = 1;

        for (int d = 0; d < 4; d++) {
            field->grid.scale[l][d] = (float)scale[l * 4 + d];
            field->grid.res[l][d] = (uint32_t)res[l * 4 + d];
            product *= field->grid.res[l][d];
        }
        field->grid.offset[l + 1] = (uint32_t)offset[l + 1];
        field->grid.hashed[l] = product > field->grid.offset[l + 1] - field->grid.offset[l];
    }
    field->n_table = (size_t)field->grid.offset[levels[0]] * (size_t)table[1];
    field->time_first = 0;
    field->time_last = f->frames - 1;
    free(scale);
    free(res);
    free(offset);
}

/* Offset and length in floats of part k of head h within the heads' parameters. */
static size_t part_at(const struct spin_field *m, int head, int part, size_t *n)
{
    size_t hidden = (size_t)m->heads.hidden, in = (size_t)m->heads.n_in;
    size_t out = (size_t)m->heads.n_out[head], at = m->heads.offset[head];
    size_t size[6] = {hidden * in, hidden, hidden * hidden, hidden, out * hidden, out};

    for (int i = 0; i < part; i++)
        at += size[i];
    *n = size[part];
    return at;
}

static float *load_heads(struct fixture *f, const struct spin_field *m)
{
    float *heads = calloc(m->n_heads, sizeof *heads);
    char key[48];

    for (int h = 0; h < SPIN_HEADS; h++)
        for (int part = 0; part < 6; part++) {
            size_t n, at = part_at(m, h, part, &n);
            struct spin_array info;
            float *v;

            snprintf(key, sizeof key, "init_%s_%s", head_name[h], part_name[part]);
            v = check_load_f32(&f->npz, key, &info);
            if (info.count == n)
                memcpy(heads + at, v, n * sizeof *v);
            else
                ok(0, "%s has %zu numbers", key, n);
            free(v);
        }
    return heads;
}

static float *fetch(struct spin_device *d, const float SPIN_DEV *from, size_t n)
{
    float *to = malloc(n * sizeof *to);

    if (d->op->download(d, to, from, n * sizeof *to) != SPIN_OK)
        ok(0, "downloads: %s", spin_last_error());
    return to;
}

/* The gradient of the first step, from the moment m after it: m = 0.1 g. */
static float *tenfold(struct spin_device *d, const float SPIN_DEV *m, size_t n)
{
    float *g = fetch(d, m, n);

    for (size_t i = 0; i < n; i++)
        g[i] *= 10;
    return g;
}

static double setting(const char *path) { return check_setting("e2e.npz", path); }

static void fill_trainer(struct fixture *f, struct spin_trainer *t)
{
    struct spin_device *d = t->device;

    d->op->upload(d, t->table.p, f->table0, t->table.n * sizeof(float));
    d->op->upload(d, t->heads.p, f->heads0, t->heads.n * sizeof(float));
    for (int k = 0; k < f->frames; k++) {
        char key[32];
        float *pos;

        snprintf(key, sizeof key, "pos0_%d", k);
        pos = check_load_f32(&f->npz, key, NULL);
        d->op->upload(d, t->frame[k].pos, pos, f->points[k] * 3 * sizeof *pos);
        t->frame[k].time = k;
        free(pos);
    }
    t->rates.table = setting("lr0.encoder");
    t->rates.head[SPIN_HEAD_SCALE] = setting("lr0.scale");
    t->rates.head[SPIN_HEAD_ROTATION] = setting("lr0.rot");
    t->rates.head[SPIN_HEAD_SH] = setting("lr0.sh");
    t->rates.head[SPIN_HEAD_OPACITY] = setting("lr0.opacity");
    t->rates.position = setting("lr0.position");
    t->rates.end = setting("lr_end");
    t->rates.warmup = (int64_t)setting("warmup");
    t->rates.iterations = f->steps;
    t->lambda_dssim = (float)setting("lambda_dssim");
    for (int c = 0; c < 3; c++)
        t->background[c] = f->background[c];
}

static void keep_first(struct fixture *f, struct spin_trainer *t, struct result *r)
{
    r->g1_table = tenfold(t->device, t->table.m, t->table.n);
    r->g1_heads = tenfold(t->device, t->heads.m, t->heads.n);
    for (int k = 0; k < f->frames; k++) {
        float *g = tenfold(t->device, t->frame[k].m, f->points[k] * 3);

        memcpy(r->g1_pos + f->at[k], g, f->points[k] * 3 * sizeof *g);
        free(g);
    }
}

/* The first image, before any step. */
static float *draw_first(struct fixture *f, struct spin_trainer *t,
                         const struct spin_train_item *item)
{
    struct spin_train_frame *frame = &t->frame[item->frame];
    size_t n = f->points[item->frame];
    struct spin_frame_batch frames =
        spin_one_frame(n, frame->pos, spin_field_time(&t->field, frame->time), NULL);
    struct spin_view_batch views = spin_raster_batch(&t->raster, t->background);

    spin_raster_add_view(&t->raster, &views, 0, n, item->camera, false);
    spin_field_forward(&t->field_eval, &t->field, t->table.p, t->heads.p, &frames);
    if (spin_raster_forward(&t->raster, &views, &frames, t->field_eval.attr, f->sh_degree) !=
        SPIN_OK)
        ok(0, "draws: %s", spin_last_error());
    return fetch(t->device, t->raster.image,
                 3 * (size_t)(item->camera->width * item->camera->height));
}

static void run(struct fixture *f, struct spin_device *d, struct result *r)
{
    struct spin_trainer t;
    struct spin_image_store photos;
    size_t pixels = 0, tiles = 0;
    int n_photos = f->frames * f->cameras;
    struct spin_trainer_size size;
    struct spin_frame_size frame[MOST];

    memset(r, 0, sizeof *r);
    load_model(f, &r->field);
    if (!f->heads0)
        f->heads0 = load_heads(f, &r->field);
    r->loss = calloc((size_t)f->steps, sizeof *r->loss);
    r->pos = calloc(f->at[f->frames], sizeof *r->pos);
    r->g1_pos = calloc(f->at[f->frames], sizeof *r->g1_pos);
    for (int k = 0; k < f->cameras; k++) {
        struct spin_camera_f32 cam = spin_camera_f32_from(&f->camera[k]);
        size_t p = (size_t)(cam.width * cam.height), n = (size_t)(cam.tiles_x * cam.tiles_y);

        pixels = p > pixels ? p : pixels;
        tiles = n > tiles ? n : tiles;
    }
    size = (struct spin_trainer_size){.n_frames = f->frames,
                                      .frame = frame,
                                      .network = true,
                                      .max_items = f->batch,
                                      .max_pixels = pixels,
                                      .max_tiles = tiles};
    for (int i = 0; i < f->frames; i++)
        frame[i] = (struct spin_frame_size){f->points[i], f->points[i], f->points[i], 0};
    ok(spin_trainer_open(&t, d, &r->field, &size) == SPIN_OK &&
           spin_image_store_open(&photos, d, (size_t)n_photos, pixels, SPIN_IMAGE_F32, false) ==
               SPIN_OK,
       "opens");
    fill_trainer(f, &t);
    for (int k = 0; k < n_photos; k++)
        spin_image_store_put(&photos, (uint32_t)k, pixels, f->photos + (size_t)k * 3 * pixels,
                             NULL);
    for (int i = 0; i < f->steps; i++) {
        struct spin_train_item items[MOST] = {0};
        struct spin_train_values v = {0};

        for (int k = 0; k < f->batch; k++) {
            int shows = (int)f->order[(i * f->batch + k) * 2];
            int camera = (int)f->order[(i * f->batch + k) * 2 + 1];

            items[k].frame = shows;
            items[k].camera = &f->camera[camera];
            items[k].image = (uint32_t)(shows * f->cameras + camera);
        }
        if (i == 0)
            r->image0 = draw_first(f, &t, &items[0]);
        if (spin_trainer_step(&t, &photos.images, items, f->batch, &v) != SPIN_OK)
            ok(0, "step %d: %s", i, spin_last_error());
        r->loss[i] = v.loss;
        if (i == 0)
            keep_first(f, &t, r);
    }
    r->table = fetch(d, t.table.p, t.table.n);
    r->heads = fetch(d, t.heads.p, t.heads.n);
    for (int k = 0; k < f->frames; k++)
        if (d->op->download(d, r->pos + f->at[k], t.frame[k].pos,
                            f->points[k] * 3 * sizeof *r->pos) != SPIN_OK)
            ok(0, "downloads");
    spin_image_store_close(&photos);
    spin_trainer_close(&t);
}

static void run_plainly(struct fixture *f, int n_threads, struct result *r)
{
    struct spin_device *d = check_device(n_threads);

    run(f, d, r);
    check_device_free(d);
}

static void free_result(struct result *r)
{
    free(r->loss);
    free(r->pos);
    free(r->g1_pos);
    free(r->image0);
    free(r->table);
    free(r->heads);
    free(r->g1_table);
    free(r->g1_heads);
}

static double five_times(const char *key, const char *what)
{
    char path[96];

    snprintf(path, sizeof path, "float32_weight_deviation.%s.%s", key, what);
    return 5 * setting(path);
}

/* Adam turns gradients of 1e-12 into full steps, so final weights are compared by medians and
 * 95th percentiles of the deviation: five times that of PyTorch's own float32 (see the
 * manifest), beyond two units in the last place. */
static void check_spread(struct fixture *f, const char *key, const float *got, size_t n,
                         double median, double p95)
{
    double *want = check_load(&f->npz, key, NULL);
    double *off = malloc(n * sizeof *off);

    for (size_t i = 0; i < n; i++)
        off[i] = fmax(0, fabs((double)got[i] - want[i]) - 0x1p-22 * fabs(want[i]));
    qsort(off, n, sizeof *off, spin_by_double);
    if (!ok(off[n / 2] <= median && off[(size_t)(0.95 * (double)n)] <= p95,
            "%s in the end: median and 95th percentile of the deviation", key))
        printf("#   median %.3g (limit %.3g), p95 %.3g (limit %.3g)\n", off[n / 2], median,
               off[(size_t)(0.95 * (double)n)], p95);
    free(want);
    free(off);
}

/* A bias of four numbers has no percentile: its limits are those of the head's worst part. */
static void check_head(struct fixture *f, const struct result *r, int head)
{
    double median = 0, p95 = 0;
    char key[48];

    for (int part = 0; part < 6; part++) {
        snprintf(key, sizeof key, "final_%s_%s", head_name[head], part_name[part]);
        median = larger(median, five_times(key, "median"));
        p95 = larger(p95, five_times(key, "p95"));
    }
    for (int part = 0; part < 6; part++) {
        size_t n, at = part_at(&r->field, head, part, &n);

        snprintf(key, sizeof key, "final_%s_%s", head_name[head], part_name[part]);
        check_spread(f, key, r->heads + at, n, median, p95);
    }
}

static void check_first(struct fixture *f, struct result *r)
{
    double tolerance = check_tolerance("e2e.npz", "g1_rel_to_absmax", 5e-4);
    struct spin_array info;
    double *want = check_load(&f->npz, "image0", &info);
    char key[48];

    check_close(r->image0, want, (size_t)info.count,
                check_tolerance("e2e.npz", "first_image_abs", 2e-5), 0, "the first picture");
    free(want);
    want = check_load(&f->npz, "g1_table", NULL);
    check_rel_to_absmax(r->g1_table, want, r->field.n_table, tolerance,
                        "first gradient of the table");
    free(want);
    for (int k = 0; k < f->frames; k++) {
        snprintf(key, sizeof key, "g1_pos%d", k);
        want = check_load(&f->npz, key, NULL);
        check_rel_to_absmax(r->g1_pos + f->at[k], want, f->points[k] * 3, tolerance, key);
        free(want);
    }
    for (int h = 0; h < SPIN_HEADS; h++)
        for (int part = 0; part < 6; part++) {
            size_t n, at = part_at(&r->field, h, part, &n);

            snprintf(key, sizeof key, "g1_%s_%s", head_name[h], part_name[part]);
            want = check_load(&f->npz, key, NULL);
            check_rel_to_absmax(r->g1_heads + at, want, n, tolerance, key);
            free(want);
        }
}

/* Compares everything with PyTorch. */
static void check_golden(struct fixture *f, struct result *r, const char *what)
{
    double *loss = check_load(&f->npz, "loss", NULL);
    double tolerance = check_tolerance("e2e.npz", "loss_abs", 5e-5), worst = 0;
    char key[48];

    for (int i = 0; i < f->steps; i++)
        worst = larger(worst, fabs(r->loss[i] - loss[i]));
    ok(worst <= tolerance, "%s: %d losses follow PyTorch's (worst %.2g, tolerance %.2g)", what,
       f->steps, worst, tolerance);
    check_first(f, r);
    for (int k = 0; k < f->frames; k++) {
        snprintf(key, sizeof key, "final_pos%d", k);
        check_spread(f, key, r->pos + f->at[k], f->points[k] * 3, five_times(key, "median"),
                     five_times(key, "p95"));
    }
    check_spread(f, "final_table", r->table, r->field.n_table, five_times("final_table", "median"),
                 five_times("final_table", "p95"));
    for (int h = 0; h < SPIN_HEADS; h++)
        check_head(f, r, h);
    free(loss);
}

static int same(struct fixture *f, const struct result *a, const struct result *b)
{
    return memcmp(a->loss, b->loss, (size_t)f->steps * sizeof *a->loss) == 0 &&
           memcmp(a->table, b->table, a->field.n_table * sizeof(float)) == 0 &&
           memcmp(a->heads, b->heads, a->field.n_heads * sizeof(float)) == 0 &&
           memcmp(a->pos, b->pos, f->at[f->frames] * sizeof *a->pos) == 0;
}

static void check_path(struct fixture *f, const char *path)
{
    struct result one, many;

    setenv("SPIN_CPU", path, 1);
    run_plainly(f, 1, &one);
    check_golden(f, &one, path);
    for (int n_threads = 2; n_threads <= 8; n_threads += n_threads == 2 ? 1 : 5) {
        run_plainly(f, n_threads, &many);
        ok(same(f, &one, &many), "%s: %d threads give the bits of one", path, n_threads);
        free_result(&many);
    }
    free_result(&one);
}

/* Asynchronously, and with memory that the host cannot read: nothing is used before it was
 * requested. Then with all frames and views of an iteration in one call. */
static void check_strict(struct fixture *f)
{
    struct result one, late;
    struct spin_device *d = strict_open(check_device(1), 1, 1);
    int complaints = strict_complaints();

    run_plainly(f, 1, &one);
    run(f, d, &late);
    strict_close(d);
    ok(same(f, &one, &late), "a strict device gives the same bits");
    free_result(&one);
    free_result(&late);
    d = strict_open(check_device(2), SPIN_MAX_FRAMES, SPIN_MAX_VIEWS);
    run(f, d, &late);
    strict_close(d);
    check_golden(f, &late, "all frames and views at once");
    ok(strict_complaints() == complaints, "and it has nothing to complain about");
    free_result(&late);
}

/* Another device: the golden values, also if its work is queued and its memory is closed to the
 * host. */
static void check_device_golden(struct fixture *f)
{
    struct result r;
    struct spin_device *d;
    int complaints = strict_complaints();

    run_plainly(f, 1, &r);
    check_golden(f, &r, check_device_name());
    free_result(&r);
    d = strict_open(check_device(1), SPIN_MAX_FRAMES, SPIN_MAX_VIEWS);
    run(f, d, &r);
    strict_close(d);
    check_golden(f, &r, "strictly");
    ok(strict_complaints() == complaints, "and the strict device has nothing to complain about");
    free_result(&r);
}

TAP_MAIN
{
    const char *path = check_fixture("core/e2e.npz");
    const char *const paths[] = {"base", "v3", "v4"};
    struct fixture f;

    memset(&f, 0, sizeof f);
    if (!path) {
        skip("e2e", "no fixture core/e2e.npz");
        return;
    }
    if (spin_npz_open(path, &f.npz) != SPIN_OK) {
        ok(0, "opens: %s", spin_last_error());
        return;
    }
    f.frames = (int)setting("frames");
    f.cameras = (int)setting("cameras");
    f.batch = (int)setting("batch");
    f.steps = (int)setting("iterations");
    f.sh_degree = (int)setting("sh_degree");
    if (!ok(f.frames > 0 && f.frames <= MOST && f.cameras > 0 && f.cameras <= MOST && f.batch > 0 &&
                f.batch <= MOST && f.steps > 0,
            "%d steps of %d pictures; %d frames, %d cameras", f.steps, f.batch, f.frames,
            f.cameras))
        return;
    for (int k = 0; k < f.frames; k++) {
        struct spin_array info;
        char key[32];

        snprintf(key, sizeof key, "pos0_%d", k);
        free(check_load(&f.npz, key, &info));
        f.points[k] = (size_t)info.shape[0];
        f.at[k + 1] = f.at[k] + (size_t)info.count;
    }
    for (size_t c = 0; c < 3; c++) {
        const spin_json *background = spin_json_get(check_meta("e2e.npz"), "background");
        double value = NAN;

        ok(spin_json_number(spin_json_at(background, c), &value), "the background is told");
        f.background[c] = (float)value;
    }
    for (int k = 0; k < f.cameras; k++)
        f.camera[k] = load_camera(&f, k);
    f.photos = check_load_f32(&f.npz, "gt", NULL);
    f.order = check_load(&f.npz, "order", NULL);
    f.table0 = check_load_f32(&f.npz, "table0", NULL);
    for (int i = 0; i < 3 && check_device_is_cpu(); i++) {
        struct spin_device d;

        setenv("SPIN_CPU", paths[i], 1);
        if (spin_device_open("cpu", 1, &d) != SPIN_OK) {
            skip(paths[i], spin_last_error());
            continue;
        }
        spin_device_close(&d);
        check_path(&f, paths[i]);
    }
    unsetenv("SPIN_CPU");
    if (check_device_is_cpu())
        check_strict(&f);
    else
        check_device_golden(&f);
    free(f.photos);
    free(f.order);
    free(f.table0);
    free(f.heads0);
    spin_npz_close(&f.npz);
}
