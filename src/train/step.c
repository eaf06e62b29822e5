/* The training step. It goes in groups of as many frames and views as the device takes at once. Gradients of
 * table and heads gather over all of them; positions take their step when their group is done. */
#include "train/step.h"

#include <stdlib.h>
#include <string.h>

#include "base/err.h"
#include "base/mem.h"
#include "math/adam.h"
#include "train/lazy_adam.h"

static spin_status reserve(struct spin_device *d, size_t floats, float SPIN_DEV **out)
{
    return d->op->reserve(d, floats * sizeof(float), (void SPIN_DEV **)out);
}

size_t spin_trainer_bytes(const struct spin_field *field, int n_frames, const size_t *counts,
                          size_t max_pixels, bool residual)
{
    size_t points = 0, n_max = 0, splat = spin_train_frame_bytes(residual);

    for (int f = 0; f < n_frames; f++) {
        points += counts[f];
        n_max = counts[f] > n_max ? counts[f] : n_max;
    }
    return 4 * (field->n_table + field->n_heads) * sizeof(float) + splat * points +
           splat / 3 * n_max + spin_field_eval_bytes(field, n_max, true) +
           spin_raster_bytes(n_max, max_pixels, true);
}

/* Splats of the frames that go through the device together, at most. */
static size_t splats_at_once(const struct spin_trainer *t)
{
    return t->n_max * (size_t)t->device->frames_at_once;
}

static spin_status open_values(struct spin_trainer *t, int max_items)
{
    size_t n = (size_t)max_items;
    void *block = NULL;

    t->max_items = max_items;
    SPIN_TRY(spin_alloc(n, SPIN_LOSS_VALUES * sizeof *t->host_values, &block));
    t->host_values = block;
    block = NULL;
    SPIN_TRY(spin_alloc(n, sizeof *t->drawn, &block));
    t->drawn = block;
    return t->device->op->reserve(t->device, n * SPIN_LOSS_VALUES * sizeof *t->values,
                                  (void SPIN_DEV **)&t->values);
}

spin_status spin_trainer_open(struct spin_trainer *t, struct spin_device *device,
                              const struct spin_field *field, int n_frames, const size_t *counts,
                              int max_items, size_t max_pixels, size_t max_tiles, int n_exposures,
                              bool residual)
{
    spin_status status;
    void *block = NULL;

    memset(t, 0, sizeof *t);
    t->device = device;
    t->field = *field;
    t->max_pixels = max_pixels;
    t->max_tiles = max_tiles;
    SPIN_TRY_OUT(spin_alloc((size_t)n_frames, sizeof *t->frame, &block));
    t->frame = block;
    t->n_frames = n_frames;
    SPIN_TRY_OUT(open_values(t, max_items));
    SPIN_TRY_OUT(spin_param_open(&t->table, device, field->n_table, spin_lazy_pad(field)));
    SPIN_TRY_OUT(spin_param_open(&t->heads, device, field->n_heads, 0));
    SPIN_TRY_OUT(spin_exposures_open(&t->exposures, device, n_exposures,
                                     max_pixels * (size_t)device->views_at_once));
    for (int f = 0; f < n_frames; f++) {
        t->n_max = counts[f] > t->n_max ? counts[f] : t->n_max;
        SPIN_TRY_OUT(spin_train_frame_open(&t->frame[f], device, counts[f], residual));
    }
    SPIN_TRY_OUT(reserve(device, splats_at_once(t) * 3, &t->d_pos));
    if (residual)
        SPIN_TRY_OUT(reserve(device, splats_at_once(t) * SPIN_RESIDUAL, &t->d_residual));
    SPIN_TRY_OUT(spin_field_eval_open(&t->field_eval, device, field, splats_at_once(t), true));
    SPIN_TRY_OUT(spin_raster_open(&t->raster, device, t->n_max, max_pixels, max_tiles,
                                  device->views_at_once, true));
    return SPIN_OK;
out:
    spin_trainer_close(t);
    return status;
}

spin_status spin_trainer_enable_lazy_adam(struct spin_trainer *t)
{
    struct spin_param_group table = spin_param_group(&t->table, 0, t->table.n, 0, 0);

    SPIN_TRY(t->device->op->lazy_adam_enable(t->device, &t->field.grid, &table, t->rates.iterations,
                                             &t->lazy));
    t->field_eval.lazy = t->lazy;
    return SPIN_OK;
}

void spin_trainer_close(struct spin_trainer *t)
{
    struct spin_device *d = t->device;

    if (!d)
        return;
    if (t->lazy)
        d->op->lazy_adam_close(d, t->lazy);
    d->op->release(d, t->d_pos, splats_at_once(t) * 3 * sizeof(float));
    d->op->release(d, t->d_residual, splats_at_once(t) * SPIN_RESIDUAL * sizeof(float));
    d->op->release(d, t->values, (size_t)t->max_items * SPIN_LOSS_VALUES * sizeof *t->values);
    spin_param_close(&t->table, d);
    spin_param_close(&t->heads, d);
    spin_exposures_close(&t->exposures, d);
    for (int f = 0; f < t->n_frames; f++)
        spin_train_frame_close(&t->frame[f], d);
    spin_field_eval_close(&t->field_eval, &t->field);
    spin_raster_close(&t->raster);
    free(t->frame);
    free(t->host_values);
    free(t->drawn);
    memset(t, 0, sizeof *t);
}

static double rate_at(const struct spin_trainer *t, double lr0, int64_t iteration)
{
    const struct spin_train_rates *r = &t->rates;

    return spin_lr(lr0, r->end, iteration, r->warmup, r->iterations);
}

int spin_trainer_sh_degree(const struct spin_trainer *t)
{
    int64_t begun = t->iteration > 0 ? t->iteration - 1 : 0;

    if (t->sh_increase_every <= 0 || begun / t->sh_increase_every >= t->field.sh_degree)
        return t->field.sh_degree;
    return (int)(begun / t->sh_increase_every);
}

/* ---- The table ------------------------------------------------------------------------------- */

/* After a resume the rates of the steps before it are noted again. */
static void catch_up(struct spin_trainer *t, int64_t done)
{
    while (t->lazy && t->lazy->done < done)
        t->device->op->lazy_adam_advance(t->device, t->lazy,
                                         rate_at(t, t->rates.table, t->lazy->done + 1));
}

float SPIN_DEV *spin_trainer_take_table(struct spin_trainer *t)
{
    if (!t->lazy)
        return t->table.p;
    catch_up(t, t->iteration);
    t->device->op->lazy_adam_flush(t->device, t->lazy, t->table.g);
    return t->table.g;
}

void spin_trainer_put_back(struct spin_trainer *t)
{
    if (t->lazy)
        t->device->op->zero(t->device, t->table.g, t->table.n * sizeof(float));
}

/* ---- Frames and views that go together ------------------------------------------------------- */

struct batch {
    const struct spin_images *images;
    const struct spin_train_item *items;
    int n;
};

/* Draw the views, add their gradients to d_attr and d_pos, and empty the batch of views. */
static spin_status draw_views(struct spin_trainer *t, const struct batch *b,
                              const struct spin_frame_batch *frames, struct spin_view_batch *views)
{
    struct spin_field_eval *eval = &t->field_eval;
    int sh_degree = spin_trainer_sh_degree(t);

    if (views->n_views == 0)
        return SPIN_OK;
    SPIN_TRY(spin_raster_forward(&t->raster, views, frames, eval->attr, sh_degree));
    t->seen |= t->raster.tiles.n_intersections > 0;
    spin_image_loss(&t->exposures, &t->raster, views, b->images, t->lambda_dssim, t->values);
    spin_raster_backward(&t->raster, views, frames, eval->attr, sh_degree, eval->d_attr);
    views->n_views = 0;
    return SPIN_OK;
}

static void add_item(struct spin_trainer *t, const struct batch *b, int item, int frame, size_t n,
                     struct spin_view_batch *views)
{
    struct spin_view_of_batch *view = spin_raster_add_view(
        &t->raster, views, frame, n, b->items[item].camera, t->field.antialias);

    view->weight = 1.0f / (float)b->n;
    view->image = b->items[item].image;
    view->exposure = b->items[item].exposure;
    view->value = t->n_drawn;
    t->drawn[t->n_drawn++] = item;
}

/* All views of the frames; first[f]: the first item that shows frame f of the batch. */
static spin_status draw_frames(struct spin_trainer *t, const struct batch *b, const int *first,
                               struct spin_frame_batch *frames)
{
    struct spin_view_batch views = spin_raster_batch(&t->raster, t->background);

    for (int f = 0; f < frames->n_frames; f++) {
        struct spin_frame_of_batch *frame = &frames->frame[f];
        float share = 0; /* of the batch's pictures */

        for (int i = first[f]; i < b->n; i++) {
            if (b->items[i].frame != b->items[first[f]].frame)
                continue;
            if (views.n_views == t->raster.views || views.n_views == SPIN_MAX_VIEWS)
                SPIN_TRY(draw_views(t, b, frames, &views));
            add_item(t, b, i, f, frame->n, &views);
            share += 1.0f / (float)b->n;
        }
        frame->d_scale = share * t->lambda_scale / (3 * (float)frame->n);
        frame->d_opacity = share * t->lambda_opacity / (float)frame->n;
    }
    return draw_views(t, b, frames, &views);
}

/* Adam for what belongs to the frames alone: their positions, and residual values, each group at its rate. */
static void step_frames(struct spin_trainer *t, const struct batch *b, const int *first,
                        const struct spin_frame_batch *frames)
{
    struct spin_param_group group[SPIN_MAX_FRAMES * SPIN_TRAIN_FRAME_GROUPS];
    double lr_pos = t->field_eval.still ? 0 : rate_at(t, t->rates.position, t->iteration);
    double lr[SPIN_HEADS];
    int n_groups = 0;

    for (int k = 0; k < SPIN_HEADS; k++)
        lr[k] = rate_at(t, t->rates.residual[k], t->iteration);
    for (int f = 0; f < frames->n_frames; f++)
        n_groups += spin_train_frame_step(&t->frame[b->items[first[f]].frame], lr_pos, lr,
                                          frames->frame[f].d_means, frames->frame[f].d_residual,
                                          group + n_groups);
    t->device->op->adam(t->device, n_groups, group);
}

static void add_frame(const struct spin_trainer *t, const struct spin_train_frame *frame,
                      struct spin_frame_batch *frames)
{
    struct spin_frame_of_batch *to = &frames->frame[frames->n_frames++];
    bool residual = frame->residual && t->rates.residual[SPIN_HEAD_SCALE] > 0;

    *to = (struct spin_frame_of_batch){
        .first = frames->n,
        .n = frame->n,
        .t = spin_field_time(&t->field, frame->time),
        .means = frame->pos,
        .d_means = t->d_pos + 3 * frames->n,
        .residual = frame->residual,
        .d_residual = residual ? t->d_residual + SPIN_RESIDUAL * frames->n : NULL,
    };
    frames->n += frame->n;
}

/* The frames of these items, whose views may stand anywhere in the batch. */
static spin_status do_frames(struct spin_trainer *t, const struct batch *b, const int *first, int n)
{
    struct spin_device *d = t->device;
    struct spin_frame_batch frames = {0};

    for (int i = 0; i < n; i++)
        add_frame(t, &t->frame[b->items[first[i]].frame], &frames);
    t->field_eval.still = t->rates.position == 0;
    spin_field_forward(&t->field_eval, &t->field, t->table.p, t->heads.p, &frames);
    d->op->zero(d, t->field_eval.d_attr, frames.n * SPIN_ATTR * sizeof(float));
    d->op->zero(d, t->d_pos, frames.n * 3 * sizeof(float));
    SPIN_TRY(draw_frames(t, b, first, &frames));
    spin_field_backward(&t->field_eval, &t->field, t->table.p, t->heads.p, &frames, t->table.g,
                        t->heads.g);
    step_frames(t, b, first, &frames);
    return SPIN_OK;
}

/* ---- The step -------------------------------------------------------------------------------- */

static bool seen_before(const struct spin_train_item *items, int i)
{
    for (int j = 0; j < i; j++)
        if (items[j].frame == items[i].frame)
            return true;
    return false;
}

/* Groups of frames, in the order in which the items first show them. Frames without a splat have no part. */
static spin_status do_groups(struct spin_trainer *t, const struct batch *b)
{
    int at_once = t->device->frames_at_once, first[SPIN_MAX_FRAMES], n = 0;

    for (int i = 0; i < b->n; i++) {
        if (seen_before(b->items, i) || t->frame[b->items[i].frame].n == 0)
            continue;
        first[n++] = i;
        if (n == at_once || n == SPIN_MAX_FRAMES) {
            SPIN_TRY(do_frames(t, b, first, n));
            n = 0;
        }
    }
    return n > 0 ? do_frames(t, b, first, n) : SPIN_OK;
}

/* Adam for what all frames share. */
static void step_shared(struct spin_trainer *t)
{
    const size_t *offset = t->field.heads.offset;
    struct spin_device *d = t->device;
    struct spin_param_group group[SPIN_HEADS + 2];
    double lr = rate_at(t, t->rates.table, t->iteration);
    int n = 0;

    if (t->lazy)
        d->op->lazy_adam_step(d, t->lazy, lr);
    else
        group[n++] = spin_param_group(&t->table, 0, t->table.n, lr, t->iteration);
    for (int k = 0; k < SPIN_HEADS; k++)
        group[n++] = spin_param_group(&t->heads, offset[k], offset[k + 1],
                                      rate_at(t, t->rates.head[k], t->iteration), t->iteration);
    if (t->exposures.param.n)
        group[n++] = spin_param_group(&t->exposures.param, 0, t->exposures.param.n,
                                      rate_at(t, t->rates.exposure, t->iteration), t->iteration);
    d->op->adam(d, n, group);
    spin_exposures_centre(&t->exposures, d);
}

/* The step's one read-back. */
static spin_status read_values(struct spin_trainer *t, int n, struct spin_train_values *values)
{
    SPIN_TRY(
        t->device->op->download(t->device, t->host_values, t->values,
                                (size_t)t->n_drawn * SPIN_LOSS_VALUES * sizeof *t->host_values));
    values->seen = t->seen;
    for (int i = 0; i < t->n_drawn; i++) {
        const double *v = t->host_values + i * SPIN_LOSS_VALUES;

        values->loss += v[SPIN_LOSS] / n;
        values->l1 += v[SPIN_LOSS_L1] / n;
        values->ssim += v[SPIN_LOSS_SSIM] / n;
        if (values->each)
            values->each[t->drawn[i]] = v[SPIN_LOSS];
    }
    return SPIN_OK;
}

spin_status spin_trainer_step(struct spin_trainer *t, const struct spin_images *images,
                              const struct spin_train_item *items, int n,
                              struct spin_train_values *values)
{
    const struct batch b = {images, items, n};

    values->loss = values->l1 = values->ssim = 0;
    t->seen = false;
    t->n_drawn = 0;
    catch_up(t, t->iteration);
    t->iteration++;
    SPIN_TRY(do_groups(t, &b));
    step_shared(t);
    return read_values(t, n, values);
}
