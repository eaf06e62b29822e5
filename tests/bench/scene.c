/* The benchmark's scene: a trainer with one frame and one camera. The points lie on eight spheres a
 * thousandth thick, in Morton order; the network has 16 levels of 4 features, 16 to 2048 in space
 * and 8 to 128 in time, and random values that give every splat about the size at which 50 of them
 * contribute to a pixel. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "base/err.h"
#include "base/mem.h"
#include "base/number.h"
#include "geometry/neighbours.h"
#include "math/blend.h"
#include "math/mlp.h"
#include "math/rng.h"
#include "tests/bench/bench.h"

enum { WIDTH = 640, HEIGHT = 360 };

static void make_points(float *pos, size_t n)
{
    for (size_t i = 0; i < n; i++) {
        float g[3], r, size = 0.2f + 0.05f * (float)(i % 8);

        for (uint64_t k = 0; k < 3; k++)
            g[k] = spin_rng_normal(2, k, i);
        r = sqrtf(g[0] * g[0] + g[1] * g[1] + g[2] * g[2]) + 1e-6f;
        for (uint64_t k = 0; k < 3; k++)
            pos[i * 3 + k] = spin_rng_uniform(3, k, i % 8) - 0.5f + size * g[k] / r +
                             0.001f * spin_rng_normal(4, k, i);
    }
}

/* Move and scale points of any scene into the ball where the synthetic ones lie: medians to 0, the
 * 80th percentile of the distance to 0.8. */
static spin_status normalise(float *pos, size_t n)
{
    void *block = NULL;
    float *value, size;

    SPIN_TRY(spin_alloc(n, sizeof *value, &block));
    value = block;
    for (size_t k = 0; k < 3; k++) {
        for (size_t i = 0; i < n; i++)
            value[i] = pos[3 * i + k];
        qsort(value, n, sizeof *value, spin_by_float);
        size = value[n / 2];
        for (size_t i = 0; i < n; i++)
            pos[3 * i + k] -= size;
    }
    for (size_t i = 0; i < n; i++)
        value[i] = pos[3 * i] * pos[3 * i] + pos[3 * i + 1] * pos[3 * i + 1] +
                   pos[3 * i + 2] * pos[3 * i + 2];
    qsort(value, n, sizeof *value, spin_by_float);
    size = sqrtf(value[n * 4 / 5]) / 0.8f;
    for (size_t i = 0; i < 3 * n && size > 0; i++)
        pos[i] /= size;
    free(block);
    return SPIN_OK;
}

static spin_status load_points(const char *path, int frame, struct spin_splats *out)
{
    struct spin_scene *scene = NULL;
    spin_status status;

    SPIN_TRY(spin_scene_open(path, &scene));
    status = spin_scene_read(scene, frame, SPIN_FROM_SOURCE, SPIN_COL_MEANS, out);
    spin_scene_close(scene);
    return status == SPIN_OK ? normalise(out->means, out->n) : status;
}

static spin_status put_points(struct bench_scene *s, const float *points)
{
    struct spin_device *d = &s->device;
    void *block = NULL, *sorted = NULL;
    spin_status status;

    SPIN_TRY_OUT(spin_alloc(s->n, sizeof(uint32_t), &block));
    SPIN_TRY_OUT(spin_alloc(s->n, 3 * sizeof(float), &sorted));
    SPIN_TRY_OUT(spin_morton_order(s->n, points, block));
    for (size_t i = 0; i < s->n; i++)
        memcpy((float *)sorted + 3 * i, points + 3 * (size_t)((uint32_t *)block)[i],
               3 * sizeof(float));
    d->op->upload(d, s->trainer.frame[0].pos, sorted, s->n * 3 * sizeof(float));
out:
    free(block);
    free(sorted);
    return status;
}

/* The last bias of a head. */
static float *last_bias(const struct spin_heads *heads, float *param, int head)
{
    return param + heads->offset[head] +
           spin_head_layout(heads->n_in, heads->hidden, heads->n_out[head]).b3;
}

/* The factor was found by trying; it holds for 10k to 200k splats of the spheres. */
static spin_status put_network(struct bench_scene *s)
{
    struct spin_trainer *t = &s->trainer;
    struct spin_device *d = &s->device;
    void *block = NULL;
    float *table, *heads;

    SPIN_TRY(spin_alloc(t->table.n + t->heads.n, sizeof(float), &block));
    table = block;
    heads = table + t->table.n;
    spin_field_init(&t->field, 1, 1e-4, log(3.4 / sqrt((double)s->n)), table, heads);
    for (size_t i = 0; i < t->table.n; i++)
        table[i] *= 5e3f;
    last_bias(&t->field.heads, heads, SPIN_HEAD_OPACITY)[0] = -1.2f;
    d->op->upload(d, t->table.p, table, t->table.n * sizeof(float));
    d->op->upload(d, t->heads.p, heads, t->heads.n * sizeof(float));
    free(block);
    return SPIN_OK;
}

static void set_rates(struct spin_train_rates *r)
{
    r->table = 8e-3;
    r->head[SPIN_HEAD_SCALE] = 3e-4;
    r->head[SPIN_HEAD_ROTATION] = 3e-5;
    r->head[SPIN_HEAD_SH] = 1e-3;
    r->head[SPIN_HEAD_OPACITY] = 8e-4;
    r->position = 1e-5;
    r->end = 1e-7;
    r->warmup = 1000; /* small steps: the scene stays what it is */
    r->iterations = 2000;
}

static spin_status open_trainer(struct bench_scene *s, int log2_rows)
{
    static const int base[4] = {16, 16, 16, 8}, finest[4] = {2048, 2048, 2048, 128};
    struct spin_field field;
    struct spin_param_group table;
    const struct spin_frame_size frame = {s->n, s->n, s->n, 0};
    const struct spin_trainer_size size = {
        .n_frames = 1,
        .frame = &frame,
        .network = true,
        .max_items = 1,
        .max_pixels = WIDTH * HEIGHT,
        .max_tiles = (size_t)s->cam.tiles_x * (size_t)s->cam.tiles_y,
    };

    SPIN_TRY(spin_field_plan(&field, 16, 4, log2_rows, 64, 3, base, finest));
    field.time_last = 1;
    SPIN_TRY(spin_trainer_open(&s->trainer, &s->device, &field, &size));
    s->trainer.frame[0].time = 0.37;
    s->trainer.lambda_dssim = 0.2f;
    set_rates(&s->trainer.rates);
    table = spin_param_group(&s->trainer.table, 0, s->trainer.table.n, 0, 0);
    SPIN_TRY(s->device.op->lazy_adam_enable(&s->device, &field.grid, &table,
                                            s->trainer.rates.iterations, &s->lazy));
    return put_network(s);
}

spin_status bench_scene_open(const char *device, size_t n, int log2_rows, int n_threads,
                             const char *path, int frame, struct bench_scene *s)
{
    /* From 2.2 along -z, looking at the middle. */
    struct spin_camera camera = {.width = WIDTH,
                                 .height = HEIGHT,
                                 .fx = 440,
                                 .fy = 440,
                                 .cx = WIDTH / 2.0,
                                 .cy = HEIGHT / 2.0,
                                 .w2c = {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 2.2}};
    struct spin_splats splats = {0};
    void *block = NULL;
    spin_status status;

    memset(s, 0, sizeof *s);
    s->camera = camera;
    s->cam = spin_camera_f32_from(&camera);
    SPIN_TRY(spin_device_open(device, n_threads, &s->device));
    s->open = true;
    if (path) {
        SPIN_TRY_OUT(load_points(path, frame, &splats));
    } else {
        SPIN_TRY_OUT(spin_splats_reserve(&splats, n, SPIN_COL_MEANS, 0));
        make_points(splats.means, n);
    }
    s->n = splats.n;
    SPIN_TRY_OUT(open_trainer(s, log2_rows));
    SPIN_TRY_OUT(put_points(s, splats.means));
    SPIN_TRY_OUT(spin_alloc((size_t)WIDTH * HEIGHT, 3 * sizeof(float), &block));
    for (size_t i = 0; i < (size_t)WIDTH * HEIGHT * 3; i++)
        ((float *)block)[i] = spin_rng_uniform(5, 0, i);
    SPIN_TRY_OUT(
        spin_image_store_open(&s->photo, &s->device, 1, WIDTH * HEIGHT, SPIN_IMAGE_F32, false));
    spin_image_store_put(&s->photo, 0, WIDTH * HEIGHT, block, NULL);
out:
    spin_splats_free(&splats);
    free(block);
    if (status != SPIN_OK)
        bench_scene_close(s);
    return status;
}

void bench_scene_close(struct bench_scene *s)
{
    if (!s->open)
        return;
    if (s->lazy)
        s->device.op->lazy_adam_close(&s->device, s->lazy);
    spin_image_store_close(&s->photo);
    spin_trainer_close(&s->trainer);
    spin_device_close(&s->device);
    memset(s, 0, sizeof *s);
}

struct spin_frame_batch bench_frames(struct bench_scene *s)
{
    struct spin_train_frame *frame = &s->trainer.frame[0];
    struct spin_frame_batch frames = spin_one_frame(s->n, frame->pos, 0.37f, NULL);

    frames.frame[0].d_means = s->trainer.d_pos;
    return frames;
}

struct spin_view_batch bench_views(struct bench_scene *s)
{
    struct spin_view_batch views = spin_raster_batch(&s->trainer.raster, s->trainer.background);

    spin_raster_add_view(&s->trainer.raster, &views, 0, s->n, &s->camera, false)->weight = 1;
    return views;
}

void *bench_fetch(struct bench_scene *s, const void SPIN_DEV *from, size_t bytes)
{
    void *to = malloc(bytes + 1);

    if (!to || s->device.op->download(&s->device, to, from, bytes) != SPIN_OK)
        exit(1);
    return to;
}

double bench_scene_pairs(struct bench_scene *s)
{
    const struct spin_raster *r = &s->trainer.raster;
    size_t tiles = (size_t)s->cam.tiles_x * (size_t)s->cam.tiles_y;
    uint32_t *intersections =
        bench_fetch(s, r->tiles.intersections, r->tiles.n_intersections * sizeof *intersections);
    uint32_t *start = bench_fetch(s, r->tiles.start, (tiles + 1) * sizeof *start);
    struct spin_splat2d *splat2d = bench_fetch(s, r->splat2d, s->n * sizeof *splat2d);
    int32_t *last = bench_fetch(s, r->last_contributor, WIDTH * HEIGHT * sizeof *last);
    double pairs = 0;

    for (int py = 0; py < HEIGHT; py++)
        for (int px = 0; px < WIDTH; px++) {
            int tile = py / SPIN_TILE * s->cam.tiles_x + px / SPIN_TILE;
            const uint32_t *list = intersections + start[tile];

            for (int i = 0; i < last[py * WIDTH + px]; i++) {
                const struct spin_splat2d *p = splat2d + list[i];
                struct spin_blend_splat b =
                    spin_blend_prepare(p->u_px, p->v_px, p->conic, p->opacity, p->colour);
                float power = spin_blend_power(&b, p->u_px - (float)px, p->v_px - (float)py);

                pairs += spin_blend_counts(power, b.log2_opacity);
            }
        }
    free(intersections), free(start), free(splat2d), free(last);
    return pairs;
}
