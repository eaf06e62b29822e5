/* Tile lists: golden depth order, lists compared with a simple sort, culled pairs are invisible,
 * the same bits for any number of threads, bad values.
 * K: golden tile raster threads */
#include "math/blend.h"
#include "math/tile.h"
#include "tests/device/raster.h"

static const struct view *sorting;

/* By depth, ties by index. */
static int before(const void *a, const void *b)
{
    uint32_t i = *(const uint32_t *)a, k = *(const uint32_t *)b;
    float p = sorting->splat2d[i].depth, q = sorting->splat2d[k].depth;

    return p < q ? -1 : p > q ? 1 : i < k ? -1 : i > k;
}

static uint32_t *plain_order(const struct view *v, size_t *n)
{
    uint32_t *order = allocate((size_t)v->n, sizeof *order);

    *n = 0;
    for (int i = 0; i < v->n; i++)
        if (v->splat2d[i].radius_px > 0)
            order[(*n)++] = (uint32_t)i;
    sorting = v;
    qsort(order, *n, sizeof *order, before);
    return order;
}

static int inside(const struct spin_splat2d *s, int x, int y)
{
    return s->radius_px > 0 && x >= s->x0 && x < s->x1 && y >= s->y0 && y < s->y1;
}

/* The largest exponent, including the opacity, over the pixels of a tile. */
static float strongest(const struct view *v, const struct spin_splat2d *s, int tile_x, int tile_y)
{
    struct spin_blend_splat b =
        spin_blend_prepare(s->u_px, s->v_px, s->conic, s->opacity, s->colour);
    float most = -1e30f;

    for (int y = 16 * tile_y; y < 16 * tile_y + 16 && y < v->cam.height; y++)
        for (int x = 16 * tile_x; x < 16 * tile_x + 16 && x < v->cam.width; x++)
            most = spin_maxf(most, spin_blend_power(&b, s->u_px - (float)x, s->v_px - (float)y));
    return most + b.log2_opacity;
}

/* Each list equals the simply sorted list of the rectangles, minus splats below 1/255 everywhere in
 * the tile. */
static void check_lists(const struct view *v)
{
    size_t n;
    uint32_t *order = plain_order(v, &n);
    int wrong = 0, seen = 0, left_out = 0, tiles = v->cam.tiles_x * v->cam.tiles_y;

    for (int tile = 0; tile < tiles; tile++) {
        int x = tile % v->cam.tiles_x, y = tile / v->cam.tiles_x;
        uint32_t at = v->tiles.start[tile], end = v->tiles.start[tile + 1];
        for (size_t k = 0; k < n; k++) {
            const struct spin_splat2d *s = v->splat2d + order[k];
            if (!inside(s, x, y))
                continue;
            if (at < end && v->tiles.intersections[at] == order[k]) {
                at++;
                continue;
            }
            left_out++;
            seen += strongest(v, s, x, y) >= SPIN_ALPHA_MIN_LOG2;
        }
        wrong += at != end;
    }
    ok(wrong == 0, "%s: every list is in depth order, ties by index", v->name);
    ok(seen == 0, "%s: none of the %d pairs left out reaches 1/255", v->name, left_out);
    ok(v->tiles.start[0] == 0 && v->tiles.start[tiles] == v->tiles.n_intersections,
       "%s: the lists hold all pairs", v->name);
    free(order);
}

/* The slots of consecutive splats are consecutive, one for each pair. */
static void check_slots(const struct view *v)
{
    uint32_t *count = allocate((size_t)v->n, sizeof *count), at = 0;
    int wrong = 0;

    for (uint32_t i = 0; i < v->tiles.n_intersections; i++)
        count[v->tiles.intersections[i]]++;
    for (int i = 0; i < v->n; i++) {
        wrong += v->splat2d[i].first_intersection != at;
        at += count[i];
    }
    ok(wrong == 0 && at == v->tiles.n_intersections,
       "%s: every splat has a slot for each of its pairs", v->name);
    free(count);
}

/* The same view twice in a batch: slots are counted from the start of each view. */
static void check_two_views(struct spin_device *d, const struct view *v)
{
    struct loans l = {.d = d};
    size_t n = (size_t)v->n;
    struct spin_view_batch views = view_of_camera(&v->cam, n);
    struct spin_splat2d *twice = allocate(2 * n, sizeof *twice);
    uint32_t *start = allocate(2 * (views.max_tiles + 1), sizeof *start);
    struct spin_tiles tiles = {0};
    spin_status status;
    int wrong = 0;

    views.n_views = 2;
    views.view[1] = views.view[0];
    views.view[1].first = n;
    memcpy(twice, v->splat2d, n * sizeof *twice);
    memcpy(twice + n, v->splat2d, n * sizeof *twice);
    tiles.start = lend_both(&l, start, 2 * (views.max_tiles + 1) * sizeof *start);
    status = d->op->tile_count(d, &views, lend_both(&l, twice, 2 * n * sizeof *twice), &tiles);
    settle(&l);
    for (size_t i = 0; i < 2 * n; i++)
        wrong += twice[i].first_intersection != v->splat2d[i % n].first_intersection;
    ok(status == SPIN_OK && wrong == 0, "%s: twice in a batch, its slots are the same", v->name);
    free(twice);
    free(start);
}

static void golden(struct spin_device *d, const char *name)
{
    struct view v;
    struct spin_npz npz;
    struct spin_array info;
    double *want;
    uint32_t *order;
    size_t n, wrong = 0;

    if (!view_load(&v, &npz, name))
        return;
    on_project(d, &v.cam, (size_t)v.n, v.pos_w, v.attr, v.degree, v.splat2d);
    view_tiles(d, &v);
    want = check_load(&npz, "order", &info);
    order = plain_order(&v, &n);
    for (size_t i = 0; i < n && n == info.count; i++)
        wrong += order[i] != (uint32_t)want[i];
    ok(n == info.count && wrong == 0, "%s: depth order", name);
    check_lists(&v);
    check_slots(&v);
    check_two_views(d, &v);
    free(want);
    free(order);
    view_free(&v);
    spin_npz_close(&npz);
}

static void rectangles(void)
{
    int x0, y0, x1, y1;

    spin_tile_rect(8, 40, 3, 4, 3, &x0, &y0, &x1, &y1);
    ok(x0 == 0 && x1 == 1 && y0 == 2 && y1 == 3, "a small ellipse touches one tile");
    spin_tile_rect(-100, -1e30f, 50, 4, 3, &x0, &y0, &x1, &y1);
    ok(x0 == 0 && x1 == 0 && y0 == 0 && y1 == 0, "outside the picture there is none");
    spin_tile_rect(0, 0, 1e30f, 4, 3, &x0, &y0, &x1, &y1);
    ok(x0 == 0 && x1 == 4 && y0 == 0 && y1 == 3, "a huge one touches all");
    spin_tile_rect(NAN, INFINITY, 1, 4, 3, &x0, &y0, &x1, &y1);
    ok(x0 == 0 && x1 == 0 && y0 == 3 && y1 == 3, "no numbers give an empty rectangle");
}

static void many(struct spin_device *d, int n, float size_px)
{
    struct spin_camera camera = camera_of(300, 200, 250);
    struct view v;

    view_random(&v, &camera, n, size_px, 17);
    snprintf(v.name, sizeof v.name, "%d of %g px", n, (double)size_px);
    for (int i = 2; i < n; i += 3)
        v.pos_w[3 * i + 2] = v.pos_w[3 * (i - 1) + 2]; /* ties */
    on_project(d, &v.cam, (size_t)v.n, v.pos_w, v.attr, 3, v.splat2d);
    view_tiles(d, &v);
    check_lists(&v);
    check_slots(&v);
    view_free(&v);
}

static void none(struct spin_device *d)
{
    struct spin_camera camera = camera_of(40, 40, 30);
    struct view v;

    view_random(&v, &camera, 3, 2, 1);
    for (int i = 0; i < 3; i++)
        v.pos_w[3 * i + 2] = -1;
    view_forward(d, &v);
    ok(v.tiles.n_intersections == 0 && v.tiles.start[9] == 0, "all behind the camera: no pairs");
    near(v.image[5], v.background[0], 0, "and the picture is the background");
    v.n = 0;
    view_forward(d, &v);
    ok(v.tiles.n_intersections == 0, "no splats: no pairs");
    view_free(&v);
}

static void same_bits(const char *path)
{
    struct spin_camera camera = camera_of(300, 200, 250);
    struct view one, more;

    for (int n = 1; n <= 8; n = n < 3 ? n + 1 : n + 5) {
        struct view *v = n == 1 ? &one : &more;
        struct spin_device *d = device_of_path(path, n);
        view_random(v, &camera, 5000, 4, 33);
        on_project(d, &v->cam, (size_t)v->n, v->pos_w, v->attr, 3, v->splat2d);
        view_tiles(d, v);
        check_device_free(d);
        if (n == 1)
            continue;
        ok(one.tiles.n_intersections == more.tiles.n_intersections, "%s, %d threads: as many pairs",
           path, n);
        check_same_bits(more.tiles.intersections, one.tiles.intersections,
                        one.tiles.n_intersections * sizeof(uint32_t), "the same lists");
        view_free(&more);
    }
    view_free(&one);
}

/* n splats that cover all 4096 x 4096 tiles of an image, 2^24 pairs each: counted, never listed. */
static void too_many(struct spin_device *d)
{
    struct spin_camera camera = camera_of(16, 16, 20);
    struct spin_splat2d *s = allocate(17, sizeof *s);
    struct spin_splat2d SPIN_DEV *splats;
    struct spin_tiles tiles = {0};
    struct loans l = {.d = d};
    uint32_t found = 1;

    camera.width = camera.height = 65536;
    for (int i = 0; i < 17; i++)
        s[i] = (struct spin_splat2d){.u_px = 32768,
                                     .v_px = 32768,
                                     .conic = {1e-12f, 0, 1e-12f},
                                     .opacity = 0.9f,
                                     .depth = 1,
                                     .radius_px = 1 << 20,
                                     .x1 = 4096,
                                     .y1 = 4096};
    splats = lend(&l, s, 17 * sizeof *s);
    for (size_t n = 16; n <= 17; n++) {
        struct spin_camera_f32 cam = spin_camera_f32_from(&camera);
        struct spin_view_batch views = view_of_camera(&cam, n);
        spin_status status = d->op->tile_count(d, &views, splats, &tiles);

        ok(n == 16 ? status == SPIN_OK && tiles.n_intersections == SPIN_MAX_PAIRS
                   : status == SPIN_E_MEMORY && strstr(spin_last_error(), "285212672 pairs"),
           "%zu times 2^24 pairs: %s", n, n == 16 ? "as many as there may be" : "an error");
    }
    camera.width = camera.height = 16;
    for (int turn = 0; turn < 2; turn++) {
        struct spin_camera_f32 cam = spin_camera_f32_from(&camera);
        size_t n = (size_t)1 << 56;
        struct spin_view_batch views = view_of_camera(&cam, n);
        struct spin_frame_batch frames = frame_of(n);
        struct spin_active active = {.most = n};

        active.row = lend(&l, &found, sizeof found);
        active.n = lend_both(&l, &found, sizeof found);
        ok(d->op->tile_count(d, &views, splats, &tiles) == SPIN_E_MEMORY,
           "no memory for the lists: an error");
        ok(d->op->wait(d) == SPIN_OK, "which has been told");
        d->op->nonzero_grad(d, &frames, lend(&l, s, sizeof *s), &active);
        ok(d->op->wait(d) == SPIN_E_MEMORY && strstr(spin_last_error(), "bytes"),
           "and wait() tells it");
        ok(d->op->wait(d) == SPIN_OK, "once");
        settle(&l);
        ok(found == 0, "no memory for the rows: none");
        splats = lend(&l, s, 17 * sizeof *s);
        found = 1;
    }
    settle(&l);
    free(s);
}

TAP_MAIN
{
    const char **names = check_files("render_");

    rectangles();
    for (int i = 0; i < CPU_PATHS; i++) {
        struct spin_device *d = device_of_path(cpu_paths[i], 2);
        if (!d)
            continue;
        printf("# code path %s\n", cpu_paths[i]);
        for (size_t k = 0; names[k]; k++)
            golden(d, names[k]);
        many(d, 3000, 3);
        many(d, 500, 40);
        none(d);
        too_many(d);
        check_device_free(d);
        same_bits(cpu_paths[i]);
    }
    free(names);
}
