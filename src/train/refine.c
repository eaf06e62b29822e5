/* The loop of 3DGS over one frame at SH degree 0.
 *
 * The device holds parameters, gradients and moments as five groups side by side, each
 * contiguous, since each has its own learning rate: n positions, n colours, n opacities, ... The
 * rasteriser wants rows of SPIN_ATTR, so the host carries values from groups to rows and
 * gradients back. Densification happens on the host, in the cloud; afterwards everything goes up
 * again. */
#include "train/refine.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "base/err.h"
#include "base/mem.h"
#include "device/clock.h"
#include "train/exposure.h"
#include "math/adam.h"
#include "math/rng.h"

enum { STREAM_VIEWS = 33 }; /* of the random numbers, see math/rng.h */
enum { CHECK_EVERY = 100 }; /* iterations between looks at the values */
enum { POSITION, DC, OPACITY, SCALE, ROTATION, N_GROUPS };
enum { VALUES, MOMENT_1, MOMENT_2 };

/* Where a group's floats lie in a spin_refine_row and in a row of attributes. Positions have no
 * place there: the first group is the rasteriser's pos_w as it stands. */
static const struct group {
    size_t first, width, attr;
} groups[N_GROUPS] = {
    [POSITION] = {0, 3, 0},
    [DC] = {3, 3, SPIN_ATTR_SH},
    [OPACITY] = {6, 1, SPIN_ATTR_OPACITY},
    [SCALE] = {7, 3, SPIN_ATTR_SCALE},
    [ROTATION] = {10, 4, SPIN_ATTR_ROTATION},
};

struct refine {
    const struct spin_refine_options *o;
    const struct spin_refine_view *views;
    int n_views;
    struct spin_device *device;
    struct spin_refine_cloud *cloud;
    struct spin_refine_stats stats;
    size_t n, capacity, max_pixels, max_tiles;
    float *p, *g, *m, *v;               /* device, groups of n */
    float *raw, *attr, *d_raw, *d_attr; /* device [n][SPIN_ATTR] */
    uint32_t *rows;                     /* device [n] with a gradient */
    struct spin_raster raster;
    struct spin_exposures exposures; /* a view's own */
    float *host_group;               /* [n * SPIN_REFINE_WIDTH] */
    float *host_raw;                 /* [n][SPIN_ATTR] SH beyond the first coefficient stays zero */
    float *host_d_raw;               /* [n][SPIN_ATTR] */
    uint32_t *host_rows;             /* [n] */
    struct spin_splat2d *splat2d;    /* host [n] */
    struct spin_splat2d_grad *d_splat2d; /* host [n] */
    int *sequence;                       /* [n_views] the present permutation */
    int64_t steps;                       /* of Adam: one counter for all points */
};

/* ---- Options --------------------------------------------------------------------------------- */

void spin_refine_defaults(struct spin_refine_options *o)
{
    memset(o, 0, sizeof *o);
    o->iterations = 2000;
    o->lr_position = 1.6e-4;
    o->lr_position_end = 1.6e-6;
    o->lr_dc = 2.5e-3;
    o->lr_opacity = 0.05;
    o->lr_scale = 5e-3;
    o->lr_rotation = 1e-3;
    o->lambda_dssim = 0.2;
    o->densify_from = o->densify_until = -1;
    o->densify_every = 100;
    spin_densify_defaults(&o->densify);
}

static spin_status check_options(const struct spin_refine_options *o)
{
    if (o->iterations < 1)
        return spin_fail(SPIN_E_USAGE, "refining takes at least one iteration, not %d",
                         o->iterations);
    if (!(o->densify.extent > 0 && isfinite(o->densify.extent)))
        return spin_fail(SPIN_E_USAGE, "the extent of the scene, %g, is not a positive number",
                         o->densify.extent);
    if (!(o->lr_position > 0 && o->lr_position_end > 0))
        return spin_fail(SPIN_E_USAGE,
                         "position rates %g and %g must be positive: they are "
                         "interpolated as logarithms",
                         o->lr_position, o->lr_position_end);
    if (!(o->lambda_dssim >= 0 && o->lambda_dssim <= 1))
        return spin_fail(SPIN_E_USAGE, "lambda-dssim %g is not in 0 to 1", o->lambda_dssim);
    if (!(o->lr_exposure >= 0 && o->lambda_scale >= 0 && o->lambda_opacity >= 0))
        return spin_fail(SPIN_E_USAGE, "rates and weights of refining are not negative numbers");
    if (!o->densify_at && o->densify_every < 1)
        return spin_fail(SPIN_E_USAGE, "densify-every must be at least 1, not %d",
                         o->densify_every);
    return SPIN_OK;
}

static spin_status check_views(struct refine *r, const int *order)
{
    if (r->n_views < 1)
        return spin_fail(SPIN_E_USAGE, "refining a frame needs at least one view of it");
    for (int i = 0; i < r->n_views; i++) {
        const struct spin_camera *c = &r->views[i].camera;
        struct spin_camera_f32 cam;
        size_t pixels, tiles;

        if (c->width < 1 || c->height < 1 || !r->views[i].truth)
            return spin_fail(SPIN_E_USAGE, "view %d has no picture: %d x %d pixels", i, c->width,
                             c->height);
        cam = spin_camera_f32_from(c);
        pixels = (size_t)cam.width * (size_t)cam.height;
        tiles = (size_t)cam.tiles_x * (size_t)cam.tiles_y;
        r->max_pixels = pixels > r->max_pixels ? pixels : r->max_pixels;
        r->max_tiles = tiles > r->max_tiles ? tiles : r->max_tiles;
    }
    for (int i = 0; order && i < r->o->iterations; i++)
        if (order[i] < 0 || order[i] >= r->n_views)
            return spin_fail(SPIN_E_USAGE, "iteration %d asks for view %d of %d", i + 1, order[i],
                             r->n_views);
    return SPIN_OK;
}

/* The iterations between which densification happens, both exclusive. 3DGS starts after 500, which
 * would leave a budget of 500 without any. */
static int window_first(const struct spin_refine_options *o)
{
    int fifth = o->iterations / 5;

    return o->densify_from >= 0 ? o->densify_from : fifth < 500 ? fifth : 500;
}

static int window_last(const struct spin_refine_options *o)
{
    return o->densify_until >= 0 ? o->densify_until : (int)(3 * (int64_t)o->iterations / 4);
}

static bool densify_due(const struct spin_refine_options *o, int iteration)
{
    for (int i = 0; o->densify_at && i < o->n_densify_at; i++)
        if (o->densify_at[i] == iteration)
            return true;
    return !o->densify_at && iteration > window_first(o) && iteration < window_last(o) &&
           iteration % o->densify_every == 0;
}

/* Statistics are only worth their transfer while a densification is still to come. */
static bool densify_ahead(const struct spin_refine_options *o, int iteration)
{
    for (int i = 0; o->densify_at && i < o->n_densify_at; i++)
        if (o->densify_at[i] >= iteration)
            return true;
    return !o->densify_at && iteration < window_last(o);
}

/* ---- Memory ---------------------------------------------------------------------------------- */

size_t spin_refine_bytes(size_t n, size_t pixels)
{
    size_t device =
        4 * SPIN_REFINE_WIDTH * sizeof(float) + 4 * SPIN_ATTR * sizeof(float) + sizeof(uint32_t);
    size_t host = sizeof(struct spin_refine_point) +
                  (SPIN_REFINE_WIDTH + 2 * SPIN_ATTR + 1) * sizeof(float) +
                  sizeof(struct spin_splat2d) + sizeof(struct spin_splat2d_grad);

    return n * (device + host) + spin_raster_bytes(n, pixels, true);
}

/* Every block that has a place per point. */
struct block {
    void *at;     /* the pointer to it, of whatever type */
    size_t bytes; /* per point */
    bool on_host;
};
enum { N_BLOCKS = 15 };

static void list_blocks(struct refine *r, struct block list[N_BLOCKS])
{
    const size_t group = SPIN_REFINE_WIDTH * sizeof(float), row = SPIN_ATTR * sizeof(float);
    const struct block blocks[N_BLOCKS] = {
        {&r->p, group, false},
        {&r->g, group, false},
        {&r->m, group, false},
        {&r->v, group, false},
        {&r->raw, row, false},
        {&r->attr, row, false},
        {&r->d_raw, row, false},
        {&r->d_attr, row, false},
        {&r->rows, sizeof *r->rows, false},
        {&r->host_group, group, true},
        {&r->host_raw, row, true},
        {&r->host_d_raw, row, true},
        {&r->host_rows, sizeof *r->host_rows, true},
        {&r->splat2d, sizeof *r->splat2d, true},
        {&r->d_splat2d, sizeof *r->d_splat2d, true},
    };

    memcpy(list, blocks, sizeof blocks);
}

/* Pointers of different types are read and set as bytes. */
static void *pointer_at(const void *at)
{
    void *block;

    memcpy(&block, at, sizeof block);
    return block;
}

static void release(struct refine *r)
{
    struct block list[N_BLOCKS];

    list_blocks(r, list);
    for (int i = 0; i < N_BLOCKS; i++) {
        void *block = pointer_at(list[i].at);

        if (list[i].on_host)
            free(block);
        else
            r->device->op->release(r->device, block, r->capacity * list[i].bytes);
        memset(list[i].at, 0, sizeof block);
    }
    spin_raster_close(&r->raster);
    r->capacity = 0;
}

/* Room for n points everywhere; contents are lost. */
static spin_status reserve(struct refine *r, size_t n)
{
    struct block list[N_BLOCKS];

    if (n <= r->capacity)
        return SPIN_OK;
    release(r);
    r->capacity = n + n / 4;
    list_blocks(r, list);
    for (int i = 0; i < N_BLOCKS; i++) {
        void *block = NULL;

        if (list[i].on_host)
            SPIN_TRY(spin_alloc(r->capacity, list[i].bytes, &block));
        else
            SPIN_TRY(r->device->op->reserve(r->device, r->capacity * list[i].bytes, &block));
        memcpy(list[i].at, &block, sizeof block);
    }
    return spin_raster_open(&r->raster, r->device, r->capacity, r->max_pixels, r->max_tiles, true);
}

/* ---- Between cloud, groups and rows ---------------------------------------------------------- */

static float *row_of(struct spin_refine_point *point, int what)
{
    return (float *)(what == VALUES ? &point->p : what == MOMENT_1 ? &point->m : &point->v);
}

/* Copy one kind of row of every point to the host's groups, or back. */
static void carry(struct refine *r, int what, bool to_groups)
{
    for (int k = 0; k < N_GROUPS; k++) {
        const struct group *group = &groups[k];
        float *at = r->host_group + r->n * group->first;

        for (size_t i = 0; i < r->n; i++, at += group->width) {
            float *row = row_of(&r->cloud->point[i], what) + group->first;

            memcpy(to_groups ? at : row, to_groups ? row : at, group->width * sizeof *at);
        }
    }
}

static size_t group_bytes(const struct refine *r)
{
    return r->n * SPIN_REFINE_WIDTH * sizeof(float);
}

/* From the values in host_group. */
static void send_raw(struct refine *r)
{
    for (int k = DC; k < N_GROUPS; k++) {
        const struct group *group = &groups[k];
        const float *from = r->host_group + r->n * group->first;
        float *to = r->host_raw + group->attr;

        for (size_t i = 0; i < r->n; i++, from += group->width, to += SPIN_ATTR)
            memcpy(to, from, group->width * sizeof *to);
    }
    r->device->op->upload(r->device, r->raw, r->host_raw, r->n * SPIN_ATTR * sizeof(float));
}

static spin_status send_cloud(struct refine *r)
{
    struct spin_device *d = r->device;

    SPIN_TRY(reserve(r, r->cloud->n));
    r->n = r->cloud->n;
    if (r->n == 0)
        return SPIN_OK;
    carry(r, MOMENT_1, true);
    d->op->upload(d, r->m, r->host_group, group_bytes(r));
    carry(r, MOMENT_2, true);
    d->op->upload(d, r->v, r->host_group, group_bytes(r));
    carry(r, VALUES, true);
    d->op->upload(d, r->p, r->host_group, group_bytes(r));
    d->op->zero(d, r->g, group_bytes(r));
    send_raw(r);
    return SPIN_OK;
}

static void fetch_cloud(struct refine *r)
{
    struct spin_device *d = r->device;

    if (r->n == 0)
        return;
    d->op->download(d, r->host_group, r->m, group_bytes(r));
    carry(r, MOMENT_1, false);
    d->op->download(d, r->host_group, r->v, group_bytes(r));
    carry(r, MOMENT_2, false);
    d->op->download(d, r->host_group, r->p, group_bytes(r));
    carry(r, VALUES, false);
}

/* The values in host_group, which must be finite: what is not would be pruned without a word. */
static spin_status check_finite(const struct refine *r, int iteration)
{
    static const char *const name[N_GROUPS] = {"means", "sh", "opacities", "scales", "quats"};

    for (int k = 0; k < N_GROUPS; k++) {
        const float *at = r->host_group + r->n * groups[k].first;

        for (size_t i = 0; i < r->n * groups[k].width; i++)
            if (!isfinite(at[i]))
                return spin_fail(SPIN_E_MALFORMED,
                                 "array '%s' is not finite in row %zu after iteration %d: look for "
                                 "bad points",
                                 name[k], i / groups[k].width, iteration);
    }
    return SPIN_OK;
}

/* d_attr to the groups behind the positions, whose gradients the rasteriser left in place. */
static void gather_gradients(struct refine *r)
{
    struct spin_device *d = r->device;
    const struct spin_refine_options *o = r->o;
    size_t n_rows = d->op->active(d, r->n, r->d_attr, r->g, r->rows), skip = r->n * 3;

    if (o->lambda_scale > 0 || o->lambda_opacity > 0)
        d->op->regularise_back(d, n_rows, r->rows,
                               (float)(o->lambda_scale / (3 * o->densify.extent * (double)r->n)),
                               (float)(o->lambda_opacity / (double)r->n), r->d_attr);
    SPIN_TIMED(d, SPIN_OP_ACTIVATE_BACK,
               d->op->activate_back(d, n_rows, r->rows, r->raw, r->d_attr, r->d_raw));
    d->op->download(d, r->host_rows, r->rows, n_rows * sizeof *r->rows);
    d->op->download(d, r->host_d_raw, r->d_raw, n_rows * SPIN_ATTR * sizeof(float));
    memset(r->host_group, 0, group_bytes(r));
    for (int k = DC; k < N_GROUPS; k++) {
        const struct group *group = &groups[k];
        float *to = r->host_group + r->n * group->first;

        for (size_t i = 0; i < n_rows; i++)
            memcpy(to + r->host_rows[i] * group->width, r->host_d_raw + i * SPIN_ATTR + group->attr,
                   group->width * sizeof *to);
    }
    d->op->upload(d, r->g + skip, r->host_group + skip, group_bytes(r) - skip * sizeof(float));
}

/* ---- One iteration --------------------------------------------------------------------------- */

/* A function of seed, frame and epoch (Fisher and Yates). */
static void shuffle_views(struct refine *r, int64_t epoch)
{
    const struct spin_densify_options *o = &r->o->densify;
    uint64_t seed = spin_rng_u64(o->seed, STREAM_VIEWS, (uint64_t)o->frame);

    for (int i = 0; i < r->n_views; i++)
        r->sequence[i] = i;
    for (int i = r->n_views; i > 1; i--) {
        uint32_t j = spin_rng_below(seed, (uint64_t)epoch, (uint64_t)i, (uint32_t)i);
        int keep = r->sequence[i - 1];

        r->sequence[i - 1] = r->sequence[j];
        r->sequence[j] = keep;
    }
}

static int choose_view(struct refine *r, const int *order, int iteration)
{
    int turn = iteration - 1;

    if (order)
        return order[turn];
    if (turn % r->n_views == 0)
        shuffle_views(r, turn / r->n_views);
    return r->sequence[turn % r->n_views];
}

/* Render, loss, backward: leaves d_attr, d_splat2d and the positions' gradients. */
static spin_status draw(struct refine *r, int view, const struct spin_camera_f32 *cam, double *loss)
{
    const struct spin_refine_options *o = r->o;
    const struct spin_refine_view *v = &r->views[view];
    const struct spin_target taken = {&v->camera, view, v->truth, v->weight};
    struct spin_device *d = r->device;
    double values[3];

    SPIN_TIMED(d, SPIN_OP_ACTIVATE, d->op->attr(d, r->n, r->raw, r->attr));
    SPIN_TRY(spin_raster_forward(&r->raster, cam, r->n, r->p, r->attr, 0, o->background));
    spin_image_loss(&r->exposures, &r->raster, &taken, (float)o->lambda_dssim, 1, values);
    d->op->zero(d, r->d_attr, r->n * SPIN_ATTR * sizeof(float));
    spin_raster_backward(&r->raster, cam, r->n, r->p, r->attr, 0, o->background, r->d_attr, r->g);
    *loss = values[0];
    return SPIN_OK;
}

/* 3DGS measures the gradient in normalised device coordinates: u = ((x + 1) W - 1) / 2. */
static void add_statistics(struct refine *r, const struct spin_camera_f32 *cam)
{
    struct spin_device *d = r->device;

    d->op->download(d, r->splat2d, r->raster.splat2d, r->n * sizeof *r->splat2d);
    d->op->download(d, r->d_splat2d, r->raster.d_splat2d, r->n * sizeof *r->d_splat2d);
    for (size_t i = 0; i < r->n; i++) {
        struct spin_refine_point *point = &r->cloud->point[i];
        float x = 0.5f * (float)cam->width * r->d_splat2d[i].u_px;
        float y = 0.5f * (float)cam->height * r->d_splat2d[i].v_px;

        if (r->splat2d[i].radius_px <= 0)
            continue;
        point->gradient += sqrtf(x * x + y * y);
        point->seen++;
    }
}

static void step(struct refine *r, int iteration)
{
    const struct spin_refine_options *o = r->o;
    struct spin_device *d = r->device;
    double extent = o->densify.extent;
    const double rate[N_GROUPS] = {
        [POSITION] = spin_lr_exp(o->lr_position * extent, o->lr_position_end * extent, iteration,
                                 o->iterations),
        [DC] = o->lr_dc,
        [OPACITY] = o->lr_opacity,
        [SCALE] = o->lr_scale,
        [ROTATION] = o->lr_rotation,
    };

    gather_gradients(r);
    r->steps++;
    for (int k = 0; k < N_GROUPS; k++) {
        size_t at = r->n * groups[k].first;

        SPIN_TIMED(d, SPIN_OP_ADAM,
                   d->op->adam(d, r->n * groups[k].width, r->p + at, r->g + at, r->m + at,
                               r->v + at, rate[k], r->steps));
    }
    d->op->download(d, r->host_group, r->p, group_bytes(r));
    send_raw(r);
}

/* In place of a step: 3DGS exchanges the parameters here, so their gradients are gone. */
static spin_status densify(struct refine *r, struct spin_refine_step *now)
{
    struct spin_densify_change *sum = &r->stats.change;

    now->densified = true;
    fetch_cloud(r);
    SPIN_TRY(check_finite(r, now->iteration));
    SPIN_TRY(spin_densify(&r->o->densify, now->iteration, r->cloud, &now->change));
    sum->clones += now->change.clones;
    sum->splits += now->change.splits;
    sum->pruned += now->change.pruned;
    r->stats.densifications++;
    return send_cloud(r);
}

static spin_status iterate(struct refine *r, const int *order, int iteration)
{
    struct spin_refine_step now = {.iteration = iteration, .n = r->n};
    struct spin_camera_f32 cam;

    if (spin_cancelled())
        return spin_fail_cancelled();
    now.view = choose_view(r, order, iteration);
    cam = spin_camera_f32_from(&r->views[now.view].camera);
    cam.antialias = r->o->antialias;
    SPIN_TRY(draw(r, now.view, &cam, &now.loss));
    r->stats.blind += r->raster.tiles.n_intersections == 0;
    if (densify_ahead(r->o, iteration))
        add_statistics(r, &cam);
    if (densify_due(r->o, iteration))
        SPIN_TRY(densify(r, &now));
    else
        step(r, iteration);
    if (iteration % CHECK_EVERY == 0 && r->n > 0)
        SPIN_TRY(check_finite(r, iteration));
    spin_exposures_step(&r->exposures, r->device, r->o->lr_exposure, iteration);
    SPIN_TRY(r->device->op->wait(r->device));
    if (iteration == 1)
        r->stats.loss_first = now.loss;
    r->stats.loss_last = now.loss;
    r->stats.iterations = iteration;
    if (r->o->watch)
        r->o->watch(r->o->context, &now);
    return SPIN_OK;
}

/* No moments and statistics of an earlier run. */
static void start_afresh(struct spin_refine_cloud *cloud)
{
    for (size_t i = 0; i < cloud->n; i++) {
        struct spin_refine_row p = cloud->point[i].p;

        memset(&cloud->point[i], 0, sizeof cloud->point[i]);
        cloud->point[i].p = p;
    }
}

spin_status spin_refine_frame(struct spin_device *device, const struct spin_refine_options *o,
                              const struct spin_refine_view *views, int n_views, const int *order,
                              struct spin_refine_cloud *cloud, struct spin_refine_stats *stats)
{
    struct refine r = {
        .o = o, .views = views, .n_views = n_views, .device = device, .cloud = cloud};
    spin_status status;
    void *block = NULL;

    SPIN_TRY(check_options(o));
    SPIN_TRY(check_views(&r, order));
    SPIN_TRY(spin_alloc((size_t)n_views, sizeof *r.sequence, &block));
    r.sequence = block;
    r.stats.n_first = cloud->n;
    start_afresh(cloud);
    SPIN_TRY_OUT(
        spin_exposures_open(&r.exposures, device, o->lr_exposure > 0 ? n_views : 0, r.max_pixels));
    SPIN_TRY_OUT(send_cloud(&r));
    for (int i = 1; i <= o->iterations && r.n > 0; i++)
        SPIN_TRY_OUT(iterate(&r, order, i));
    fetch_cloud(&r);
    SPIN_TRY_OUT(check_finite(&r, r.stats.iterations));
    if (!o->no_final_prune)
        r.stats.change.pruned += spin_refine_prune(cloud, o->densify.prune_opacity);
    r.stats.n_last = cloud->n;
    if (stats)
        *stats = r.stats;
out:
    release(&r);
    spin_exposures_close(&r.exposures, device);
    free(block);
    return status;
}
