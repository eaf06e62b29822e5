/* Every memory allocation of an iteration fails once: the iteration fails with a message, and the
 * same device then completes it. Also counts the kernel launches of an iteration, which must not
 * depend on the number of splats, and its waits.
 * K: device memory cuda emu */
#include "model/field_eval.h"
#include "render/raster.h"
#include "tests/device/raster.h"
#include "tests/device/strict.h"

enum { N = 40, W = 24, H = 16, PIXELS = W * H, FRAMES = 2, LEVELS = 3, MOST = 200 };

/* The results of an iteration. */
struct outcome {
    float image[FRAMES][3 * PIXELS], means[FRAMES * N * 3];
    double loss[FRAMES][SPIN_LOSS_VALUES], measured[FRAMES][SPIN_MEASURE_VALUES];
};

/* Device memory of the iteration. n is the number of splats, at most N. */
struct step {
    struct spin_device *d;
    size_t n;
    struct spin_field field;
    struct spin_field_eval eval;
    struct spin_raster raster;
    struct spin_images images;
    void SPIN_DEV *block[16];
    int n_blocks;
    struct spin_param_group table, heads, means, exposure;
    double SPIN_DEV *loss;
    double SPIN_DEV *measured;
    struct spin_lazy_adam *lazy;
};

static spin_status keep(struct step *s, const void *host, size_t bytes, void SPIN_DEV **out)
{
    SPIN_TRY(s->d->op->reserve(s->d, bytes, out));
    s->block[s->n_blocks++] = *out;
    if (host)
        s->d->op->upload(s->d, *out, host, bytes);
    return SPIN_OK;
}

static spin_status take_group(struct step *s, const float *host, size_t n,
                              struct spin_param_group *out)
{
    void SPIN_DEV *all = NULL;

    SPIN_TRY(keep(s, NULL, 4 * n * sizeof(float), &all));
    s->d->op->upload(s->d, all, host, n * sizeof(float));
    out->p = all;
    out->g = out->p + n;
    out->m = out->g + n;
    out->v = out->m + n;
    out->n = n;
    out->lr = 1e-3;
    out->step = 1;
    return SPIN_OK;
}

static const float *random_floats(size_t n, float low, float high)
{
    static float values[1 << 16];
    uint64_t state = n;

    for (size_t i = 0; i < n && i < sizeof values / sizeof *values; i++)
        values[i] = random_between(&state, low, high);
    return values;
}

static spin_status open_step(struct step *s, struct spin_device *d, size_t n)
{
    static const int base[4] = {4, 4, 4, 2}, finest[4] = {32, 32, 32, 4};
    static uint8_t photos[FRAMES * 3 * PIXELS], mask[FRAMES][(PIXELS + 7) / 8];
    struct spin_camera camera = camera_of(W, H, 40);
    struct spin_camera_f32 cam = spin_camera_f32_from(&camera);
    void SPIN_DEV *at = NULL;

    memset(s, 0, sizeof *s);
    s->d = d;
    s->n = n;
    s->images.max_pixels = PIXELS;
    s->images.mask_weight[0] = s->images.mask_weight[1] = 1;
    for (size_t i = 0; i < sizeof photos; i++)
        photos[i] = (uint8_t)(7 * i);
    memset(mask, 0x5a, sizeof mask);
    SPIN_TRY(spin_field_plan(&s->field, LEVELS, 4, 8, 8, 3, base, finest));
    SPIN_TRY(spin_field_eval_open(&s->eval, d, &s->field, false, FRAMES * n, true));
    SPIN_TRY(spin_raster_open(&s->raster, d, n, PIXELS, (size_t)cam.tiles_x * (size_t)cam.tiles_y,
                              FRAMES, true));
    SPIN_TRY(take_group(s, random_floats(s->field.n_table, -1, 1), s->field.n_table, &s->table));
    SPIN_TRY(
        take_group(s, random_floats(s->field.n_heads, -0.5f, 0.5f), s->field.n_heads, &s->heads));
    SPIN_TRY(take_group(s, random_floats(FRAMES * n * 3, -1, 1), FRAMES * n * 3, &s->means));
    SPIN_TRY(
        take_group(s, random_floats(2 * SPIN_EXPOSURE, 0, 0), 2 * SPIN_EXPOSURE, &s->exposure));
    SPIN_TRY(keep(s, photos, sizeof photos, &at));
    s->images.rgb8 = at;
    SPIN_TRY(keep(s, mask, sizeof mask, &at));
    s->images.mask = at;
    SPIN_TRY(keep(s, NULL, FRAMES * SPIN_LOSS_VALUES * sizeof(double), &at));
    s->loss = at;
    SPIN_TRY(keep(s, NULL, FRAMES * SPIN_MEASURE_VALUES * sizeof(double), &at));
    s->measured = at;
    return d->op->lazy_adam_enable
               ? d->op->lazy_adam_enable(d, &s->field.grid, &s->table, 1, &s->lazy)
               : SPIN_OK;
}

static void close_step(struct step *s)
{
    if (s->lazy)
        s->d->op->lazy_adam_close(s->d, s->lazy);
    for (int i = 0; i < s->n_blocks; i++)
        s->d->op->release(s->d, s->block[i]);
    spin_raster_close(&s->raster);
    spin_field_eval_close(&s->eval, &s->field);
}

/* Runs the verbs of an iteration; the caller does the final wait. */
static spin_status go(struct step *s)
{
    struct spin_device *d = s->d;
    struct spin_frame_batch frames = {.n_frames = FRAMES, .n = FRAMES * s->n};
    struct spin_camera camera = camera_of(W, H, 40);
    static const float background[3] = {0.1f, 0.2f, 0.3f};
    struct spin_view_batch views = spin_raster_batch(&s->raster, background);
    struct spin_param_group group[] = {s->heads, s->means, s->exposure};
    struct spin_raster *r = &s->raster;

    camera.w2c[11] += 3;
    s->eval.lazy = s->lazy;
    for (size_t f = 0; f < FRAMES; f++) {
        struct spin_view_of_batch *view;

        frames.frame[f] = (struct spin_frame_of_batch){.first = f * s->n,
                                                       .n = s->n,
                                                       .t = (float)f,
                                                       .means = s->means.p + f * s->n * 3,
                                                       .d_means = s->means.g + f * s->n * 3};
        view = spin_raster_add_view(r, &views, (int)f, s->n, &camera, false);
        view->weight = 1;
        view->image = (uint32_t)f;
        view->value = (int)f;
        view->lens = 1;
    }
    spin_field_forward(&s->eval, &s->field, s->table.p, s->heads.p, &frames);
    d->op->zero(d, s->eval.d_attr, frames.n * SPIN_ATTR * sizeof(float));
    SPIN_TRY(spin_raster_forward(r, &views, &frames, s->eval.attr, 3));
    d->op->exposure(d, &views, s->exposure.p, r->image, r->image);
    d->op->loss(d, &views, &s->images, 0.2f, r->image, s->loss, r->d_image);
    d->op->exposure_back(d, &views, s->exposure.p, r->image, r->d_image, s->exposure.g);
    spin_raster_backward(r, &views, &frames, s->eval.attr, 3, s->eval.d_attr);
    spin_field_backward(&s->eval, &s->field, s->table.p, s->heads.p, &frames, s->table.g,
                        s->heads.g);
    d->op->adam(d, 3, group);
    if (s->lazy)
        d->op->lazy_adam_step(d, s->lazy, 1e-3);
    else
        d->op->adam(d, 1, &s->table);
    d->op->measure(d, &views, &s->images, r->image, s->measured);
    return SPIN_OK;
}

static spin_status finish(struct step *s, struct outcome *out)
{
    struct spin_device *d = s->d;

    SPIN_TRY(go(s));
    SPIN_TRY(d->op->wait(d));
    SPIN_TRY(d->op->download(d, out->image, s->raster.image, sizeof out->image));
    SPIN_TRY(d->op->download(d, out->means, s->means.p, s->means.n * sizeof(float)));
    SPIN_TRY(d->op->download(d, out->loss, s->loss, sizeof out->loss));
    return d->op->download(d, out->measured, s->measured, sizeof out->measured);
}

static spin_status step(struct spin_device *d, struct outcome *out)
{
    struct step s;
    spin_status status = open_step(&s, d, N);

    memset(out, 0, sizeof *out);
    if (status == SPIN_OK)
        status = finish(&s, out);
    close_step(&s);
    return status;
}

/* Runs an iteration on a new device on which allocations n to n + missing - 1 fail. Returns true if
 * none of them was reached. */
static bool without(int n, int missing, const struct outcome *whole, int *bad)
{
    static struct outcome out;
    struct spin_device *d;
    char number[16], count[16];
    spin_status status, again;
    bool reported;

    snprintf(number, sizeof number, "%d", n);
    snprintf(count, sizeof count, "%d", missing);
    setenv("SPIN_EMU_FULL", number, 1);
    setenv("SPIN_EMU_FULL_FOR", count, 1);
    d = check_device(1);
    d->deterministic = true;
    status = step(d, &out);
    unsetenv("SPIN_EMU_FULL");
    reported = strstr(spin_last_error(), "out of memory") != NULL;
    if (status == SPIN_OK && memcmp(&out, whole, sizeof out) != 0) {
        printf("# piece %d of memory: another result\n", n);
        ++*bad;
    }
    if (status != SPIN_OK && (status != SPIN_E_MEMORY || !reported)) {
        printf("# piece %d of memory: %s\n", n, spin_last_error());
        ++*bad;
    }
    again = step(d, &out);
    if (again != SPIN_OK || memcmp(&out, whole, sizeof out) != 0) {
        printf("# piece %d of memory: afterwards the device does not work as before: %s\n", n,
               again == SPIN_OK ? "another result" : spin_last_error());
        ++*bad;
    }
    check_device_free(d);
    return status == SPIN_OK;
}

static void no_memory(void)
{
    static struct outcome whole;
    struct spin_device *d = check_device(1);
    int bad = 0, n = 0, saved = 0;

    d->deterministic = true;
    ok(step(d, &whole) == SPIN_OK && whole.measured[0][SPIN_MEASURE_SQUARES] > 0, "takes a step");
    check_device_free(d);
    if (!check_device_is_emulated())
        return;
    while (++n < MOST && !without(n, 2, &whole, &bad))
        ;
    ok(n > 30 && n < MOST && bad == 0,
       "each of %d pieces of memory missing once: a message, and then a step as before", n - 1);
    for (int k = n - 1; k > n - 14; k--)
        saved += without(k, 1, &whole, &bad);
    ok(saved > 3 && bad == 0,
       "where an operation does not get an eighth more, what it needs will do (%d times)", saved);
}

/* An iteration whose GPU is lost at the n-th operation reports it. Returns true if it finished
 * before. */
static bool lost_after(int n, const struct outcome *whole, int *bad)
{
    static struct outcome out;
    struct spin_device *d;
    char number[16];
    spin_status status;

    snprintf(number, sizeof number, "%d", n);
    setenv("SPIN_EMU_LOST", number, 1);
    memset(&out, 0xff, sizeof out);
    d = check_device(1);
    d->deterministic = true;
    status = step(d, &out);
    *bad += status == SPIN_OK ? memcmp(&out, whole, sizeof out) != 0
                              : !strstr(spin_last_error(), "the GPU is lost");
    check_device_free(d);
    unsetenv("SPIN_EMU_LOST");
    return status == SPIN_OK;
}

/* The last operations are copies to the host, whose failure only the following wait reports. */
static void lost_card(void)
{
    enum { STRIDE = 16 };
    static struct outcome whole;
    struct spin_device *d;
    int bad = 0, n = 1;

    if (!check_device_is_emulated())
        return;
    d = check_device(1);
    d->deterministic = true;
    ok(step(d, &whole) == SPIN_OK, "takes a step");
    check_device_free(d);
    while (n < 4 * MOST && !lost_after(n, &whole, &bad))
        n += STRIDE;
    for (int k = n - STRIDE + 1; k < n; k++)
        lost_after(k, &whole, &bad);
    ok(n > 4 * STRIDE && n < 4 * MOST && bad == 0,
       "a card that is lost at the first, the last or any other of %d pieces of work", n);
}

/* Launches and waits of `steps` iterations with n splats per frame. */
static void cost(int steps, size_t n, long *launches, long *waits)
{
    char path[200];
    struct spin_device *d = check_device(1);
    struct step s;
    FILE *file;

    snprintf(path, sizeof path, "%s/counts", check_folder());
    setenv("SPIN_EMU_COPIES", path, 1);
    ok(open_step(&s, d, n) == SPIN_OK, "opens");
    for (int i = 0; i < steps; i++)
        ok(go(&s) == SPIN_OK, "a step");
    ok(d->op->wait(d) == SPIN_OK, "waits");
    close_step(&s);
    check_device_free(d);
    unsetenv("SPIN_EMU_COPIES");
    file = fopen(path, "r");
    ok(file && fscanf(file, "ordinary %*s pinned %*s launches %ld waits %ld", launches, waits) == 2,
       "the emulation counts");
    if (file)
        fclose(file);
}

static void few_launches(void)
{
    long one, two, waits_one, waits_two, few, waits_few;

    if (!check_device_is_emulated())
        return;
    cost(2, N, &one, &waits_one);
    cost(3, N, &two, &waits_two);
    cost(2, N / 4, &few, &waits_few);
    ok(two - one <= 110, "a step is %ld launches", two - one);
    ok(one == few, "for any number of splats (%ld, %ld)", one, few);
    ok(waits_two - waits_one == 1, "and the host waits once (%ld)", waits_two - waits_one);
}

TAP_MAIN
{
    no_memory();
    lost_card();
    few_launches();
}
