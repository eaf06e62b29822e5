/* The strict device detects the misuses it is made for. Views and frames in one batch give the same
 * results as one by one. Renderer and measurement run on the strict device.
 * K: strict device raster threads */
#include <signal.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

#include "model/field_eval.h"
#include "render/player.h"
#include "tests/device/raster.h"
#include "tests/device/strict.h"

enum { N = 40, W = 50, H = 37, PIXELS = W * H };

/* ---- Misuse ---------------------------------------------------------------------------------- */

static volatile float sink;

/* A host that dereferences a device pointer is killed. */
static void dies(void (*misuse)(float *at), float *at, const char *what)
{
    int status = 0;
    pid_t child;

    fflush(stdout);
    child = fork();
    if (child == 0) {
        const struct rlimit none = {0, 0};

        setrlimit(RLIMIT_CORE, &none);
        signal(SIGSEGV, SIG_DFL); /* a sanitizer may have installed a handler */
        misuse(at);
        _exit(0);
    }
    ok(child > 0 && waitpid(child, &status, 0) == child && WIFSIGNALED(status) &&
           WTERMSIG(status) == SIGSEGV,
       "%s", what);
}

static void reads(float *at) { sink = at[3]; }
static void writes(float *at) { memcpy(at, (const float[4]){1, 2, 3, 4}, 16); }

static void misuse(void)
{
    struct spin_device *d = strict_open(check_device(1), 1, 1);
    struct spin_frame_batch frames = frame_of(4);
    struct spin_scene_transform identity = {.inv_radius = 1};
    float host[16] = {0}, got[16];
    void SPIN_DEV *means = NULL, *x_u = NULL;
    int before = strict_complaints();

    ok(d->op->reserve(d, sizeof host, &means) == SPIN_OK &&
           d->op->reserve(d, sizeof host, &x_u) == SPIN_OK,
       "reserves");
    dies(reads, (float *)means, "the host cannot read device memory");
    dies(writes, (float *)means, "nor write it");
    host[0] = 0.5f;
    d->op->upload(d, means, host, sizeof host);
    host[0] = 100;
    frames.frame[0].means = means;
    d->op->contract(d, &identity, &frames, x_u);
    frames.frame[0].means = NULL;
    ok(strict_queued(d) == 2, "nothing has happened on return");
    dies(reads, (float *)x_u, "nor can a result be read that nobody asked for");
    ok(d->op->download(d, got, x_u, sizeof got) == SPIN_OK && strict_queued(d) == 0,
       "it happens for a download");
    on_contract(d, &identity, 1, (const float[3]){0.5f, 0, 0}, 0, host);
    ok(got[0] == host[0], "with the arguments as they were");
    ok(strict_complaints() == before, "so far no complaint");

    strict_expect(true);
    d->op->zero(d, (void SPIN_DEV *)host, sizeof host);
    ok(strict_complaints() == before + 1 && strstr(strict_last(), "zero"),
       "a host pointer in place of a device's is complained about");
    frames.frame[0].means = means;
    d->op->release(d, means);
    d->op->contract(d, &identity, &frames, x_u);
    ok(strict_complaints() == before + 2 && strstr(strict_last(), "contract"),
       "and memory that was released, inside of a struct too");
    strict_expect(false);
    d->op->release(d, x_u);
    strict_close(d);
}

/* ---- Batched and one by one ------------------------------------------------------------------ */

struct drawn {
    float image[3][3 * PIXELS], d_attr[2 * N * SPIN_ATTR], d_means[2 * N * 3];
};

/* Two frames of N splats, three views: of the second frame, the first, the second. */
static void draw(struct spin_device *d, const struct view *v, int at_once, struct drawn *out)
{
    static const int shows[3] = {1, 0, 1};
    static const float background[3] = {0.1f, 0.2f, 0.3f};
    struct loans l = {.d = d};
    struct spin_raster r;
    struct spin_frame_batch frames = {.n_frames = 2, .n = 2 * N};
    float SPIN_DEV *attr = lend(&l, v->attr, (size_t)2 * N * ATTR_BYTES);
    float SPIN_DEV *means = lend(&l, v->pos_w, (size_t)2 * N * 3 * sizeof(float));
    float SPIN_DEV *d_attr, *d_means;

    memset(out, 0, sizeof *out);
    d_attr = lend_both(&l, out->d_attr, sizeof out->d_attr);
    d_means = lend_both(&l, out->d_means, sizeof out->d_means);
    for (size_t f = 0; f < 2; f++)
        frames.frame[f] = (struct spin_frame_of_batch){
            .first = f * N, .n = N, .means = means + f * N * 3, .d_means = d_means + f * N * 3};
    ok(spin_raster_open(&r, d, N, PIXELS, (size_t)v->cam.tiles_x * (size_t)v->cam.tiles_y, at_once,
                        true) == SPIN_OK,
       "opens for %d views", at_once);
    for (int first = 0; first < 3; first += at_once) {
        struct spin_view_batch views = spin_raster_batch(&r, background);

        for (int k = first; k < 3 && k < first + at_once; k++) {
            struct spin_camera camera = camera_of(W, H - 5 * k, 40 + 3 * k);

            ok(spin_raster_add_view(&r, &views, shows[k], N, &camera, false) != NULL, "a view");
        }
        ok(spin_raster_forward(&r, &views, &frames, attr, 3) == SPIN_OK, "draws");
        for (int k = 0; k < views.n_views; k++) {
            d->op->upload(d, r.d_image + (size_t)k * 3 * PIXELS, v->d_image,
                          3 * PIXELS * sizeof(float));
            ok(d->op->download(d, out->image[first + k], r.image + (size_t)k * 3 * PIXELS,
                               sizeof out->image[0]) == SPIN_OK,
               "a picture");
            for (size_t i = (size_t)(3 * W * (H - 5 * (first + k))); i < 3 * PIXELS; i++)
                out->image[first + k][i] = 0; /* beyond a smaller image */
        }
        spin_raster_backward(&r, &views, &frames, attr, 3, d_attr);
    }
    spin_raster_close(&r);
    settle(&l);
}

static void together(void)
{
    static struct drawn one, some, all;
    struct spin_camera camera = camera_of(W, H, 40);
    struct spin_device *cpu = check_device(2), *strict = strict_open(check_device(3), 2, 3);
    struct view v;

    view_random(&v, &camera, 2 * N, 4, 3);
    draw(cpu, &v, 1, &one);
    draw(cpu, &v, 2, &some);
    draw(strict, &v, 3, &all);
    check_same_bits(&some, &one, sizeof one, "two views together: pictures and gradients");
    check_same_bits(&all, &one, sizeof one, "all views together, strictly");
    view_free(&v);
    check_device_free(cpu);
    strict_close(strict);
}

/* ---- The renderer ---------------------------------------------------------------------------- */

struct measured {
    double values[SPIN_MEASURE_VALUES];
    float image[3 * PIXELS];
};

static void measure(struct spin_device *d, const struct spin_splats *splats, struct measured *out)
{
    static const float background[3] = {1, 1, 1};
    static uint8_t photo[3 * PIXELS], mask[(PIXELS + 7) / 8] = {0x5a, 0xff, 3};
    struct spin_camera camera = camera_of(W, H, 40);
    struct spin_player r;

    for (int i = 0; i < 3 * PIXELS; i++)
        photo[i] = (uint8_t)(i * 7);
    spin_player_open_reader(&r, d, NULL, NULL);
    ok(spin_player_show_splats(&r, splats) == SPIN_OK &&
           spin_player_draw(&r, &camera, background, NULL) == SPIN_OK &&
           spin_player_measure(&r, photo, mask, out->values) == SPIN_OK &&
           spin_player_image(&r, out->image) == SPIN_OK,
       "shows, draws, measures");
    spin_player_close(&r);
}

static void renderer(void)
{
    static struct measured plain, late;
    struct spin_device *cpu = check_device(1), *strict = strict_open(check_device(1), 1, 1);
    struct spin_splats splats = {0};
    uint64_t state = 9;

    if (!ok(spin_splats_reserve(&splats, N, SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES, 0) == SPIN_OK,
            "splats"))
        return;
    for (size_t i = 0; i < N; i++) {
        for (size_t k = 0; k < 3; k++) {
            splats.means[3 * i + k] = random_between(&state, -1, 1) + (k == 2 ? 3.0f : 0.0f);
            splats.log_scales[3 * i + k] = -2;
            splats.sh[3 * i + k] = random_between(&state, -1, 1);
        }
        splats.quats[4 * i] = 1;
        splats.logit_opacities[i] = 1;
    }
    measure(cpu, &splats, &plain);
    measure(strict, &splats, &late);
    check_same_bits(&late, &plain, sizeof plain, "the renderer on a strict device");
    ok(plain.values[SPIN_MEASURE_SQUARES] > 0 && plain.values[SPIN_MEASURE_INSIDE] > 0,
       "which measures something");
    spin_splats_free(&splats);
    check_device_free(cpu);
    strict_close(strict);
}

/* The mean of all rows is subtracted from each. */
static void centre(void)
{
    struct spin_device *d = check_device(1);
    struct loans l = {.d = d};
    float rows[3 * SPIN_EXPOSURE];

    for (int i = 0; i < 3 * SPIN_EXPOSURE; i++)
        rows[i] = (float)(i / SPIN_EXPOSURE * (1 + i % SPIN_EXPOSURE));
    d->op->exposure_centre(d, 3, lend_both(&l, rows, sizeof rows));
    settle(&l);
    for (int i = 0; i < 3 * SPIN_EXPOSURE; i++)
        near(rows[i], (i / SPIN_EXPOSURE - 1) * (1 + i % SPIN_EXPOSURE), 1e-6, "centred");
    check_device_free(d);
}

TAP_MAIN
{
    misuse();
    together();
    renderer();
    centre();
}
