/* The loop of 3DGS over one frame: the training step of explicit parameters without a network.
 *
 * An iteration is operations of the device only; the host reads back the loss. Densification happens on the host, in the cloud: points
 * come down with their moments and statistics, change in number, and go up again.
 *
 * SH coefficients beyond the first are in the rows of field_eval.raw, whose other columns are written anew
 * from the residual values in every iteration. So Adam steps whole rows of it with those of d_attr. */
#include "train/refine.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "base/err.h"
#include "base/mem.h"
#include "math/adam.h"
#include "math/rng.h"
#include "model/field_eval.h"
#include "train/image_loss.h"
#include "train/train_frame.h"

enum { STREAM_VIEWS = 33 }; /* of the random numbers, see math/rng.h */
enum { CHECK_EVERY = 100 }; /* iterations between checks that all values are finite */

struct refine {
    const struct spin_refine_options *o;
    const struct spin_images *images;
    const struct spin_refine_view *views;
    int n_views;
    struct spin_device *device;
    struct spin_refine_cloud *cloud;
    struct spin_refine_stats stats;
    size_t max_pixels, max_tiles;
    struct spin_frame_batch frames; /* the one frame, for the device */
    struct spin_train_frame
        frame; /* parameters and moments; frame.size.n is the number of points */
    struct spin_field_eval field_eval; /* without a network */
    struct spin_raster raster;
    struct spin_exposures exposures;    /* a view's own */
    float SPIN_DEV *d_pos, *d_residual; /* [n][3], [SPIN_RESIDUAL n]: gradients */
    float SPIN_DEV *gradient;           /* [n] since the last densification: sum over views ... */
    uint32_t SPIN_DEV *seen;            /* [n] ... and how many those were */
    float SPIN_DEV *raw_m, *raw_v;      /* [n][SPIN_ATTR]: moments of raw, where the cloud has SH */
    double SPIN_DEV *values;            /* [SPIN_LOSS_VALUES] of the iteration */
    int *sequence;                      /* [n_views] the present permutation */
};

/* ---- Options --------------------------------------------------------------------------------- */

void spin_refine_defaults(struct spin_refine_options *o)
{
    memset(o, 0, sizeof *o);
    o->iterations = 2000;
    o->lr_position = 1.6e-4;
    o->lr_position_end = 1.6e-6;
    o->lr_dc = 2.5e-3;
    o->lr_sh = 2.5e-3 / 20;
    o->sh_increase_every = 1000;
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

        if (c->width < 1 || c->height < 1 || !r->images)
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

/* Statistics are gathered while a densification is still to come. */
static bool densify_ahead(const struct spin_refine_options *o, int iteration)
{
    for (int i = 0; o->densify_at && i < o->n_densify_at; i++)
        if (o->densify_at[i] >= iteration)
            return true;
    return !o->densify_at && iteration < window_last(o);
}

int spin_refine_sh_degree(int sh_degree, int increase_every, int iterations)
{
    int reached = increase_every > 0 ? (iterations - 1) / increase_every : sh_degree;

    return reached < sh_degree ? reached : sh_degree;
}

static int sh_degree_at(const struct refine *r, int iteration)
{
    return spin_refine_sh_degree(r->cloud->sh_degree, r->o->sh_increase_every, iteration);
}

/* ---- Memory ---------------------------------------------------------------------------------- */

static void release(struct refine *r)
{
    struct spin_device *d = r->device;
    void SPIN_DEV *all[] = {r->d_pos, r->d_residual, r->gradient, r->seen, r->raw_m, r->raw_v};

    for (size_t i = 0; i < sizeof all / sizeof *all; i++)
        d->op->release(d, all[i]);
    r->d_pos = r->d_residual = r->gradient = r->raw_m = r->raw_v = NULL;
    r->seen = NULL;
    spin_field_eval_close(&r->field_eval, NULL);
    spin_raster_close(&r->raster);
    spin_train_frame_close(&r->frame, d);
}

static spin_status reserve_floats(struct spin_device *d, size_t floats, float SPIN_DEV **out)
{
    return d->op->reserve(d, floats * sizeof(float), (void SPIN_DEV **)out);
}

/* Room for n points everywhere; contents are lost. The step counter goes on: 3DGS has one for all points. */
static spin_status reserve(struct refine *r, size_t n)
{
    struct spin_device *d = r->device;
    size_t capacity = n + n / 4;
    int64_t steps = r->frame.steps;

    if (n > r->frame.capacity.n) {
        release(r);
        SPIN_TRY(spin_train_frame_open(
            &r->frame, d, (struct spin_frame_size){capacity, capacity, capacity, capacity}, false));
        r->frame.steps = steps;
        SPIN_TRY(spin_field_eval_open(&r->field_eval, d, NULL, capacity, true));
        SPIN_TRY(spin_raster_open(&r->raster, d, capacity, r->max_pixels, r->max_tiles, 1, true));
        SPIN_TRY(reserve_floats(d, capacity * 3, &r->d_pos));
        SPIN_TRY(reserve_floats(d, capacity * SPIN_RESIDUAL, &r->d_residual));
        SPIN_TRY(reserve_floats(d, capacity, &r->gradient));
        SPIN_TRY(reserve_floats(d, capacity, (float SPIN_DEV **)&r->seen));
        if (r->cloud->sh)
            SPIN_TRY(reserve_floats(d, capacity * SPIN_ATTR, &r->raw_m));
        if (r->cloud->sh)
            SPIN_TRY(reserve_floats(d, capacity * SPIN_ATTR, &r->raw_v));
    }
    r->frame.size = (struct spin_frame_size){n, n, n, n};
    return SPIN_OK;
}

size_t spin_refine_bytes(const struct spin_device *device, size_t n, size_t pixels, size_t tiles,
                         int sh_degree)
{
    struct spin_counting_device c;
    float sh;
    struct spin_refine_cloud cloud = {.sh = sh_degree > 0 ? &sh : NULL};
    struct refine r = {
        .device = &c.device, .cloud = &cloud, .max_pixels = pixels, .max_tiles = tiles};
    size_t host = sizeof(struct spin_refine_point) + SPIN_RESIDUAL * sizeof(float);

    spin_device_count(&c, device);
    if (reserve(&r, n) != SPIN_OK)
        return SIZE_MAX;
    release(&r);
    if (sh_degree > 0)
        host += (3 * SPIN_REFINE_SH + SPIN_ATTR) * sizeof(float);
    return c.bytes + n * host + spin_raster_grows(n, pixels, true);
}

/* ---- Between cloud and device: before, after, and where the number of points changes ---------- */

static spin_status carry(struct refine *r, enum spin_train_array which, bool up)
{
    struct spin_refine_point *first = r->cloud->point;
    struct spin_refine_row *row = which == SPIN_TRAIN_VALUES     ? &first->p
                                  : which == SPIN_TRAIN_MOMENT_1 ? &first->m
                                                                 : &first->v;
    size_t stride = sizeof *first / sizeof(float);
    struct spin_rows pos = {row->pos_w, stride}, residual = {row->log_scale, stride};

    return up ? spin_train_frame_upload(&r->frame, r->device, which, pos, residual, NULL)
              : spin_train_frame_download(&r->frame, r->device, which, pos, residual, NULL);
}

/* SH beyond the first, and its moments. */
static spin_status carry_sh(struct refine *r, bool up)
{
    struct spin_device *d = r->device;
    float SPIN_DEV *rows[] = {r->field_eval.raw, r->raw_m, r->raw_v};
    size_t n = r->cloud->n, bytes = n * SPIN_ATTR * sizeof(float);
    float *host = NULL;
    spin_status status = SPIN_OK;

    if (!r->cloud->sh)
        return SPIN_OK;
    SPIN_TRY(spin_alloc(n, SPIN_ATTR * sizeof *host, (void **)&host));
    for (size_t which = 0; which < 3; which++) {
        if (!up)
            SPIN_TRY_OUT(d->op->download(d, host, rows[which], bytes));
        for (size_t i = 0; i < n; i++) {
            float *sh = r->cloud->sh + (3 * i + which) * SPIN_REFINE_SH;
            float *row = host + SPIN_ATTR * i + SPIN_ATTR_SH + 3;

            memcpy(up ? row : sh, up ? sh : row, SPIN_REFINE_SH * sizeof(float));
        }
        if (up)
            d->op->upload(d, rows[which], host, bytes);
    }
out:
    free(host);
    return status;
}

static spin_status send_cloud(struct refine *r)
{
    struct spin_device *d = r->device;
    size_t n = r->cloud->n;

    SPIN_TRY(reserve(r, n));
    if (n == 0)
        return SPIN_OK;
    for (int which = SPIN_TRAIN_VALUES; which <= SPIN_TRAIN_MOMENT_2; which++)
        SPIN_TRY(carry(r, which, true));
    SPIN_TRY(carry_sh(r, true));
    r->frames = spin_one_frame(n, r->frame.pos, 0, r->frame.residual);
    r->frames.frame[0].d_means = r->d_pos;
    r->frames.frame[0].d_residual = r->d_residual;
    r->frames.frame[0].gradient = r->gradient;
    r->frames.frame[0].seen = r->seen;
    d->op->zero(d, r->d_pos, n * 3 * sizeof(float));
    d->op->zero(d, r->gradient, n * sizeof(float));
    d->op->zero(d, r->seen, n * sizeof(uint32_t));
    return SPIN_OK;
}

static spin_status fetch_cloud(struct refine *r)
{
    if (r->frame.size.n == 0)
        return SPIN_OK;
    for (int which = SPIN_TRAIN_VALUES; which <= SPIN_TRAIN_MOMENT_2; which++)
        SPIN_TRY(carry(r, which, false));
    return carry_sh(r, false);
}

static spin_status not_finite(const char *name, size_t row, int iteration)
{
    return spin_fail(SPIN_E_MALFORMED,
                     "array '%s' is not finite in row %zu after iteration %d: look for bad points",
                     name, row, iteration);
}

/* The cloud's values must be finite. What is not finite would be pruned without a word. */
static spin_status check_finite(const struct refine *r, int iteration)
{
    static const struct group {
        const char *name;
        size_t first, width; /* in a spin_refine_row */
    } groups[] = {
        {"means", 0, 3}, {"scales", 3, 3}, {"quats", 6, 4}, {"sh", 10, 3}, {"opacities", 13, 1}};

    for (size_t k = 0; k < sizeof groups / sizeof *groups; k++)
        for (size_t i = 0; i < r->cloud->n; i++) {
            const float *row = (const float *)&r->cloud->point[i].p + groups[k].first;

            for (size_t c = 0; c < groups[k].width; c++)
                if (!isfinite(row[c]))
                    return not_finite(groups[k].name, i, iteration);
        }
    for (size_t i = 0; r->cloud->sh && i < r->cloud->n; i++)
        for (size_t c = 0; c < SPIN_REFINE_SH; c++)
            if (!isfinite(r->cloud->sh[3 * SPIN_REFINE_SH * i + c]))
                return not_finite("sh", i, iteration);
    return SPIN_OK;
}

/* The same of the values on the device. */
static spin_status check_device(struct refine *r, int iteration)
{
    SPIN_TRY(carry(r, SPIN_TRAIN_VALUES, false));
    SPIN_TRY(carry_sh(r, false));
    return check_finite(r, iteration);
}

/* What densification goes by, to the cloud. */
static spin_status fetch_statistics(struct refine *r)
{
    struct spin_device *d = r->device;
    size_t n = r->frame.size.n;
    void *block = NULL;
    float *gradient;
    uint32_t *seen;
    spin_status status;

    SPIN_TRY_OUT(spin_alloc(n + 1, sizeof *gradient + sizeof *seen, &block));
    gradient = block;
    seen = (uint32_t *)(gradient + n);
    SPIN_TRY_OUT(d->op->download(d, gradient, r->gradient, n * sizeof *gradient));
    SPIN_TRY_OUT(d->op->download(d, seen, r->seen, n * sizeof *seen));
    for (size_t i = 0; i < n; i++) {
        r->cloud->point[i].gradient = gradient[i];
        r->cloud->point[i].seen = seen[i];
    }
out:
    free(block);
    return status;
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

/* Render, loss, backward: leaves the losses, d_attr and the positions' gradients, and adds to the statistics. */
static spin_status draw(struct refine *r, int view, int sh_degree, bool statistics)
{
    const struct spin_refine_options *o = r->o;
    struct spin_device *d = r->device;
    struct spin_field_eval *e = &r->field_eval;
    struct spin_view_batch views = spin_raster_batch(&r->raster, o->background);
    struct spin_view_of_batch *v = spin_raster_add_view(&r->raster, &views, 0, r->frame.size.n,
                                                        &r->views[view].camera, o->antialias);

    v->weight = 1;
    v->image = r->views[view].image;
    v->exposure = view;
    v->lens = r->n_views + r->views[view].lens;
    spin_field_forward(e, NULL, NULL, NULL, &r->frames);
    SPIN_TRY(spin_raster_forward(&r->raster, &views, &r->frames, e->attr, sh_degree));
    spin_image_loss(&r->exposures, &r->raster, &views, r->images, (float)o->lambda_dssim,
                    r->values);
    d->op->zero(d, e->d_attr, r->frame.size.n * SPIN_ATTR * sizeof(float));
    spin_raster_backward(&r->raster, &views, &r->frames, e->attr, sh_degree, e->d_attr);
    if (statistics)
        d->op->densify_stats(d, &views, &r->frames, r->raster.splat2d, r->raster.d_splat2d);
    return SPIN_OK;
}

static void step(struct refine *r, int iteration)
{
    const struct spin_refine_options *o = r->o;
    struct spin_param_group group[SPIN_TRAIN_FRAME_GROUPS];
    struct spin_frame_of_batch *frame = &r->frames.frame[0];
    double extent = o->densify.extent, n = (double)r->frame.size.n;
    double lr_pos =
        spin_lr_exp(o->lr_position * extent, o->lr_position_end * extent, iteration, o->iterations);
    const double lr[SPIN_HEADS] = {[SPIN_HEAD_SCALE] = o->lr_scale,
                                   [SPIN_HEAD_ROTATION] = o->lr_rotation,
                                   [SPIN_HEAD_SH] = o->lr_dc,
                                   [SPIN_HEAD_OPACITY] = o->lr_opacity};
    int n_groups;

    frame->d_scale = (float)(o->lambda_scale / (3 * extent * n));
    frame->d_opacity = (float)(o->lambda_opacity / n);
    spin_field_backward(&r->field_eval, NULL, NULL, NULL, &r->frames, NULL, NULL);
    n_groups = spin_train_frame_step(&r->frame, lr_pos, lr, 1, r->d_pos, r->d_residual, group);
    r->device->op->adam(r->device, n_groups, group);
}

/* SH beyond the first. While its degree is 0 its gradients and moments are all zero. */
static void step_sh(struct refine *r, int iteration)
{
    struct spin_param_group rows = {.p = r->field_eval.raw,
                                    .g = r->field_eval.d_attr,
                                    .m = r->raw_m,
                                    .v = r->raw_v,
                                    .n = r->frame.size.n * SPIN_ATTR,
                                    .lr = r->o->lr_sh,
                                    .step = r->frame.steps};

    if (sh_degree_at(r, iteration) > 0)
        r->device->op->adam(r->device, 1, &rows);
}

/* Of the views' exposures, which the next frame forgets. */
static void step_exposures(struct refine *r, int iteration)
{
    const struct spin_param *p = &r->exposures.param;
    size_t n = SPIN_EXPOSURE * r->exposures.n_cameras;
    struct spin_param_group group = spin_param_group(p, 0, n, r->o->lr_exposure, iteration);

    if (p->n == 0)
        return;
    r->device->op->adam(r->device, 1, &group);
    if (p->n > n)
        r->device->op->zero(r->device, p->g + n, (p->n - n) * sizeof(float));
    spin_exposures_centre(&r->exposures, r->device);
}

/* In place of a step: 3DGS exchanges the parameters here, so their gradients are gone. */
static spin_status densify(struct refine *r, struct spin_refine_step *now)
{
    struct spin_densify_change *sum = &r->stats.change;

    now->densified = true;
    SPIN_TRY(fetch_cloud(r));
    SPIN_TRY(check_finite(r, now->iteration));
    SPIN_TRY(fetch_statistics(r));
    SPIN_TRY(spin_densify(&r->o->densify, now->iteration, r->cloud, &now->change));
    sum->clones += now->change.clones;
    sum->splits += now->change.splits;
    sum->pruned += now->change.pruned;
    r->stats.densifications++;
    return send_cloud(r);
}

static spin_status iterate(struct refine *r, const int *order, int iteration)
{
    struct spin_refine_step now = {.iteration = iteration, .n = r->frame.size.n};
    double values[SPIN_LOSS_VALUES];

    if (spin_cancelled())
        return spin_fail_cancelled();
    now.view = choose_view(r, order, iteration);
    SPIN_TRY(draw(r, now.view, sh_degree_at(r, iteration), densify_ahead(r->o, iteration)));
    r->stats.blind += r->raster.tiles.n_intersections == 0;
    if (densify_due(r->o, iteration)) {
        SPIN_TRY(densify(r, &now));
    } else {
        step(r, iteration);
        step_sh(r, iteration);
    }
    if (iteration % CHECK_EVERY == 0 && r->frame.size.n > 0)
        SPIN_TRY(check_device(r, iteration));
    step_exposures(r, iteration);
    SPIN_TRY(r->device->op->download(r->device, values, r->values, sizeof values));
    now.loss = values[SPIN_LOSS];
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
        if (cloud->sh)
            memset(cloud->sh + (3 * i + 1) * SPIN_REFINE_SH, 0, 2 * SPIN_REFINE_SH * sizeof(float));
    }
}

/* The views' own exposures begin at nothing. */
static spin_status open_exposures(struct refine *r)
{
    const struct spin_refine_options *o = r->o;
    int n = o->lr_exposure > 0 ? r->n_views : 0, n_lenses = o->n_lenses > 0 ? o->n_lenses : 1;
    void *first = NULL;
    spin_status status;

    SPIN_TRY(spin_alloc((size_t)(r->n_views + n_lenses), SPIN_EXPOSURE * sizeof(float), &first));
    if (o->n_lenses > 0)
        memcpy((float *)first + (size_t)r->n_views * SPIN_EXPOSURE, o->lenses,
               (size_t)o->n_lenses * SPIN_EXPOSURE * sizeof(float));
    status = spin_exposures_open(&r->exposures, r->device, n, n_lenses, first, r->max_pixels);
    free(first);
    return status;
}

spin_status spin_refine_frame(struct spin_device *device, const struct spin_refine_options *o,
                              const struct spin_images *images,
                              const struct spin_refine_view *views, int n_views, const int *order,
                              struct spin_refine_cloud *cloud, struct spin_refine_stats *stats)
{
    struct refine r = {.o = o,
                       .images = images,
                       .views = views,
                       .n_views = n_views,
                       .device = device,
                       .cloud = cloud};
    spin_status status;
    void *block = NULL;

    SPIN_TRY(check_options(o));
    SPIN_TRY(check_views(&r, order));
    SPIN_TRY(spin_alloc((size_t)n_views, sizeof *r.sequence, &block));
    r.sequence = block;
    r.stats.n_first = cloud->n;
    start_afresh(cloud);
    SPIN_TRY_OUT(open_exposures(&r));
    SPIN_TRY_OUT(device->op->reserve(device, SPIN_LOSS_VALUES * sizeof *r.values,
                                     (void SPIN_DEV **)&r.values));
    SPIN_TRY_OUT(send_cloud(&r));
    for (int i = 1; i <= o->iterations && r.frame.size.n > 0; i++)
        SPIN_TRY_OUT(iterate(&r, order, i));
    SPIN_TRY_OUT(fetch_cloud(&r));
    SPIN_TRY_OUT(check_finite(&r, r.stats.iterations));
    if (!o->no_final_prune)
        r.stats.change.pruned += spin_refine_prune(cloud, o->densify.prune_opacity);
    r.stats.n_last = cloud->n;
    if (stats)
        *stats = r.stats;
out:
    release(&r);
    device->op->release(device, r.values);
    spin_exposures_close(&r.exposures, device);
    free(block);
    return status;
}
