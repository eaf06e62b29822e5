/* Verbs of a device for host arrays: each function reserves device memory, uploads, runs the verb
 * and downloads what it wrote, so that the tests run on any device. */
#ifndef SPIN_TESTS_DEVICE_VERBS_H
#define SPIN_TESTS_DEVICE_VERBS_H

#include "tests/check.h"
#include "tests/tap.h"

#define VERB __attribute__((unused)) static

/* ---- Arrays that are on the device during one verb ---- */

struct loan {
    void SPIN_DEV *at;
    void *host; /* downloaded to here, or NULL */
    size_t bytes;
};
struct loans {
    struct spin_device *d;
    struct loan loan[16];
    int n;
};

static void SPIN_DEV *lend_to(struct loans *l, const void *from, void *to, size_t bytes)
{
    struct loan *loan = &l->loan[l->n++];

    loan->bytes = bytes;
    loan->host = to;
    if (l->d->op->reserve(l->d, bytes + 64, &loan->at) != SPIN_OK) {
        printf("Bail out! out of device memory\n");
        exit(1);
    }
    if (from)
        l->d->op->upload(l->d, loan->at, from, bytes);
    return loan->at;
}

/* NULL stays NULL. */
static void SPIN_DEV *lend(struct loans *l, const void *host, size_t bytes)
{
    return host ? lend_to(l, host, NULL, bytes) : NULL;
}

/* With unused capacity behind the data, filled with NaN. */
static void SPIN_DEV *lend_and_more(struct loans *l, const void *host, size_t bytes, size_t more)
{
    char *all = malloc(bytes + more);
    void SPIN_DEV *at;

    memcpy(all, host, bytes);
    memset(all + bytes, 0xff, more);
    at = lend_to(l, all, NULL, bytes + more);
    free(all);
    return at;
}

/* An array that the verb writes or adds to. */
static void SPIN_DEV *lend_both(struct loans *l, void *host, size_t bytes)
{
    return host ? lend_to(l, host, host, bytes) : NULL;
}

static void settle(struct loans *l)
{
    for (int i = 0; i < l->n; i++) {
        struct loan *loan = &l->loan[i];

        if (loan->host && l->d->op->download(l->d, loan->host, loan->at, loan->bytes) != SPIN_OK)
            ok(0, "the device failed: %s", spin_last_error());
    }
    for (int i = 0; i < l->n; i++)
        l->d->op->release(l->d, l->loan[i].at);
    l->n = 0;
}

static const size_t float_row[] = {0, 4, 8, 12, 16}; /* bytes of so many floats */
enum { ATTR_BYTES = SPIN_ATTR * 4 };

/* ---- Lists of rows ---- */

/* Number of array rows that the list can refer to. */
static size_t rows_reach(const uint32_t *rows, size_t n)
{
    return rows && n > 0 ? (size_t)rows[n - 1] + 1 : n;
}

/* rows NULL: the first n. */
static struct spin_active lend_active(struct loans *l, const uint32_t *rows, size_t n)
{
    struct spin_active active = {.most = n};
    uint32_t count = (uint32_t)n, *all = calloc(n + 1, sizeof *all);

    for (size_t i = 0; i < n; i++)
        all[i] = rows ? rows[i] : (uint32_t)i;
    active.row = lend(l, all, n * sizeof *all);
    active.n = lend(l, &count, sizeof count);
    free(all);
    return active;
}

static struct spin_frame_batch frame_of(size_t n)
{
    struct spin_frame_batch frames = {.n_frames = 1, .n = n};

    frames.frame[0].n = n;
    return frames;
}

static struct spin_view_batch view_of_camera(const struct spin_camera_f32 *cam, size_t n)
{
    struct spin_view_batch views = {.n_views = 1,
                                    .max_pixels = (size_t)cam->width * (size_t)cam->height,
                                    .max_tiles = (size_t)cam->tiles_x * (size_t)cam->tiles_y};

    views.view[0].camera = *cam;
    views.view[0].n = n;
    return views;
}

/* ---- Field ---- */

VERB void on_contract(struct spin_device *d, const struct spin_scene_transform *transform, size_t n,
                      const float *pos, float t, float *x_u)
{
    struct loans l = {.d = d};
    struct spin_frame_batch frames = frame_of(n);

    frames.frame[0].t = t;
    frames.frame[0].means = lend(&l, pos, n * float_row[3]);
    d->op->contract(d, transform, &frames, lend_both(&l, x_u, n * float_row[4]));
    settle(&l);
}

VERB void on_contract_back(struct spin_device *d, const struct spin_scene_transform *transform,
                           size_t n_rows, const uint32_t *rows, const float *pos,
                           const float *d_x_u, float *d_pos)
{
    struct loans l = {.d = d};
    size_t n = rows_reach(rows, n_rows);
    struct spin_active active = lend_active(&l, rows, n_rows);
    struct spin_frame_batch frames = frame_of(n);

    frames.frame[0].means = lend(&l, pos, n * float_row[3]);
    frames.frame[0].d_means = lend_both(&l, d_pos, n * float_row[3]);
    d->op->contract_back(d, transform, &frames, &active, lend(&l, d_x_u, n_rows * float_row[4]));
    settle(&l);
}

static size_t table_bytes(const struct spin_grid *grid)
{
    return (size_t)grid->offset[grid->n_levels] * (size_t)grid->n_features * sizeof(float);
}

static size_t z_bytes(const struct spin_grid *grid)
{
    return (size_t)grid->n_levels * (size_t)grid->n_features * sizeof(float);
}

VERB void on_grid(struct spin_device *d, const struct spin_grid *grid, const float *table, size_t n,
                  const float *x_u, float *z)
{
    struct loans l = {.d = d};

    d->op->grid(d, grid, lend(&l, table, table_bytes(grid)), n, lend(&l, x_u, n * float_row[4]),
                lend_both(&l, z, n * z_bytes(grid)));
    settle(&l);
}

VERB void on_grid_back(struct spin_device *d, const struct spin_grid *grid, const float *table,
                       size_t n_rows, const uint32_t *rows, const float *x_u, const float *d_z,
                       float *d_table, float *d_x_u)
{
    struct loans l = {.d = d};
    struct spin_active active = lend_active(&l, rows, n_rows);

    d->op->grid_back(d, grid, lend(&l, table, table_bytes(grid)), &active,
                     lend(&l, x_u, rows_reach(rows, n_rows) * float_row[4]),
                     lend(&l, d_z, n_rows * z_bytes(grid)),
                     lend_both(&l, d_table, table_bytes(grid)),
                     lend_both(&l, d_x_u, n_rows * float_row[4]));
    settle(&l);
}

VERB void on_mlp(struct spin_device *d, const struct spin_heads *heads, const float *param,
                 size_t n, const float *z, float *raw)
{
    struct loans l = {.d = d};

    d->op->mlp(d, heads, lend(&l, param, heads->offset[SPIN_HEADS] * sizeof(float)), n,
               lend(&l, z, n * (size_t)heads->n_in * sizeof(float)),
               lend_both(&l, raw, n * ATTR_BYTES));
    settle(&l);
}

VERB void on_mlp_back(struct spin_device *d, const struct spin_heads *heads, const float *param,
                      size_t n_rows, const uint32_t *rows, const float *z, const float *d_raw,
                      float *d_param, float *d_z)
{
    enum { MORE = 3 }; /* unused capacity of the list */
    struct loans l = {.d = d};
    struct spin_active active = lend_active(&l, rows, n_rows);
    size_t params = heads->offset[SPIN_HEADS] * sizeof(float);
    size_t row = (size_t)heads->n_in * sizeof(float);

    active.most += MORE;
    d->op->mlp_back(d, heads, lend(&l, param, params), &active,
                    lend(&l, z, rows_reach(rows, n_rows) * row),
                    lend_and_more(&l, d_raw, n_rows * ATTR_BYTES, MORE * ATTR_BYTES),
                    lend_both(&l, d_param, params), lend_both(&l, d_z, n_rows * row));
    settle(&l);
}

VERB void on_residual(struct spin_device *d, size_t n, const float *residual, size_t sh_width,
                      const float *sh, float *raw)
{
    struct loans l = {.d = d};
    struct spin_frame_batch frames = frame_of(n);

    frames.frame[0].residual = lend(&l, residual, n * SPIN_RESIDUAL * sizeof(float));
    frames.frame[0].sh = lend(&l, sh, n * sh_width * sizeof(float));
    frames.frame[0].sh_width = sh_width;
    d->op->residual(d, &frames, lend_both(&l, raw, n * ATTR_BYTES));
    settle(&l);
}

VERB void on_residual_set(struct spin_device *d, size_t n, const float *residual, size_t sh_width,
                          const float *sh, float *raw)
{
    struct loans l = {.d = d};
    struct spin_frame_batch frames = frame_of(n);

    frames.frame[0].residual = lend(&l, residual, n * SPIN_RESIDUAL * sizeof(float));
    frames.frame[0].sh = lend(&l, sh, n * sh_width * sizeof(float));
    frames.frame[0].sh_width = sh_width;
    d->op->residual_set(d, &frames, lend_both(&l, raw, n * ATTR_BYTES));
    settle(&l);
}

VERB void on_residual_back(struct spin_device *d, size_t n, size_t n_rows, const uint32_t *rows,
                           const float *d_raw, float *d_residual, size_t sh_width, float *d_sh)
{
    struct loans l = {.d = d};
    struct spin_active active = lend_active(&l, rows, n_rows);
    struct spin_frame_batch frames = frame_of(n);

    frames.frame[0].d_residual = lend_both(&l, d_residual, n * SPIN_RESIDUAL * sizeof(float));
    frames.frame[0].d_sh = lend_both(&l, d_sh, n * sh_width * sizeof(float));
    frames.frame[0].sh_width = sh_width;
    d->op->residual_back(d, &frames, &active, lend(&l, d_raw, n_rows * ATTR_BYTES));
    settle(&l);
}

VERB void on_activate(struct spin_device *d, size_t n, const float *raw, float *attr)
{
    struct spin_frame_batch frames = {.n = n};
    struct loans l = {.d = d};

    d->op->activate(d, &frames, lend(&l, raw, n * ATTR_BYTES), lend_both(&l, attr, n * ATTR_BYTES));
    settle(&l);
}

VERB void on_activate_back(struct spin_device *d, size_t n_rows, const uint32_t *rows,
                           const float *raw, const float *d_attr, float *d_raw)
{
    struct loans l = {.d = d};
    struct spin_active active = lend_active(&l, rows, n_rows);
    struct spin_frame_batch frames = {0};
    size_t n = rows_reach(rows, n_rows);

    d->op->activate_back(d, &frames, &active, lend(&l, raw, n * ATTR_BYTES),
                         lend(&l, d_attr, n * ATTR_BYTES),
                         lend_both(&l, d_raw, n_rows * ATTR_BYTES));
    settle(&l);
}

/* Returns the number of rows. */
VERB size_t on_nonzero_grad(struct spin_device *d, size_t n, const float *d_attr,
                            const float *d_pos, uint32_t *rows)
{
    struct loans l = {.d = d};
    uint32_t count = 0;
    struct spin_active active = {.most = n};
    struct spin_frame_batch frames = frame_of(n);

    active.row = lend_both(&l, rows, n * sizeof *rows);
    active.n = lend_both(&l, &count, sizeof count);
    if (d_pos)
        frames.frame[0].d_means = lend(&l, d_pos, n * float_row[3]);
    d->op->nonzero_grad(d, &frames, lend(&l, d_attr, n * ATTR_BYTES), &active);
    settle(&l);
    return count;
}

VERB void on_adam(struct spin_device *d, size_t n, float *p, float *g, float *m, float *v,
                  double lr, int64_t step)
{
    struct loans l = {.d = d};
    struct spin_param_group group = {.n = n, .lr = lr, .step = step};

    group.p = lend_both(&l, p, n * sizeof *p);
    group.g = lend_both(&l, g, n * sizeof *g);
    group.m = lend_both(&l, m, n * sizeof *m);
    group.v = lend_both(&l, v, n * sizeof *v);
    d->op->adam(d, 1, &group);
    settle(&l);
}

/* ---- Rasteriser ---- */

VERB void on_project(struct spin_device *d, const struct spin_camera_f32 *cam, size_t n,
                     const float *pos, const float *attr, int degree, struct spin_splat2d *splat2d)
{
    struct loans l = {.d = d};
    struct spin_frame_batch frames = frame_of(n);
    struct spin_view_batch views = view_of_camera(cam, n);

    frames.frame[0].means = lend(&l, pos, n * float_row[3]);
    d->op->project(d, &views, &frames, lend(&l, attr, n * ATTR_BYTES), degree,
                   lend_both(&l, splat2d, n * sizeof *splat2d));
    settle(&l);
}

VERB void on_project_back(struct spin_device *d, const struct spin_camera_f32 *cam, size_t n,
                          const float *pos, const float *attr, int degree,
                          const struct spin_splat2d *splat2d,
                          const struct spin_splat2d_grad *d_splat2d, float *d_attr, float *d_pos)
{
    struct loans l = {.d = d};
    struct spin_frame_batch frames = frame_of(n);
    struct spin_view_batch views = view_of_camera(cam, n);

    frames.frame[0].means = lend(&l, pos, n * float_row[3]);
    frames.frame[0].d_means = lend_both(&l, d_pos, n * float_row[3]);
    d->op->project_back(d, &views, &frames, lend(&l, attr, n * ATTR_BYTES), degree,
                        lend(&l, splat2d, n * sizeof *splat2d),
                        lend(&l, d_splat2d, n * sizeof *d_splat2d),
                        lend_both(&l, d_attr, n * ATTR_BYTES));
    settle(&l);
}

/* Whether on_blend_back() and on_densify_stats() use absolute gradients. */
__attribute__((unused)) static bool with_absolute;

VERB void on_densify_stats(struct spin_device *d, const struct spin_camera_f32 *cam, size_t n,
                           const struct spin_splat2d *splat2d,
                           const struct spin_splat2d_grad *d_splat2d, float *sum, uint32_t *seen)
{
    struct loans l = {.d = d};
    struct spin_frame_batch frames = frame_of(n);
    struct spin_view_batch views = view_of_camera(cam, n);

    views.absolute = with_absolute;
    frames.frame[0].gradient = lend_both(&l, sum, n * sizeof *sum);
    frames.frame[0].seen = lend_both(&l, seen, n * sizeof *seen);
    d->op->densify_stats(d, &views, &frames, lend(&l, splat2d, n * sizeof *splat2d),
                         lend(&l, d_splat2d, n * sizeof *d_splat2d));
    settle(&l);
}

/* The tile lists of a view, on the host. */
struct host_tiles {
    size_t n_intersections;
    uint32_t *intersections; /* allocated by on_tiles() */
    uint32_t *start;         /* [tiles + 1] */
};

VERB void on_tiles(struct spin_device *d, const struct spin_camera_f32 *cam, size_t n,
                   struct spin_splat2d *splat2d, struct host_tiles *out)
{
    struct loans l = {.d = d};
    struct spin_view_batch views = view_of_camera(cam, n);
    struct spin_splat2d SPIN_DEV *splats = lend_both(&l, splat2d, n * sizeof *splat2d);
    struct spin_tiles tiles = {0};
    size_t bytes;

    tiles.start = lend_both(&l, out->start, (views.max_tiles + 1) * sizeof *out->start);
    if (!ok(d->op->tile_count(d, &views, splats, &tiles) == SPIN_OK, "counts the intersections"))
        return;
    out->n_intersections = (size_t)tiles.n_intersections;
    bytes = out->n_intersections * sizeof *out->intersections;
    free(out->intersections);
    out->intersections = calloc(bytes + 1, 1);
    tiles.intersections = lend_both(&l, out->intersections, bytes);
    if (d->op->tile_fill(d, &views, splats, &tiles) != SPIN_OK)
        ok(0, "fills the lists: %s", spin_last_error());
    settle(&l);
}

static struct spin_tiles lend_tiles(struct loans *l, const struct spin_view_batch *views,
                                    const struct host_tiles *from)
{
    struct spin_tiles tiles = {.n_intersections = from->n_intersections};

    tiles.intersections = lend(l, from->intersections, from->n_intersections * sizeof(uint32_t));
    tiles.start = lend(l, from->start, (views->max_tiles + 1) * sizeof(uint32_t));
    return tiles;
}

/* The matte of the view that on_blend(), on_blend_back() and on_loss() use; NULL: none. */
__attribute__((unused)) static struct {
    const uint8_t *matte;
    float change[3];
} with_matte;

VERB void lend_matte(struct loans *l, struct spin_view_batch *views)
{
    if (with_matte.matte)
        views->view[0].matte = lend(l, with_matte.matte, views->max_pixels);
    memcpy(views->view[0].background_change, with_matte.change, sizeof with_matte.change);
}

VERB void on_blend(struct spin_device *d, const struct spin_camera_f32 *cam, size_t n,
                   const struct spin_splat2d *splat2d, const struct host_tiles *from,
                   const float background[3], float *image, float *final_transmittance,
                   int32_t *last_contributor)
{
    struct loans l = {.d = d};
    struct spin_view_batch views = view_of_camera(cam, n);
    struct spin_tiles tiles = lend_tiles(&l, &views, from);

    memcpy(views.background, background, sizeof views.background);
    lend_matte(&l, &views);
    d->op->blend(d, &views, lend(&l, splat2d, n * sizeof *splat2d), &tiles,
                 lend_both(&l, image, views.max_pixels * float_row[3]),
                 lend_both(&l, final_transmittance, views.max_pixels * sizeof(float)),
                 lend_both(&l, last_contributor, views.max_pixels * sizeof(int32_t)));
    settle(&l);
}

VERB void on_depth(struct spin_device *d, const struct spin_camera_f32 *cam, size_t n,
                   const struct spin_splat2d *splat2d, const struct host_tiles *from, float *depth)
{
    struct loans l = {.d = d};
    struct spin_view_batch views = view_of_camera(cam, n);
    struct spin_tiles tiles = lend_tiles(&l, &views, from);

    d->op->depth(d, &views, lend(&l, splat2d, n * sizeof *splat2d), &tiles,
                 lend_both(&l, depth, 2 * views.max_pixels * sizeof(float)));
    settle(&l);
}

VERB void on_blend_back(struct spin_device *d, const struct spin_camera_f32 *cam, size_t n,
                        const struct spin_splat2d *splat2d, const struct host_tiles *from,
                        const float background[3], const float *final_transmittance,
                        const int32_t *last_contributor, const float *d_image,
                        struct spin_splat2d_grad *d_splat2d)
{
    struct loans l = {.d = d};
    struct spin_view_batch views = view_of_camera(cam, n);
    struct spin_tiles tiles = lend_tiles(&l, &views, from);

    memcpy(views.background, background, sizeof views.background);
    lend_matte(&l, &views);
    views.absolute = with_absolute;
    d->op->blend_back(d, &views, lend(&l, splat2d, n * sizeof *splat2d), &tiles,
                      lend(&l, final_transmittance, views.max_pixels * sizeof(float)),
                      lend(&l, last_contributor, views.max_pixels * sizeof(int32_t)),
                      lend(&l, d_image, views.max_pixels * float_row[3]),
                      lend_both(&l, d_splat2d, n * sizeof *d_splat2d));
    settle(&l);
}

/* pixel_weight: at most two distinct values, or NULL. */
VERB void on_loss(struct spin_device *d, int width, int height, const float *image,
                  const float *truth, const float *pixel_weight, float lambda_dssim, float weight,
                  double values[SPIN_LOSS_VALUES], float *d_image)
{
    struct loans l = {.d = d};
    struct spin_camera_f32 cam = {.width = width, .height = height};
    struct spin_view_batch views = view_of_camera(&cam, 0);
    struct spin_images images = {.max_pixels = views.max_pixels};
    size_t n = views.max_pixels;
    size_t n_mask = (n + 7) / 8;
    uint8_t *mask = calloc(2 * n_mask, 1); /* of two images, of which the view shows the second */
    float *truths = calloc(2 * n, float_row[3]);

    for (size_t i = 0; pixel_weight && i < n; i++) {
        int bit = pixel_weight[i] != pixel_weight[0];

        images.mask_weight[bit] = pixel_weight[i];
        mask[n_mask + i / 8] |= (uint8_t)(bit << i % 8);
    }
    memcpy(truths + 3 * n, truth, n * float_row[3]);
    views.view[0].image = 1;
    views.view[0].weight = weight;
    lend_matte(&l, &views);
    images.f32 = lend(&l, truths, 2 * n * float_row[3]);
    if (pixel_weight)
        images.mask = lend(&l, mask, 2 * n_mask);
    d->op->loss(d, &views, &images, lambda_dssim, lend(&l, image, n * float_row[3]),
                lend_both(&l, values, SPIN_LOSS_VALUES * sizeof *values),
                lend_both(&l, d_image, n * float_row[3]));
    settle(&l);
    free(mask);
    free(truths);
}

/* Clamps image. One of rgb8 and truth is NULL. */
VERB void on_measure(struct spin_device *d, int width, int height, float *image,
                     const uint8_t *rgb8, const float *truth, const uint8_t *mask,
                     double values[SPIN_MEASURE_VALUES])
{
    struct loans l = {.d = d};
    struct spin_camera_f32 cam = {.width = width, .height = height};
    struct spin_view_batch views = view_of_camera(&cam, 0);
    struct spin_images images = {.max_pixels = views.max_pixels};
    size_t n = views.max_pixels, n_mask = (n + 7) / 8;
    uint8_t *both[3] = {calloc(2 * n, 3), calloc(2 * n, float_row[3]), calloc(2 * n_mask, 1)};

    if (rgb8) /* each is the second of two images */
        memcpy(both[0] + 3 * n, rgb8, 3 * n);
    if (truth)
        memcpy(both[1] + n * float_row[3], truth, n * float_row[3]);
    if (mask)
        memcpy(both[2] + n_mask, mask, n_mask);
    views.view[0].image = 1;
    images.rgb8 = lend(&l, rgb8 ? both[0] : NULL, 6 * n);
    images.f32 = lend(&l, truth ? both[1] : NULL, 2 * n * float_row[3]);
    images.mask = lend(&l, mask ? both[2] : NULL, 2 * n_mask);
    d->op->measure(d, &views, &images, lend_both(&l, image, n * float_row[3]),
                   lend_both(&l, values, SPIN_MEASURE_VALUES * sizeof *values));
    settle(&l);
    for (int i = 0; i < 3; i++)
        free(both[i]);
}

/* exposure: the row of the camera, then that of its lens. */
static struct spin_view_batch exposed_view(const struct spin_camera_f32 *cam)
{
    struct spin_view_batch views = view_of_camera(cam, 0);

    views.view[0].lens = 1;
    return views;
}

VERB void on_exposure(struct spin_device *d, const struct spin_camera_f32 *cam,
                      const float *exposure, const float *image, float *out)
{
    struct loans l = {.d = d};
    struct spin_view_batch views = exposed_view(cam);
    size_t bytes = views.max_pixels * float_row[3];

    d->op->exposure(d, &views, lend(&l, exposure, 2 * SPIN_EXPOSURE * sizeof(float)),
                    lend(&l, image, bytes), lend_both(&l, out, bytes));
    settle(&l);
}

VERB void on_exposure_back(struct spin_device *d, const struct spin_camera_f32 *cam,
                           const float *exposure, const float *image, float *d_image,
                           float *d_exposure)
{
    struct loans l = {.d = d};
    struct spin_view_batch views = exposed_view(cam);
    size_t bytes = views.max_pixels * float_row[3];

    d->op->exposure_back(d, &views, lend(&l, exposure, 2 * SPIN_EXPOSURE * sizeof(float)),
                         lend(&l, image, bytes), lend_both(&l, d_image, bytes),
                         lend_both(&l, d_exposure, 2 * SPIN_EXPOSURE * sizeof(float)));
    settle(&l);
}

#endif
