/* Manages the state of a training between iterations: memory, learning rates and hash table. */
#include "train/trainer.h"

#include <math.h>
#include <string.h>

#include "base/base.h"
#include "math/adam.h"

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

/* Returns the largest number of floats that the frames of a batch can own together. */
static size_t own_floats(const struct spin_trainer *t)
{
    return (size_t)t->max_items * t->n_max * ((t->residuals ? 3 + SPIN_RESIDUAL : 3) + t->sh_width);
}

int spin_trainer_frames_at_once(const struct spin_trainer *t)
{
    return (int)smaller(t->device->frames_at_once, t->max_items);
}

/* Returns the largest number of splats that the device processes at once. */
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

/* Allocates the buffers for the splats that the device processes at once. */
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
    t->scratch = size->scratch;
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
        SPIN_TRY_OUT(spin_train_frame_open(&t->frame[f], device, t->scratch, size->frame[f],
                                           t->sh_width, t->tracked));
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
        /* Clear all gradients of residual values: if no tracks remain, iterations clear only the
         * gradients of values that splats own, so all other gradients would keep their old
         * values. */
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
    for (int f = 0; t->n_ranks > 1 && f < t->n_frames; f++) {
        const struct spin_train_frame *frame = &t->frame[f];

        if (!frame->statistics)
            continue;
        SPIN_TRY(spin_rank_sum(&t->rank_sum, frame->gradient, frame->size.n, SPIN_SUM_F32));
        SPIN_TRY(spin_rank_sum(&t->rank_sum, frame->seen, frame->size.n, SPIN_SUM_U32));
    }
    return SPIN_OK;
}

void spin_trainer_part_seen(struct spin_trainer *t)
{
    for (int f = 0; t->rank > 0 && f < t->n_frames; f++) {
        const struct spin_train_frame *frame = &t->frame[f];

        if (!frame->statistics)
            continue;
        t->device->op->zero(t->device, frame->gradient, frame->size.n * sizeof *frame->gradient);
        t->device->op->zero(t->device, frame->seen, frame->size.n * sizeof *frame->seen);
    }
}

void spin_trainer_drop_statistics(struct spin_trainer *t)
{
    for (int f = 0; f < t->n_frames; f++)
        spin_train_frame_drop_statistics(&t->frame[f], t->device);
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
    spin_pages_release(t->average.mean);
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
        t->device->op->lazy_adam_advance(t->device, t->lazy,
                                         spin_trainer_rate(t, t->rates.table, t->lazy->done + 1));
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

/* ---- All-reduce of device memory ------------------------------------------------------------- */

enum { FIRST_BYTES = 1 << 16 };

/* Ensures that the staging memory on the host has at least this size, and discards its contents. */
static spin_status need_host(struct spin_rank_sum *s, size_t bytes)
{
    const struct spin_device_ops *op = s->device->op;

    if (bytes <= s->host.bytes)
        return SPIN_OK;
    op->host_release(s->device, &s->host);
    return op->host_reserve(s->device, bytes + bytes / 8, &s->host);
}

spin_status spin_rank_sum_open(struct spin_rank_sum *s, struct spin_device *device)
{
    *s = (struct spin_rank_sum){.device = device};
    /* A device that only counts has no verb for host memory. */
    if (spin_n_ranks() == 1 || device->is_host || !device->op->host_reserve)
        return SPIN_OK;
    SPIN_TRY(need_host(s, FIRST_BYTES));
    spin_log(1, "all-reduce between GPUs uses %s host memory",
             s->host.pinned ? "page-locked" : "ordinary");
    return SPIN_OK;
}

void spin_rank_sum_close(struct spin_rank_sum *s)
{
    if (s->host.at)
        s->device->op->host_release(s->device, &s->host);
    *s = (struct spin_rank_sum){0};
}

spin_status spin_rank_sum(struct spin_rank_sum *s, void SPIN_DEV *at, size_t n, int kind)
{
    struct spin_device *d = s->device;
    void *host;

    if (spin_n_ranks() == 1 || n == 0)
        return SPIN_OK;
    SPIN_TRY(d->op->wait(d));
    host = d->op->host_view(d, at);
    if (host)
        return spin_ranks_sum(host, n, kind);
    SPIN_TRY(need_host(s, 4 * n));
    SPIN_TRY(d->op->download(d, s->host.at, at, 4 * n));
    SPIN_TRY(spin_ranks_sum(s->host.at, n, kind));
    d->op->upload(d, at, s->host.at, 4 * n);
    /* Wait for the upload before the next download overwrites the staging memory. */
    return d->op->wait(d);
}

/* ---- Exposure and falloff -------------------------------------------------------------------- */

spin_status spin_exposures_open(struct spin_exposures *t, struct spin_device *d, int n_cameras,
                                int n_lenses, const float *first, size_t pixels)
{
    size_t n = n_cameras == 0 ? 0 : SPIN_EXPOSURE * (size_t)(n_cameras + n_lenses);

    memset(t, 0, sizeof *t);
    SPIN_TRY(spin_param_open(&t->param, d, n, 0));
    if (n == 0)
        return SPIN_OK;
    d->op->upload(d, t->param.p, first, n * sizeof(float));
    t->n_cameras = (size_t)n_cameras;
    t->pixels = pixels;
    return d->op->reserve(d, 3 * pixels * sizeof(float), (void SPIN_DEV **)&t->exposed);
}

void spin_exposures_close(struct spin_exposures *t, struct spin_device *d)
{
    spin_param_close(&t->param, d);
    d->op->release(d, t->exposed);
    memset(t, 0, sizeof *t);
}

void spin_exposures_centre(struct spin_exposures *t, struct spin_device *d)
{
    if (t->param.n)
        d->op->exposure_centre(d, t->n_cameras, t->param.p);
}

spin_status spin_exposures_read_lenses(const struct spin_exposures *t, struct spin_device *d,
                                       struct spin_lenses *lenses)
{
    const float SPIN_DEV *row = t->param.p + SPIN_EXPOSURE * t->n_cameras;

    for (int i = 0; i < lenses->n && t->param.n; i++)
        SPIN_TRY(d->op->download(d, lenses->lens[i].falloff, row + SPIN_EXPOSURE * i,
                                 sizeof lenses->lens[i].falloff));
    return SPIN_OK;
}

/* ---- Parameters ------------------------------------------------------------------------------ */

spin_status spin_param_open(struct spin_param *param, struct spin_device *d, size_t n, size_t pad)
{
    float SPIN_DEV **at[4] = {&param->p, &param->g, &param->m, &param->v};

    memset(param, 0, sizeof *param);
    param->n = n;
    param->pad = pad;
    for (int i = 0; i < 4; i++) {
        SPIN_TRY(d->op->reserve(d, (n + pad) * sizeof(float), (void SPIN_DEV **)at[i]));
        *at[i] += pad;
    }
    return SPIN_OK;
}

void spin_param_close(struct spin_param *param, struct spin_device *d)
{
    float SPIN_DEV *at[4] = {param->p, param->g, param->m, param->v};

    for (int i = 0; i < 4; i++)
        if (at[i])
            d->op->release(d, at[i] - param->pad);
    memset(param, 0, sizeof *param);
}

struct spin_param_group spin_param_group(const struct spin_param *param, size_t first, size_t last,
                                         double lr, int64_t step)
{
    return (struct spin_param_group){.p = param->p + first,
                                     .g = param->g + first,
                                     .m = param->m + first,
                                     .v = param->v + first,
                                     .n = last - first,
                                     .lr = lr,
                                     .step = step};
}

/* ---- Lazy Adam ------------------------------------------------------------------------------- */

/* Lazy Adam stores step numbers as floats, which represent all integers up to this one exactly. */
static const int64_t most_steps = 1 << 24;

static size_t begin_of(const struct spin_field *field)
{
    return (size_t)field->grid.offset[spin_lazy_level(&field->grid)] *
           (size_t)field->grid.n_features;
}

size_t spin_lazy_lines(const struct spin_field *field)
{
    return (field->n_table - begin_of(field)) / SPIN_LINE;
}

size_t spin_lazy_pad(const struct spin_field *field)
{
    return (SPIN_LINE - begin_of(field) % SPIN_LINE) % SPIN_LINE;
}

/* A splat reads 16 rows of a level, one for each corner of a 4D cell. Corners that are adjacent
 * along x are often in the same line, so the 16 rows are in about 9 lines. */
bool spin_lazy_pays(const struct spin_field *field, double splats, int64_t steps)
{
    const struct spin_grid *grid = &field->grid;
    int level = spin_lazy_level(grid);
    double rows, lines;

    if (level == grid->n_levels || steps > most_steps || spin_lazy_lines(field) > UINT32_MAX)
        return false;
    rows = (double)grid->offset[level + 1] - grid->offset[level];
    lines = rows * grid->n_features / SPIN_LINE;
    return lines >= 1 && fmod(rows * grid->n_features, SPIN_LINE) == 0 &&
           1 - exp(-9 * splats / lines) < 0.5;
}
