/* The rasteriser at 640x360: projection, sort and lists, blending, loss, and back. Times are the
 * least of several runs, of processor time with one thread; a contributing pair is one (splat,
 * pixel) that passes 1/255 before the pixel stops. */
#include <time.h>

#include "base/log.h"
#include "math/blend.h"
#include "tests/device/raster.h"

enum { STAGES = 7, RUNS = 9 };
static const char *const stage_names[STAGES] = {"project",    "lists",        "blend", "loss",
                                                "blend back", "project back", "all"};

struct place {
    uint64_t key;
    int from;
};

static int by_key(const void *a, const void *b)
{
    uint64_t p = ((const struct place *)a)->key, q = ((const struct place *)b)->key;

    return p < q ? -1 : p > q;
}

/* Splats in Morton order, as the core keeps them. */
static void sort_morton(struct view *v)
{
    struct place *place = take((size_t)v->n, sizeof *place);
    float *pos = take((size_t)v->n * 3, sizeof *pos);

    memcpy(pos, v->pos_w, (size_t)v->n * 3 * sizeof *pos);
    for (int i = 0; i < v->n; i++) {
        place[i].from = i;
        for (int k = 0; k < 3; k++) {
            uint32_t cell = (uint32_t)((pos[3 * i + k] + 8) * 64);
            for (int bit = 0; bit < 10; bit++)
                place[i].key |= (uint64_t)(cell >> bit & 1) << (3 * bit + k);
        }
    }
    qsort(place, (size_t)v->n, sizeof *place, by_key);
    for (int i = 0; i < v->n; i++)
        memcpy(v->pos_w + 3 * i, pos + 3 * place[i].from, 3 * sizeof *pos);
    free(place);
    free(pos);
}

/* Seconds of processor time with one thread, which a shared machine disturbs less; else by the
 * clock. */
static double now_s(int n_threads)
{
    struct timespec t;

    if (n_threads != 1)
        return spin_now_s();
    clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

/* Pairs that contribute, as blending counts them. */
static double contributing(const struct view *v)
{
    double pairs = 0;

    for (int py = 0; py < v->cam.height; py++)
        for (int px = 0; px < v->cam.width; px++) {
            int tile = py / SPIN_TILE * v->cam.tiles_x + px / SPIN_TILE;
            const uint32_t *list = v->tiles.pairs + v->tiles.start[tile];
            int used = v->n_used[py * v->cam.width + px];
            for (int i = 0; i < used; i++) {
                const struct spin_splat2d *s = v->splat2d + list[i];
                struct spin_blend_splat b =
                    spin_blend_prepare(s->u_px, s->v_px, s->conic, s->opacity, s->colour);
                float power = spin_blend_power(&b, s->u_px - (float)px, s->v_px - (float)py);
                pairs += spin_blend_counts(power, b.log2_opacity);
            }
        }
    return pairs;
}

static void run(struct spin_device *d, struct view *v, const float *truth, int n_threads,
                double *least)
{
    double t[STAGES + 1], values[3];
    size_t n = (size_t)v->n;

    t[0] = now_s(n_threads);
    d->op->project(d, &v->cam, n, v->pos_w, v->attr, v->degree, v->splat2d);
    t[1] = now_s(n_threads);
    view_tiles(d, v);
    t[2] = now_s(n_threads);
    d->op->blend(d, &v->cam, v->splat2d, &v->tiles, v->background, v->image, v->final_t, v->n_used);
    t[3] = now_s(n_threads);
    d->op->loss(d, v->cam.width, v->cam.height, v->image, truth, 0.2f, 1, values, v->d_image);
    t[4] = now_s(n_threads);
    d->op->blend_back(d, &v->cam, n, v->splat2d, &v->tiles, v->background, v->final_t, v->n_used,
                      v->d_image, v->d_splat2d);
    t[5] = now_s(n_threads);
    d->op->project_back(d, &v->cam, n, v->pos_w, v->attr, v->degree, v->splat2d, v->d_splat2d,
                        v->d_attr, v->d_pos_w);
    t[6] = now_s(n_threads);
    for (int i = 0; i < 6; i++)
        least[i] = fmin(least[i], t[i + 1] - t[i]);
    least[6] = fmin(least[6], t[6] - t[0]);
}

static void bench(int n, float size_px, int n_threads)
{
    struct spin_camera camera = camera_of(640, 360, 560);
    struct spin_device *d = check_device(n_threads);
    struct view v;
    float *truth;
    double least[STAGES], pairs;
    uint64_t state = 1;

    view_random(&v, &camera, n, size_px, 3);
    sort_morton(&v);
    truth = take(3 * view_pixels(&v), sizeof *truth);
    for (size_t i = 0; i < 3 * view_pixels(&v); i++)
        truth[i] = random_f(&state);
    for (int i = 0; i < STAGES; i++)
        least[i] = 1e30;
    for (int i = 0; i < RUNS; i++)
        run(d, &v, truth, n_threads, least);
    pairs = contributing(&v);
    printf("%s: %d splats of %g px, %u tile pairs, %.1f contributing pairs a pixel\n",
           d->description, n, (double)size_px, v.tiles.n_pairs, pairs / (double)view_pixels(&v));
    for (int i = 0; i < STAGES; i++) {
        printf("  %-13s %8.2f ms", stage_names[i], 1e3 * least[i]);
        if (i == 2 || i == 4)
            printf("  %6.2f ns a contributing pair", 1e9 * least[i] / pairs);
        else if (i != 3 && i != 6)
            printf("  %6.1f ns a splat", 1e9 * least[i] / n);
        printf("\n");
    }
    free(truth);
    view_free(&v);
    check_device_free(d);
}

int main(void)
{
    static const int counts[3] = {10000, 50000, 200000};
    static const float sizes[3] = {7, 3.6f, 1.7f}; /* about 50 contributing pairs a pixel */

    for (int n_threads = 1; n_threads >= 0; n_threads--)
        for (int i = 0; i < 3; i++)
            bench(counts[i], sizes[i], n_threads);
    return 0;
}
