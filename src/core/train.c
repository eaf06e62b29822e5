/* The training step. Gradients of table and heads gather over the batch; positions of a frame are
 * finished as soon as its last picture is. */
#include "core/train.h"

#include <stdlib.h>
#include <string.h>

#include "base/err.h"
#include "base/mem.h"
#include "core/ops.h"
#include "math/adam.h"

static spin_status reserve(struct spin_device *d, size_t floats, float **out)
{
    return d->op->reserve(d, floats * sizeof(float), (void **)out);
}

size_t spin_trainer_bytes(const struct spin_model *model, int n_frames, const size_t *counts,
                          size_t max_pixels, bool own)
{
    size_t points = 0, n_max = 0, width = own ? 3 + SPIN_OWN : 3;

    for (int f = 0; f < n_frames; f++) {
        points += counts[f];
        n_max = counts[f] > n_max ? counts[f] : n_max;
    }
    return (4 * (model->n_table + model->n_heads) + width * (3 * points + n_max)) * sizeof(float) +
           spin_decode_bytes(model, n_max, true) + spin_raster_bytes(n_max, max_pixels, true);
}

spin_status spin_trainer_open(struct spin_trainer *t, struct spin_device *device,
                              const struct spin_model *model, int n_frames, const size_t *counts,
                              size_t max_pixels, size_t max_tiles, int n_tints, bool own)
{
    spin_status status;
    void *block = NULL;

    memset(t, 0, sizeof *t);
    t->device = device;
    t->model = *model;
    t->max_pixels = max_pixels;
    t->max_tiles = max_tiles;
    SPIN_TRY_OUT(spin_alloc((size_t)n_frames, sizeof *t->frame, &block));
    t->frame = block;
    t->n_frames = n_frames;
    SPIN_TRY_OUT(spin_param_open(&t->table, device, model->n_table, spin_lazy_pad(model)));
    SPIN_TRY_OUT(spin_param_open(&t->heads, device, model->n_heads, 0));
    SPIN_TRY_OUT(spin_tints_open(&t->tints, device, n_tints, max_pixels));
    for (int f = 0; f < n_frames; f++) {
        struct spin_train_frame *frame = &t->frame[f];

        frame->n = counts[f];
        t->n_max = counts[f] > t->n_max ? counts[f] : t->n_max;
        SPIN_TRY_OUT(reserve(device, frame->n * 3, &frame->pos));
        SPIN_TRY_OUT(reserve(device, frame->n * 3, &frame->m));
        SPIN_TRY_OUT(reserve(device, frame->n * 3, &frame->v));
        if (!own)
            continue;
        SPIN_TRY_OUT(reserve(device, frame->n * SPIN_OWN, &frame->own));
        SPIN_TRY_OUT(reserve(device, frame->n * SPIN_OWN, &frame->own_m));
        SPIN_TRY_OUT(reserve(device, frame->n * SPIN_OWN, &frame->own_v));
    }
    SPIN_TRY_OUT(reserve(device, t->n_max * 3, &t->d_pos));
    if (own)
        SPIN_TRY_OUT(reserve(device, t->n_max * SPIN_OWN, &t->d_own));
    SPIN_TRY_OUT(spin_decode_open(&t->decode, device, model, t->n_max, true));
    SPIN_TRY_OUT(spin_raster_open(&t->raster, device, t->n_max, max_pixels, max_tiles, true));
    return SPIN_OK;
out:
    spin_trainer_close(t);
    return status;
}

spin_status spin_trainer_be_lazy(struct spin_trainer *t)
{
    SPIN_TRY(spin_lazy_open(&t->lazy, t->device, &t->model, t->rates.iterations));
    t->decode.lazy = &t->lazy.lazy;
    t->decode.m = t->table.m;
    t->decode.v = t->table.v;
    return SPIN_OK;
}

void spin_trainer_close(struct spin_trainer *t)
{
    struct spin_device *d = t->device;

    if (!d)
        return;
    spin_lazy_close(&t->lazy, d);
    spin_param_close(&t->table, d);
    spin_param_close(&t->heads, d);
    spin_tints_close(&t->tints, d);
    for (int f = 0; f < t->n_frames; f++) {
        struct spin_train_frame *frame = &t->frame[f];

        d->op->release(d, frame->pos, frame->n * 3 * sizeof(float));
        d->op->release(d, frame->m, frame->n * 3 * sizeof(float));
        d->op->release(d, frame->v, frame->n * 3 * sizeof(float));
        d->op->release(d, frame->own, frame->n * SPIN_OWN * sizeof(float));
        d->op->release(d, frame->own_m, frame->n * SPIN_OWN * sizeof(float));
        d->op->release(d, frame->own_v, frame->n * SPIN_OWN * sizeof(float));
    }
    d->op->release(d, t->d_pos, t->n_max * 3 * sizeof(float));
    d->op->release(d, t->d_own, t->n_max * SPIN_OWN * sizeof(float));
    spin_decode_close(&t->decode, &t->model);
    spin_raster_close(&t->raster);
    free(t->frame);
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

    if (t->sh_every <= 0 || begun / t->sh_every >= t->model.sh_degree)
        return t->model.sh_degree;
    return (int)(begun / t->sh_every);
}

/* Render one item, add its loss to values and its gradient to d_attr and d_pos. */
static spin_status draw_item(struct spin_trainer *t, const struct spin_train_item *item, int n,
                             struct spin_train_values *values, double *loss)
{
    const struct spin_train_frame *frame = &t->frame[item->frame];
    struct spin_cam cam = spin_cam_from(item->taken.camera);
    int sh_degree = spin_trainer_sh_degree(t);
    double v[3];

    cam.antialias = t->model.antialias;
    SPIN_TRY(spin_raster_forward(&t->raster, &cam, frame->n, frame->pos, t->decode.attr, sh_degree,
                                 t->background));
    values->seen |= t->raster.tiles.n_pairs > 0;
    spin_tints_loss(&t->tints, &t->raster, &item->taken, t->lambda_dssim, 1.0f / (float)n, v);
    spin_raster_backward(&t->raster, &cam, frame->n, frame->pos, t->decode.attr, sh_degree,
                         t->background, t->decode.d_attr, t->d_pos);
    values->loss += v[0] / n;
    values->l1 += v[1] / n;
    values->ssim += v[2] / n;
    *loss = v[0];
    return SPIN_OK;
}

/* After a resume the numbers of the steps before it are made again. */
static void catch_up(struct spin_trainer *t, int64_t done)
{
    while (t->lazy.lazy.last && t->lazy.lazy.done < done)
        spin_lazy_did(&t->lazy, rate_at(t, t->rates.table, t->lazy.lazy.done + 1));
}

static void step_table(struct spin_trainer *t)
{
    struct spin_device *d = t->device;
    struct spin_param *p = &t->table;
    double lr = rate_at(t, t->rates.table, t->iteration);

    if (!t->lazy.lazy.last) {
        SPIN_TIMED(d, SPIN_OP_ADAM, d->op->adam(d, p->n, p->p, p->g, p->m, p->v, lr, t->iteration));
        return;
    }
    SPIN_TIMED(
        d, SPIN_OP_ADAM,
        d->op->adam_lazy(d, &t->model.grid, &t->lazy.lazy, p->n, p->p, p->g, p->m, p->v, lr));
    spin_lazy_did(&t->lazy, lr);
}

float *spin_trainer_take_table(struct spin_trainer *t)
{
    struct spin_device *d = t->device;
    struct spin_param *p = &t->table;

    if (!t->lazy.lazy.last)
        return p->p;
    catch_up(t, t->iteration);
    d->op->settle(d, &t->model.grid, &t->lazy.lazy, p->n, p->p, p->m, p->v, p->g);
    return p->g;
}

void spin_trainer_put_back(struct spin_trainer *t)
{
    if (t->lazy.lazy.last)
        t->device->op->zero(t->device, t->table.g, t->table.n * sizeof(float));
}

static void step_param(struct spin_trainer *t, struct spin_param *param, size_t first, size_t last,
                       double lr0)
{
    double lr = rate_at(t, lr0, t->iteration);

    SPIN_TIMED(t->device, SPIN_OP_ADAM,
               t->device->op->adam(t->device, last - first, param->p + first, param->g + first,
                                   param->m + first, param->v + first, lr, t->iteration));
}

/* A splat's own values, each group at its rate. */
static void step_own(struct spin_trainer *t, struct spin_train_frame *frame)
{
    static const size_t width[SPIN_HEADS] = {3, 4, 3, 1};
    struct spin_device *d = t->device;

    for (size_t k = 0, at = 0; k < SPIN_HEADS; at += width[k++] * frame->n)
        SPIN_TIMED(d, SPIN_OP_ADAM,
                   d->op->adam(d, width[k] * frame->n, frame->own + at, t->d_own + at,
                               frame->own_m + at, frame->own_v + at,
                               rate_at(t, t->rates.own[k], t->iteration), frame->steps));
}

static void clear(struct spin_trainer *t, size_t n)
{
    t->device->op->zero(t->device, t->decode.d_attr, n * SPIN_ATTR * sizeof(float));
    t->device->op->zero(t->device, t->d_pos, n * 3 * sizeof(float));
}

/* All pictures of one frame, and the step of its positions. */
static spin_status do_frame(struct spin_trainer *t, const struct spin_train_item *items, int n,
                            int first, struct spin_train_values *values)
{
    struct spin_device *d = t->device;
    const struct spin_train_rates *r = &t->rates;
    struct spin_train_frame *frame = &t->frame[items[first].frame];
    float share = 0; /* of the batch's pictures */
    bool own = frame->own && r->own[SPIN_HEAD_SCALE] > 0;

    if (frame->n == 0)
        return SPIN_OK;
    spin_decode_forward(&t->decode, &t->model, t->table.p, t->heads.p, frame->n, frame->pos,
                        spin_model_time(&t->model, frame->time), frame->own);
    SPIN_TIMED(d, SPIN_OP_CLEAR, clear(t, frame->n));
    for (int i = first; i < n; i++) {
        double loss;

        if (items[i].frame != items[first].frame)
            continue;
        SPIN_TRY(draw_item(t, &items[i], n, values, &loss));
        if (values->each)
            values->each[i] = loss;
        share += 1.0f / (float)n;
    }
    t->decode.still = r->position == 0;
    t->decode.d_scale = share * t->lambda_scale / (3 * (float)frame->n);
    t->decode.d_opacity = share * t->lambda_opacity / (float)frame->n;
    spin_decode_backward(&t->decode, &t->model, t->table.p, t->heads.p, frame->n, frame->pos,
                         t->table.g, t->heads.g, t->d_pos, own ? t->d_own : NULL);
    frame->steps++;
    if (own)
        step_own(t, frame);
    if (t->decode.still)
        return SPIN_OK;
    SPIN_TIMED(d, SPIN_OP_ADAM,
               d->op->adam(d, frame->n * 3, frame->pos, t->d_pos, frame->m, frame->v,
                           rate_at(t, r->position, t->iteration), frame->steps));
    return SPIN_OK;
}

static bool seen_before(const struct spin_train_item *items, int i)
{
    for (int j = 0; j < i; j++)
        if (items[j].frame == items[i].frame)
            return true;
    return false;
}

spin_status spin_trainer_step(struct spin_trainer *t, const struct spin_train_item *items, int n,
                              struct spin_train_values *values)
{
    const size_t *offset = t->model.heads.offset;

    values->loss = values->l1 = values->ssim = 0;
    values->seen = false;
    catch_up(t, t->iteration);
    t->iteration++;
    for (int i = 0; i < n; i++)
        if (!seen_before(items, i))
            SPIN_TRY(do_frame(t, items, n, i, values));
    step_table(t);
    for (int k = 0; k < SPIN_HEADS; k++)
        step_param(t, &t->heads, offset[k], offset[k + 1], t->rates.head[k]);
    spin_tints_step(&t->tints, t->device, rate_at(t, t->rates.tint, t->iteration), t->iteration);
    return t->device->op->wait(t->device);
}
