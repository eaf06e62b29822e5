/* The training step. Gradients of table and heads gather over the batch; positions of a frame are
 * finished as soon as its last picture is. */
#include "train/step.h"

#include <stdlib.h>
#include <string.h>

#include "base/err.h"
#include "base/mem.h"
#include "device/clock.h"
#include "math/adam.h"

static spin_status reserve(struct spin_device *d, size_t floats, float **out)
{
    return d->op->reserve(d, floats * sizeof(float), (void **)out);
}

size_t spin_trainer_bytes(const struct spin_field *field, int n_frames, const size_t *counts,
                          size_t max_pixels, bool residual)
{
    size_t points = 0, n_max = 0, width = residual ? 3 + SPIN_RESIDUAL : 3;

    for (int f = 0; f < n_frames; f++) {
        points += counts[f];
        n_max = counts[f] > n_max ? counts[f] : n_max;
    }
    return (4 * (field->n_table + field->n_heads) + width * (3 * points + n_max)) * sizeof(float) +
           spin_field_eval_bytes(field, n_max, true) + spin_raster_bytes(n_max, max_pixels, true);
}

spin_status spin_trainer_open(struct spin_trainer *t, struct spin_device *device,
                              const struct spin_field *field, int n_frames, const size_t *counts,
                              size_t max_pixels, size_t max_tiles, int n_exposures, bool residual)
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
    SPIN_TRY_OUT(spin_param_open(&t->table, device, field->n_table, spin_lazy_pad(field)));
    SPIN_TRY_OUT(spin_param_open(&t->heads, device, field->n_heads, 0));
    SPIN_TRY_OUT(spin_exposures_open(&t->exposures, device, n_exposures, max_pixels));
    for (int f = 0; f < n_frames; f++) {
        struct spin_train_frame *frame = &t->frame[f];

        frame->n = counts[f];
        t->n_max = counts[f] > t->n_max ? counts[f] : t->n_max;
        SPIN_TRY_OUT(reserve(device, frame->n * 3, &frame->pos));
        SPIN_TRY_OUT(reserve(device, frame->n * 3, &frame->m));
        SPIN_TRY_OUT(reserve(device, frame->n * 3, &frame->v));
        if (!residual)
            continue;
        SPIN_TRY_OUT(reserve(device, frame->n * SPIN_RESIDUAL, &frame->residual));
        SPIN_TRY_OUT(reserve(device, frame->n * SPIN_RESIDUAL, &frame->residual_m));
        SPIN_TRY_OUT(reserve(device, frame->n * SPIN_RESIDUAL, &frame->residual_v));
    }
    SPIN_TRY_OUT(reserve(device, t->n_max * 3, &t->d_pos));
    if (residual)
        SPIN_TRY_OUT(reserve(device, t->n_max * SPIN_RESIDUAL, &t->d_residual));
    SPIN_TRY_OUT(spin_field_eval_open(&t->field_eval, device, field, t->n_max, true));
    SPIN_TRY_OUT(spin_raster_open(&t->raster, device, t->n_max, max_pixels, max_tiles, true));
    return SPIN_OK;
out:
    spin_trainer_close(t);
    return status;
}

spin_status spin_trainer_enable_lazy_adam(struct spin_trainer *t)
{
    SPIN_TRY(spin_lazy_enable(&t->lazy, t->device, &t->field, t->rates.iterations));
    t->field_eval.lazy = &t->lazy.lazy;
    t->field_eval.m = t->table.m;
    t->field_eval.v = t->table.v;
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
    spin_exposures_close(&t->exposures, d);
    for (int f = 0; f < t->n_frames; f++) {
        struct spin_train_frame *frame = &t->frame[f];

        d->op->release(d, frame->pos, frame->n * 3 * sizeof(float));
        d->op->release(d, frame->m, frame->n * 3 * sizeof(float));
        d->op->release(d, frame->v, frame->n * 3 * sizeof(float));
        d->op->release(d, frame->residual, frame->n * SPIN_RESIDUAL * sizeof(float));
        d->op->release(d, frame->residual_m, frame->n * SPIN_RESIDUAL * sizeof(float));
        d->op->release(d, frame->residual_v, frame->n * SPIN_RESIDUAL * sizeof(float));
    }
    d->op->release(d, t->d_pos, t->n_max * 3 * sizeof(float));
    d->op->release(d, t->d_residual, t->n_max * SPIN_RESIDUAL * sizeof(float));
    spin_field_eval_close(&t->field_eval, &t->field);
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

    if (t->sh_increase_every <= 0 || begun / t->sh_increase_every >= t->field.sh_degree)
        return t->field.sh_degree;
    return (int)(begun / t->sh_increase_every);
}

/* Render one item, add its loss to values and its gradient to d_attr and d_pos. */
static spin_status draw_item(struct spin_trainer *t, const struct spin_train_item *item, int n,
                             struct spin_train_values *values, double *loss)
{
    const struct spin_train_frame *frame = &t->frame[item->frame];
    struct spin_camera_f32 cam = spin_camera_f32_from(item->taken.camera);
    int sh_degree = spin_trainer_sh_degree(t);
    double v[3];

    cam.antialias = t->field.antialias;
    SPIN_TRY(spin_raster_forward(&t->raster, &cam, frame->n, frame->pos, t->field_eval.attr,
                                 sh_degree, t->background));
    values->seen |= t->raster.tiles.n_intersections > 0;
    spin_image_loss(&t->exposures, &t->raster, &item->taken, t->lambda_dssim, 1.0f / (float)n, v);
    spin_raster_backward(&t->raster, &cam, frame->n, frame->pos, t->field_eval.attr, sh_degree,
                         t->background, t->field_eval.d_attr, t->d_pos);
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
        spin_lazy_advance(&t->lazy, rate_at(t, t->rates.table, t->lazy.lazy.done + 1));
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
        d->op->lazy_adam(d, &t->field.grid, &t->lazy.lazy, p->n, p->p, p->g, p->m, p->v, lr));
    spin_lazy_advance(&t->lazy, lr);
}

float *spin_trainer_take_table(struct spin_trainer *t)
{
    struct spin_device *d = t->device;
    struct spin_param *p = &t->table;

    if (!t->lazy.lazy.last)
        return p->p;
    catch_up(t, t->iteration);
    d->op->lazy_flush(d, &t->field.grid, &t->lazy.lazy, p->n, p->p, p->m, p->v, p->g);
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
                   d->op->adam(d, width[k] * frame->n, frame->residual + at, t->d_residual + at,
                               frame->residual_m + at, frame->residual_v + at,
                               rate_at(t, t->rates.residual[k], t->iteration), frame->steps));
}

static void clear(struct spin_trainer *t, size_t n)
{
    t->device->op->zero(t->device, t->field_eval.d_attr, n * SPIN_ATTR * sizeof(float));
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
    bool residual = frame->residual && r->residual[SPIN_HEAD_SCALE] > 0;

    if (frame->n == 0)
        return SPIN_OK;
    spin_field_forward(&t->field_eval, &t->field, t->table.p, t->heads.p, frame->n, frame->pos,
                       spin_field_time(&t->field, frame->time), frame->residual);
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
    t->field_eval.still = r->position == 0;
    t->field_eval.d_scale = share * t->lambda_scale / (3 * (float)frame->n);
    t->field_eval.d_opacity = share * t->lambda_opacity / (float)frame->n;
    spin_field_backward(&t->field_eval, &t->field, t->table.p, t->heads.p, frame->n, frame->pos,
                        t->table.g, t->heads.g, t->d_pos, residual ? t->d_residual : NULL);
    frame->steps++;
    if (residual)
        step_own(t, frame);
    if (t->field_eval.still)
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
    const size_t *offset = t->field.heads.offset;

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
    spin_exposures_step(&t->exposures, t->device, rate_at(t, t->rates.exposure, t->iteration),
                        t->iteration);
    return t->device->op->wait(t->device);
}
