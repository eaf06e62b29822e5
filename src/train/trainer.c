/* Manages the state of a training between iterations: its memory, its learning rates and the hash
 * table. */
#include "train/trainer.h"

#include "base/base.h"
#include "math/adam.h"
#include "train/lazy_adam.h"

static spin_status reserve_floats(struct spin_device *d, size_t floats, float SPIN_DEV **out)
{
    return d->op->reserve(d, floats * sizeof(float), (void SPIN_DEV **)out);
}

static size_t most_splats(const struct spin_trainer_size *size)
{
    size_t most = 0;

    for (int f = 0; f < size->n_frames; f++)
        most = size->frame[f].n > most ? size->frame[f].n : most;
    return most;
}

/* True if splats or tracks have residual values. */
static bool has_residual(const struct spin_trainer_size *size)
{
    size_t sum = size->n_tracks;

    for (int f = 0; f < size->n_frames; f++)
        sum += size->frame[f].n_residual;
    return sum > 0;
}

static size_t smaller(int a, int b) { return (size_t)(a < b ? a : b); }

/* Returns the largest number of floats that the frames of a batch can own. */
static size_t own_floats(const struct spin_trainer *t)
{
    return (size_t)t->max_items * t->n_max * ((t->residuals ? 3 + SPIN_RESIDUAL : 3) + t->sh_width);
}

int spin_trainer_frames_at_once(const struct spin_trainer *t)
{
    return (int)smaller(t->device->frames_at_once, t->max_items);
}

/* Returns the largest number of splats that the device processes together. */
static size_t splats_at_once(const struct spin_trainer *t)
{
    return t->n_max * (size_t)spin_trainer_frames_at_once(t);
}

static spin_status open_values(struct spin_trainer *t, int max_items)
{
    size_t n = (size_t)max_items;

    t->max_items = max_items;
    SPIN_TRY(spin_alloc(n, SPIN_LOSS_VALUES * sizeof *t->host_values, (void **)&t->host_values));
    SPIN_TRY(spin_alloc(n, sizeof *t->drawn, (void **)&t->drawn));
    return t->device->op->reserve(t->device, n * SPIN_LOSS_VALUES * sizeof *t->values,
                                  (void SPIN_DEV **)&t->values);
}

static void close_buffers(struct spin_trainer *t)
{
    struct spin_device *d = t->device;

    d->op->release(d, t->d_pos);
    d->op->release(d, t->d_residual);
    d->op->release(d, t->d_sh);
    d->op->release(d, t->means);
    d->op->release(d, t->residual);
    d->op->release(d, t->own_grad);
    t->d_pos = t->d_residual = t->d_sh = t->means = t->residual = t->own_grad = NULL;
    spin_field_eval_close(&t->field_eval, t->network);
    spin_raster_close(&t->raster);
}

/* Allocates the buffers for the splats that the device processes together. */
static spin_status open_buffers(struct spin_trainer *t)
{
    struct spin_device *d = t->device;
    size_t n = splats_at_once(t);

    SPIN_TRY(reserve_floats(d, n * 3, &t->d_pos));
    if (t->residuals)
        SPIN_TRY(reserve_floats(d, n * SPIN_RESIDUAL, &t->d_residual));
    if (t->sh_width > 0)
        SPIN_TRY(reserve_floats(d, n * t->sh_width, &t->d_sh));
    if (t->n_tracks > 0) {
        SPIN_TRY(reserve_floats(d, n * 3, &t->means));
        SPIN_TRY(reserve_floats(d, n * SPIN_RESIDUAL, &t->residual));
    }
    if (t->n_ranks > 1)
        SPIN_TRY(reserve_floats(d, own_floats(t), &t->own_grad));
    SPIN_TRY(spin_field_eval_open(&t->field_eval, d, t->network, t->sh_width > 0, n, true));
    return spin_raster_open(&t->raster, d, t->n_max, t->max_pixels, t->max_tiles,
                            (int)smaller(d->views_at_once, t->max_items), true);
}

spin_status spin_trainer_open(struct spin_trainer *t, struct spin_device *device,
                              const struct spin_field *field, const struct spin_trainer_size *size)
{
    spin_status status;

    memset(t, 0, sizeof *t);
    t->device = device;
    t->field = *field;
    t->network = size->network ? &t->field : NULL;
    t->max_pixels = size->max_pixels;
    t->max_tiles = size->max_tiles;
    t->tracked = size->tracked;
    t->n_tracks = size->n_tracks;
    t->n_moving = size->n_moving;
    t->n_varying = size->n_varying;
    t->n_backdrop = size->n_backdrop;
    t->residuals = has_residual(size);
    t->sh_degree = size->sh_degree;
    t->sh_width = spin_column_width(SPIN_COL_SH, size->sh_degree) - 3;
    t->rank = size->alone ? 0 : spin_rank();
    t->n_ranks = size->alone ? 1 : spin_n_ranks();
    t->n_max = most_splats(size);
    SPIN_TRY_OUT(spin_alloc((size_t)size->n_frames, sizeof *t->frame, (void **)&t->frame));
    t->n_frames = size->n_frames;
    SPIN_TRY_OUT(open_values(t, size->max_items));
    SPIN_TRY_OUT(
        spin_param_open(&t->table, device, t->network ? field->n_table : 0, spin_lazy_pad(field)));
    SPIN_TRY_OUT(spin_param_open(&t->heads, device, t->network ? field->n_heads : 0, 0));
    SPIN_TRY_OUT(spin_param_open(&t->tracks, device, SPIN_TRACK * t->n_tracks, 0));
    if (size->motion)
        SPIN_TRY_OUT(reserve_floats(device, SPIN_MOTION * t->n_tracks, &t->motion));
    SPIN_TRY_OUT(spin_exposures_open(&t->exposures, device, size->n_cameras, size->n_lenses,
                                     size->exposure,
                                     t->max_pixels * smaller(device->views_at_once, t->max_items)));
    for (int f = 0; f < t->n_frames; f++)
        SPIN_TRY_OUT(
            spin_train_frame_open(&t->frame[f], device, size->frame[f], t->sh_width, t->tracked));
    SPIN_TRY_OUT(open_buffers(t));
    if (t->n_ranks > 1)
        SPIN_TRY_OUT(spin_rank_sum_open(&t->rank_sum, device));
    return SPIN_OK;
out:
    spin_trainer_close(t);
    return status;
}

spin_status spin_trainer_resize(struct spin_trainer *t)
{
    size_t n = 0;

    for (int f = 0; f < t->n_frames; f++)
        n = t->frame[f].size.n > n ? t->frame[f].size.n : n;
    if (n <= t->n_max) {
        /* Clear the gradients of residual values. If no tracks are left, an iteration clears only
         * those of values that splats own, and others would stay nonzero. */
        if (t->d_residual)
            t->device->op->zero(t->device, t->d_residual,
                                splats_at_once(t) * SPIN_RESIDUAL * sizeof(float));
        return SPIN_OK;
    }
    close_buffers(t);
    t->n_max = n + n / 4;
    SPIN_TRY(open_buffers(t));
    t->field_eval.lazy = t->lazy;
    return SPIN_OK;
}

/* ---- Statistics for densification ------------------------------------------------------------ */

spin_status spin_trainer_join_seen(struct spin_trainer *t)
{
    for (int f = 0; t->n_ranks > 1 && t->tracked && f < t->n_frames; f++) {
        const struct spin_train_frame *frame = &t->frame[f];

        SPIN_TRY(spin_rank_sum(&t->rank_sum, frame->gradient, frame->size.n, SPIN_SUM_F32));
        SPIN_TRY(spin_rank_sum(&t->rank_sum, frame->seen, frame->size.n, SPIN_SUM_U32));
    }
    return SPIN_OK;
}

void spin_trainer_part_seen(struct spin_trainer *t)
{
    for (int f = 0; t->tracked && t->rank > 0 && f < t->n_frames; f++) {
        const struct spin_train_frame *frame = &t->frame[f];

        t->device->op->zero(t->device, frame->gradient, frame->size.n * sizeof *frame->gradient);
        t->device->op->zero(t->device, frame->seen, frame->size.n * sizeof *frame->seen);
    }
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
    close_buffers(t);
    d->op->release(d, t->values);
    spin_param_close(&t->table, d);
    spin_param_close(&t->heads, d);
    spin_param_close(&t->tracks, d);
    d->op->release(d, t->motion);
    spin_exposures_close(&t->exposures, d);
    free(t->average.mean);
    for (int f = 0; f < t->n_frames; f++)
        spin_train_frame_close(&t->frame[f], d);
    free(t->frame);
    free(t->host_values);
    free(t->drawn);
    spin_rank_sum_close(&t->rank_sum);
    memset(t, 0, sizeof *t);
}

const double spin_rate_3dgs[SPIN_HEADS] = {5e-3, 1e-3, 2.5e-3, 0.05};

struct spin_train_rates spin_rates_3dgs(double extent, int iterations)
{
    struct spin_train_rates rates = {.position = 1.6e-4 * extent,
                                     .position_end = 1.6e-6 * extent,
                                     .sh = spin_rate_3dgs[SPIN_HEAD_SH] / 20,
                                     .tracked = 1,
                                     .lenses_stay = true,
                                     .iterations = iterations};

    memcpy(rates.residual, spin_rate_3dgs, sizeof rates.residual);
    return rates;
}

double spin_trainer_rate(const struct spin_trainer *t, double lr0, int64_t iteration)
{
    const struct spin_train_rates *r = &t->rates;

    if (r->position_end > 0)
        return lr0;
    return spin_lr(lr0, fmax(r->end, r->floor * lr0), iteration, r->warmup, r->iterations);
}

double spin_trainer_position_rate(const struct spin_trainer *t)
{
    const struct spin_train_rates *r = &t->rates;

    if (r->position == 0)
        return 0;
    return r->position_end > 0
               ? spin_lr_exp(r->position, r->position_end, t->iteration, r->iterations)
               : spin_trainer_rate(t, r->position, t->iteration);
}

double spin_trainer_track_rate(const struct spin_trainer *t, double lr0)
{
    const struct spin_train_rates *r = &t->rates;

    if (r->track_iterations == r->iterations)
        return spin_trainer_rate(t, lr0, t->iteration);
    if (t->iteration >= r->track_iterations)
        return r->end;
    return spin_lr(lr0, r->end, t->iteration, r->warmup, r->track_iterations);
}

int spin_trainer_sh_degree(const struct spin_trainer *t)
{
    int64_t begun = t->iteration > 0 ? t->iteration - 1 : 0;
    int most = t->network ? t->field.sh_degree : t->sh_degree;

    if (t->sh_increase_every <= 0 || begun / t->sh_increase_every >= most)
        return most;
    return (int)(begun / t->sh_increase_every);
}

/* ---- The table ------------------------------------------------------------------------------- */

void spin_trainer_catch_up(struct spin_trainer *t, int64_t done)
{
    while (t->lazy && t->lazy->done < done)
        t->device->op->lazy_adam_advance(
            t->device, t->lazy, spin_trainer_rate(t, t->rates.table, t->lazy->done + 1));
}

float SPIN_DEV *spin_trainer_take_table(struct spin_trainer *t)
{
    if (!t->lazy)
        return t->table.p;
    spin_trainer_catch_up(t, t->iteration);
    t->device->op->lazy_adam_flush(t->device, t->lazy, t->table.g);
    return t->table.g;
}

void spin_trainer_put_back(struct spin_trainer *t)
{
    if (t->lazy)
        t->device->op->zero(t->device, t->table.g, t->table.n * sizeof(float));
}
