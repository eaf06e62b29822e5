/* What a training keeps between steps: its memory, its rates, and the table as it is now. */
#include "train/trainer.h"

#include <stdlib.h>
#include <string.h>

#include "base/err.h"
#include "base/log.h"
#include "base/mem.h"
#include "io/ranks.h"
#include "math/adam.h"
#include "train/lazy_adam.h"

static spin_status reserve(struct spin_device *d, size_t floats, float SPIN_DEV **out)
{
    return d->op->reserve(d, floats * sizeof(float), (void SPIN_DEV **)out);
}

static void copy(struct spin_device *d, float SPIN_DEV *to, const float SPIN_DEV *from, size_t n)
{
    d->op->copy_rows(d, 1, n, from, n, to, n);
}

static size_t most_splats(const struct spin_trainer_size *size)
{
    size_t most = 0;

    for (int f = 0; f < size->n_frames; f++)
        most = size->frame[f].n > most ? size->frame[f].n : most;
    return most;
}

/* Splats have values besides the network's. */
static bool has_residual(const struct spin_trainer_size *size)
{
    size_t sum = size->n_tracks;

    for (int f = 0; f < size->n_frames; f++)
        sum += size->frame[f].n_residual;
    return sum > 0;
}

static size_t smaller(int a, int b) { return (size_t)(a < b ? a : b); }

/* Memory of step_ranks.c and of what goes with it, at most. */
static size_t round_floats(const struct spin_field *field, const struct spin_trainer_size *size,
                           size_t n)
{
    size_t frames = smaller(spin_n_ranks(), size->max_items), floats, width = 0, most = 0, all = 0;
    size_t own = size->tracked ? SPIN_TRACK + 2 : has_residual(size) ? SPIN_TRACK : 3;

    floats = (2 * frames + 2) * n * own; /* values, gradients; frames that visit or are lent */
    for (int r = 0; r < spin_n_ranks() && size->network; r++) {
        struct spin_levels of = spin_share_levels(&field->grid, r, spin_n_ranks());
        struct spin_levels branch[SPIN_MAX_LEVELS];
        size_t features = (size_t)((of.end - of.first) * field->grid.n_features);
        size_t branches = (size_t)spin_share_branches(field->grid.n_levels, of, branch);

        width = features > width ? features : width;
        most = branches > most ? branches : most;
        all += branches;
    }
    if (size->network) { /* features and their gradients both ways, rows, branches; the table as a whole; heads */
        width =
            frames * width > (size_t)field->heads.n_in ? frames * width : (size_t)field->heads.n_in;
        floats += (2 * width + frames + 4 * (all + frames * most)) * n + field->n_table +
                  (2 + frames) * field->n_heads;
    }
    return floats + floats / 8;
}

size_t spin_trainer_bytes(const struct spin_device *device, const struct spin_field *field,
                          const struct spin_trainer_size *size)
{
    size_t views = smaller(device->views_at_once, size->max_items), one = most_splats(size);
    size_t n = one * smaller(device->frames_at_once, size->max_items);
    size_t floats = 4 * SPIN_TRACK * size->n_tracks;

    for (int f = 0; f < size->n_frames; f++)
        floats += 3 * (3 * size->frame[f].n_pos + SPIN_RESIDUAL * size->frame[f].n_residual) +
                  (size->tracked ? 3 * size->frame[f].n : 0);
    floats += (has_residual(size) ? SPIN_TRACK : 3) * n * (size->tracked ? 2 : 1);
    if (size->network)
        floats += 4 * (spin_share_most(&field->grid) + field->n_heads);
    if (spin_n_ranks() > 1)
        floats += round_floats(field, size, one);
    return floats * sizeof(float) + spin_field_eval_bytes(size->network ? field : NULL, n, true) +
           views * spin_raster_bytes(one, size->max_pixels, true);
}

int spin_trainer_frames_at_once(const struct spin_trainer *t)
{
    return (int)smaller(t->device->frames_at_once, t->max_items);
}

/* Splats of the frames that go through the device together, at most. */
static size_t splats_at_once(const struct spin_trainer *t)
{
    return t->n_max * (size_t)spin_trainer_frames_at_once(t);
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

static void close_buffers(struct spin_trainer *t)
{
    struct spin_device *d = t->device;
    size_t n = splats_at_once(t);

    d->op->release(d, t->d_pos, n * 3 * sizeof(float));
    d->op->release(d, t->d_residual, n * SPIN_RESIDUAL * sizeof(float));
    d->op->release(d, t->means, n * 3 * sizeof(float));
    d->op->release(d, t->residual, n * SPIN_RESIDUAL * sizeof(float));
    d->op->release(d, t->visit_pos, t->n_max * 3 * sizeof(float));
    d->op->release(d, t->visit_residual, t->n_max * SPIN_RESIDUAL * sizeof(float));
    d->op->release(d, t->visit_gradient, t->n_max * sizeof(float));
    d->op->release(d, t->visit_seen, t->n_max * sizeof(uint32_t));
    t->d_pos = t->d_residual = t->means = t->residual = t->visit_pos = t->visit_residual = NULL;
    t->visit_gradient = NULL;
    t->visit_seen = NULL;
    spin_field_eval_close(&t->field_eval, t->network);
    spin_raster_close(&t->raster);
}

/* Buffers of the splats that go through the device together. */
static spin_status open_buffers(struct spin_trainer *t)
{
    struct spin_device *d = t->device;
    size_t n = splats_at_once(t);

    SPIN_TRY(reserve(d, n * 3, &t->d_pos));
    if (t->residuals)
        SPIN_TRY(reserve(d, n * SPIN_RESIDUAL, &t->d_residual));
    if (t->tracked) {
        SPIN_TRY(reserve(d, n * 3, &t->means));
        SPIN_TRY(reserve(d, n * SPIN_RESIDUAL, &t->residual));
    }
    if (spin_n_ranks() > 1) {
        SPIN_TRY(reserve(d, t->n_max * 3, &t->visit_pos));
        if (t->residuals)
            SPIN_TRY(reserve(d, t->n_max * SPIN_RESIDUAL, &t->visit_residual));
    }
    if (spin_n_ranks() > 1 && t->tracked) {
        SPIN_TRY(reserve(d, t->n_max, &t->visit_gradient));
        SPIN_TRY(
            d->op->reserve(d, t->n_max * sizeof *t->visit_seen, (void SPIN_DEV **)&t->visit_seen));
    }
    SPIN_TRY(spin_field_eval_open(&t->field_eval, d, t->network, n, true));
    return spin_raster_open(&t->raster, d, t->n_max, t->max_pixels, t->max_tiles,
                            (int)smaller(d->views_at_once, t->max_items), true);
}

static void say_owned(const struct spin_trainer *t)
{
    int n = 0;

    for (int f = 0; f < t->n_frames; f++)
        n += spin_trainer_owns(f);
    if (spin_n_ranks() > 1)
        spin_log(1, "rank 0 has the values of %d of %d frames", n, t->n_frames);
}

/* Floats of the sums of what all frames share. */
static size_t n_shared(const struct spin_trainer *t)
{
    return 2 * (t->heads.n + t->exposures.param.n) + 1;
}

spin_status spin_trainer_open(struct spin_trainer *t, struct spin_device *device,
                              const struct spin_field *field, const struct spin_trainer_size *size)
{
    spin_status status;
    void *block = NULL;

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
    t->residuals = has_residual(size);
    t->visiting = -1;
    t->n_max = most_splats(size);
    SPIN_TRY_OUT(spin_alloc((size_t)size->n_frames, sizeof *t->frame, &block));
    t->frame = block;
    t->n_frames = size->n_frames;
    SPIN_TRY_OUT(open_values(t, size->max_items));
    t->levels = spin_share_levels(&field->grid, spin_rank(), spin_n_ranks());
    t->part = spin_share_part(field, t->levels);
    SPIN_TRY_OUT(spin_param_open(&t->table, device, t->network ? t->part.n_table : 0,
                                 spin_lazy_pad(&t->part)));
    SPIN_TRY_OUT(spin_param_open(&t->heads, device, t->network ? field->n_heads : 0, 0));
    SPIN_TRY_OUT(spin_param_open(&t->tracks, device, SPIN_TRACK * t->n_tracks, 0));
    SPIN_TRY_OUT(spin_exposures_open(&t->exposures, device, size->n_cameras, size->n_lenses,
                                     size->exposure,
                                     t->max_pixels * smaller(device->views_at_once, t->max_items)));
    for (int f = 0; f < t->n_frames; f++)
        SPIN_TRY_OUT(spin_train_frame_open(&t->frame[f], device, size->frame[f], t->tracked,
                                           spin_trainer_owns(f)));
    SPIN_TRY_OUT(open_buffers(t));
    say_owned(t);
    if (spin_n_ranks() > 1 || device->frames_at_once == 1)
        SPIN_TRY_OUT(reserve(device, n_shared(t), &t->shared));
    SPIN_TRY_OUT(spin_exchange_open(&t->exchange, device));
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
    if (n <= t->n_max)
        return SPIN_OK;
    close_buffers(t);
    t->n_max = n + n / 4;
    SPIN_TRY(open_buffers(t));
    t->field_eval.lazy = t->lazy;
    return SPIN_OK;
}

/* ---- Frames of other ranks ------------------------------------------------------------------- */

bool spin_trainer_owns(int frame) { return spin_share_owner(frame) == spin_rank(); }

struct spin_train_frame spin_trainer_at(const struct spin_trainer *t, int frame)
{
    struct spin_train_frame at = t->frame[frame];

    if (spin_trainer_owns(frame))
        return at;
    at.pos = t->visit_pos;
    at.residual = at.size.n_residual > 0 ? t->visit_residual : NULL;
    at.gradient = t->visit_gradient;
    at.seen = t->visit_seen;
    return at;
}

/* The parts of a frame that visits: where they are, and how many floats. */
enum { N_PARTS = 4 };

static void list_parts(const struct spin_trainer *t, const struct spin_train_frame *frame,
                       float SPIN_DEV *at[N_PARTS], size_t floats[N_PARTS])
{
    const struct spin_frame_size *size = &frame->size;

    at[0] = frame->pos;
    floats[0] = 3 * size->n_pos;
    at[1] = frame->residual;
    floats[1] = SPIN_RESIDUAL * size->n_residual;
    at[2] = frame->gradient;
    at[3] = (float SPIN_DEV *)frame->seen;
    floats[2] = floats[3] = t->gather ? size->n : 0;
}

size_t spin_trainer_floats(const struct spin_trainer *t, int frame)
{
    float SPIN_DEV *at[N_PARTS];
    size_t floats[N_PARTS];

    list_parts(t, &t->frame[frame], at, floats);
    return floats[0] + floats[1] + floats[2] + floats[3];
}

void spin_trainer_pack(const struct spin_trainer *t, int frame, float SPIN_DEV *to, bool whole)
{
    float SPIN_DEV *at[N_PARTS];
    size_t floats[N_PARTS];

    list_parts(t, &t->frame[frame], at, floats);
    for (int i = 0; i < (whole ? N_PARTS : 1); to += floats[i++])
        copy(t->device, to, at[i], floats[i]);
}

void spin_trainer_receive(struct spin_trainer *t, int frame, const float SPIN_DEV *from, bool whole)
{
    const struct spin_train_frame to = spin_trainer_at(t, frame);
    float SPIN_DEV *at[N_PARTS];
    size_t floats[N_PARTS];

    list_parts(t, &to, at, floats);
    for (int i = 0; i < (whole ? N_PARTS : 1); from += floats[i++])
        copy(t->device, at[i], from, floats[i]);
    t->visiting = frame;
}

spin_status spin_trainer_lend(struct spin_trainer *t, int frame, int to)
{
    size_t n = spin_trainer_floats(t, frame);
    int owner = spin_share_owner(frame);
    struct spin_device_message m = {.peer = spin_rank() == to ? owner : to,
                                    .receive = spin_rank() == to,
                                    .bytes = n * sizeof(float)};
    float SPIN_DEV *values;
    spin_status status;

    if (owner == to || (spin_rank() != owner && spin_rank() != to))
        return SPIN_OK;
    SPIN_TRY(reserve(t->device, n, &values));
    m.at = values;
    if (!m.receive)
        spin_trainer_pack(t, frame, values, true);
    status = spin_exchange(&t->exchange, &m, 1);
    if (m.receive && status == SPIN_OK)
        spin_trainer_receive(t, frame, values, true);
    t->device->op->release(t->device, values, n * sizeof *values);
    return status;
}

spin_status spin_trainer_enable_lazy_adam(struct spin_trainer *t)
{
    struct spin_param_group table = spin_param_group(&t->table, 0, t->table.n, 0, 0);

    t->is_lazy = true;
    if (spin_lazy_level(&t->part.grid) == t->part.grid.n_levels)
        return SPIN_OK; /* this rank has small levels only */
    SPIN_TRY(t->device->op->lazy_adam_enable(t->device, &t->part.grid, &table, t->rates.iterations,
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
    d->op->release(d, t->values, (size_t)t->max_items * SPIN_LOSS_VALUES * sizeof *t->values);
    d->op->release(d, t->shared, n_shared(t) * sizeof *t->shared);
    spin_param_close(&t->table, d);
    spin_param_close(&t->heads, d);
    spin_param_close(&t->tracks, d);
    spin_exposures_close(&t->exposures, d);
    for (int f = 0; f < t->n_frames; f++)
        spin_train_frame_close(&t->frame[f], d);
    free(t->frame);
    free(t->host_values);
    free(t->drawn);
    for (int i = 0; i < SPIN_ROUND_BUFFERS; i++)
        d->op->release(d, t->round[i], t->round_bytes[i]);
    spin_exchange_close(&t->exchange);
    memset(t, 0, sizeof *t);
}

double spin_trainer_rate(const struct spin_trainer *t, double lr0, int64_t iteration)
{
    const struct spin_train_rates *r = &t->rates;

    return spin_lr(lr0, r->end, iteration, r->warmup, r->iterations);
}

double spin_trainer_track_rate(const struct spin_trainer *t, double lr0)
{
    const struct spin_train_rates *r = &t->rates;

    if (t->iteration >= r->track_iterations)
        return r->end;
    return spin_lr(lr0, r->end, t->iteration, r->warmup, r->track_iterations);
}

/* The network's steps: those after it joined. */
int64_t spin_trainer_network_steps(const struct spin_trainer *t)
{
    return t->iteration > t->rates.network_from ? t->iteration - t->rates.network_from : 0;
}

double spin_trainer_network_rate(const struct spin_trainer *t, double lr0, int64_t step)
{
    const struct spin_train_rates *r = &t->rates;

    return spin_lr(lr0, r->end, step, r->warmup, r->iterations - r->network_from);
}

static bool network_works(const struct spin_trainer *t)
{
    return t->network && spin_trainer_network_steps(t) > 0;
}

const struct spin_field *spin_trainer_network(const struct spin_trainer *t)
{
    return network_works(t) ? t->network : NULL;
}

int spin_trainer_sh_degree(const struct spin_trainer *t)
{
    int64_t begun = t->iteration > 0 ? t->iteration - 1 : 0;

    if (!network_works(t) && (t->tracked || !t->network))
        return 0;
    if (t->sh_increase_every <= 0 || begun / t->sh_increase_every >= t->field.sh_degree)
        return t->field.sh_degree;
    return (int)(begun / t->sh_increase_every);
}

/* ---- The table ------------------------------------------------------------------------------- */

/* After a resume the rates of the steps before it are noted again. */
void spin_trainer_catch_up(struct spin_trainer *t, int64_t done)
{
    while (t->lazy && t->lazy->done < done)
        t->device->op->lazy_adam_advance(
            t->device, t->lazy, spin_trainer_network_rate(t, t->rates.table, t->lazy->done + 1));
}

/* This rank's part. */
static float SPIN_DEV *take_part(struct spin_trainer *t)
{
    if (!t->lazy)
        return t->table.p;
    spin_trainer_catch_up(t, spin_trainer_network_steps(t));
    t->device->op->lazy_adam_flush(t->device, t->lazy, t->table.g);
    return t->table.g;
}

/* The parts of all ranks, with this rank's, to t->whole. */
static spin_status gather_table(struct spin_trainer *t, const float SPIN_DEV *part)
{
    const struct spin_grid *grid = &t->field.grid;
    float SPIN_DEV *mine = t->whole + spin_share_floats(grid, t->levels.first);
    int n_ranks = spin_n_ranks();
    struct spin_device_message *m = NULL;
    size_t n = 0;
    spin_status status;

    SPIN_TRY(spin_alloc(2 * (size_t)n_ranks, sizeof *m, (void **)&m));
    copy(t->device, mine, part, t->table.n);
    for (int r = 0; r < n_ranks; r++) {
        struct spin_levels of = spin_share_levels(grid, r, n_ranks);
        size_t first = spin_share_floats(grid, of.first), end = spin_share_floats(grid, of.end);

        if (r == spin_rank())
            continue;
        m[n++] =
            (struct spin_device_message){r, true, t->whole + first, (end - first) * sizeof(float)};
        m[n++] = (struct spin_device_message){r, false, mine, t->table.n * sizeof(float)};
    }
    status = spin_exchange(&t->exchange, m, n);
    free(m);
    return status;
}

spin_status spin_trainer_take_table(struct spin_trainer *t, float SPIN_DEV **out)
{
    const float SPIN_DEV *part = *out = take_part(t);

    if (spin_n_ranks() == 1 || !t->network)
        return SPIN_OK;
    SPIN_TRY(reserve(t->device, t->field.n_table, &t->whole));
    *out = t->whole;
    return gather_table(t, part);
}

void spin_trainer_put_back(struct spin_trainer *t)
{
    if (t->lazy)
        t->device->op->zero(t->device, t->table.g, t->table.n * sizeof(float));
    t->device->op->release(t->device, t->whole, t->field.n_table * sizeof(float));
    t->whole = NULL;
}
