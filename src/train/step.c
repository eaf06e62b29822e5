/* The training step. It goes in groups of as many frames and views as the device takes at once. Gradients of
 * table and heads gather over all of them; positions take their step when their group is done. */
#include "train/step.h"

#include <stdlib.h>
#include <string.h>

#include "base/err.h"
#include "base/mem.h"
#include "math/adam.h"
#include "model/residual.h"
#include "train/lazy_adam.h"

static spin_status reserve(struct spin_device *d, size_t floats, float SPIN_DEV **out)
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

/* Splats have values besides the network's. */
static bool has_residual(const struct spin_trainer_size *size)
{
    size_t sum = size->n_tracks;

    for (int f = 0; f < size->n_frames; f++)
        sum += size->frame[f].n_residual;
    return sum > 0;
}

size_t spin_trainer_bytes(const struct spin_field *field, const struct spin_trainer_size *size)
{
    size_t n = most_splats(size), floats = 4 * SPIN_TRACK * size->n_tracks;

    for (int f = 0; f < size->n_frames; f++)
        floats += 3 * (3 * size->frame[f].n_pos + SPIN_RESIDUAL * size->frame[f].n_residual) +
                  (size->n_tracks > 0 ? size->frame[f].n : 0);
    floats += (has_residual(size) ? SPIN_TRACK : 3) * n * (size->n_tracks > 0 ? 2 : 1);
    if (size->network)
        floats += 4 * (field->n_table + field->n_heads);
    return floats * sizeof(float) + spin_field_eval_bytes(size->network ? field : NULL, n, true) +
           spin_raster_bytes(n, size->max_pixels, true);
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

static void close_buffers(struct spin_trainer *t)
{
    struct spin_device *d = t->device;
    size_t n = splats_at_once(t);

    d->op->release(d, t->d_pos, n * 3 * sizeof(float));
    d->op->release(d, t->d_residual, n * SPIN_RESIDUAL * sizeof(float));
    d->op->release(d, t->means, n * 3 * sizeof(float));
    d->op->release(d, t->residual, n * SPIN_RESIDUAL * sizeof(float));
    t->d_pos = t->d_residual = t->means = t->residual = NULL;
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
    if (t->n_tracks > 0) {
        SPIN_TRY(reserve(d, n * 3, &t->means));
        SPIN_TRY(reserve(d, n * SPIN_RESIDUAL, &t->residual));
    }
    SPIN_TRY(spin_field_eval_open(&t->field_eval, d, t->network, n, true));
    return spin_raster_open(&t->raster, d, t->n_max, t->max_pixels, t->max_tiles, d->views_at_once,
                            true);
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
    t->n_tracks = size->n_tracks;
    t->n_moving = size->n_moving;
    t->n_varying = size->n_varying;
    t->residuals = has_residual(size);
    t->n_max = most_splats(size);
    SPIN_TRY_OUT(spin_alloc((size_t)size->n_frames, sizeof *t->frame, &block));
    t->frame = block;
    t->n_frames = size->n_frames;
    SPIN_TRY_OUT(open_values(t, size->max_items));
    SPIN_TRY_OUT(
        spin_param_open(&t->table, device, t->network ? field->n_table : 0, spin_lazy_pad(field)));
    SPIN_TRY_OUT(spin_param_open(&t->heads, device, t->network ? field->n_heads : 0, 0));
    SPIN_TRY_OUT(spin_param_open(&t->tracks, device, SPIN_TRACK * t->n_tracks, 0));
    SPIN_TRY_OUT(spin_exposures_open(&t->exposures, device, size->n_exposures,
                                     t->max_pixels * (size_t)device->views_at_once));
    for (int f = 0; f < t->n_frames; f++)
        SPIN_TRY_OUT(spin_train_frame_open(&t->frame[f], device, size->frame[f], t->n_tracks > 0));
    SPIN_TRY_OUT(open_buffers(t));
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
    d->op->release(d, t->values, (size_t)t->max_items * SPIN_LOSS_VALUES * sizeof *t->values);
    spin_param_close(&t->table, d);
    spin_param_close(&t->heads, d);
    spin_param_close(&t->tracks, d);
    spin_exposures_close(&t->exposures, d);
    for (int f = 0; f < t->n_frames; f++)
        spin_train_frame_close(&t->frame[f], d);
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

/* The network's steps: those after it joined. */
static int64_t network_steps(const struct spin_trainer *t)
{
    return t->iteration > t->rates.network_from ? t->iteration - t->rates.network_from : 0;
}

static double network_rate_at(const struct spin_trainer *t, double lr0, int64_t step)
{
    const struct spin_train_rates *r = &t->rates;

    return spin_lr(lr0, r->end, step, r->warmup, r->iterations - r->network_from);
}

static bool network_works(const struct spin_trainer *t)
{
    return t->network && network_steps(t) > 0;
}

const struct spin_field *spin_trainer_network(const struct spin_trainer *t)
{
    return network_works(t) ? t->network : NULL;
}

int spin_trainer_sh_degree(const struct spin_trainer *t)
{
    int64_t begun = t->iteration > 0 ? t->iteration - 1 : 0;

    if (!network_works(t) && (t->n_tracks > 0 || !t->network))
        return 0;
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
                                         network_rate_at(t, t->rates.table, t->lazy->done + 1));
}

float SPIN_DEV *spin_trainer_take_table(struct spin_trainer *t)
{
    if (!t->lazy)
        return t->table.p;
    catch_up(t, network_steps(t));
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
    if (t->gather)
        t->device->op->densify_stats(t->device, views, frames, t->raster.splat2d,
                                     t->raster.d_splat2d);
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
    double lr_pos = t->rates.position == 0 ? 0 : rate_at(t, t->rates.position, t->iteration);
    double lr[SPIN_HEADS];
    bool fixed = t->rates.residual[SPIN_HEAD_SCALE] == 0; /* residual values stay as they are */
    int n_groups = 0;

    for (int k = 0; k < SPIN_HEADS; k++)
        lr[k] = rate_at(t, t->rates.residual[k], t->iteration);
    for (int f = 0; f < frames->n_frames; f++)
        n_groups += spin_train_frame_step(
            &t->frame[b->items[first[f]].frame], lr_pos, lr, frames->frame[f].d_means,
            fixed ? NULL : frames->frame[f].d_residual, group + n_groups);
    t->device->op->adam(t->device, n_groups, group);
}

static void add_frame(const struct spin_trainer *t, const struct spin_train_frame *frame,
                      struct spin_frame_batch *frames)
{
    struct spin_frame_of_batch *to = &frames->frame[frames->n_frames++];
    bool residual = frame->residual && t->rates.residual[SPIN_HEAD_SCALE] > 0;

    *to = (struct spin_frame_of_batch){
        .first = frames->n,
        .n = frame->size.n,
        .t = spin_field_time(&t->field, frame->time),
        .means = frame->pos,
        .d_means = t->d_pos + 3 * frames->n,
        .residual = frame->residual,
        .d_residual = residual ? t->d_residual + SPIN_RESIDUAL * frames->n : NULL,
    };
    if (t->n_tracks > 0) {
        to->track = frame->track;
        to->own_means = frame->pos;
        to->n_own_means = frame->size.n_pos;
        to->own_residual = frame->residual;
        to->n_own_residual = frame->size.n_residual;
        to->means = t->means + 3 * frames->n;
        to->residual = t->residual + SPIN_RESIDUAL * frames->n;
        to->d_residual = t->d_residual + SPIN_RESIDUAL * frames->n;
        to->gradient = frame->gradient;
        to->seen = frame->seen;
    }
    frames->n += frame->size.n;
}

static struct spin_tracks_f32 tracks_of(const struct spin_trainer *t)
{
    return (struct spin_tracks_f32){t->n_tracks, t->tracks.p, t->tracks.g};
}

/* What the frames' splats have from their tracks. */
static void add_tracks(struct spin_trainer *t, const struct spin_frame_batch *frames)
{
    struct spin_tracks_f32 tracks = tracks_of(t);

    if (t->n_tracks > 0)
        t->device->op->tracks(t->device, frames, &tracks, t->means, t->residual);
}

struct spin_frame_batch spin_trainer_frame(struct spin_trainer *t, int frame)
{
    struct spin_frame_batch frames = {0};

    add_frame(t, &t->frame[frame], &frames);
    add_tracks(t, &frames);
    return frames;
}

/* The frames of these items, whose views may stand anywhere in the batch. */
static spin_status do_frames(struct spin_trainer *t, const struct batch *b, const int *first, int n)
{
    struct spin_device *d = t->device;
    const struct spin_field *network = spin_trainer_network(t);
    struct spin_tracks_f32 tracks = tracks_of(t);
    struct spin_frame_batch frames = {0};

    for (int i = 0; i < n; i++)
        add_frame(t, &t->frame[b->items[first[i]].frame], &frames);
    add_tracks(t, &frames);
    t->field_eval.still = t->rates.position == 0 && t->rates.displacement == 0;
    spin_field_forward(&t->field_eval, network, t->table.p, t->heads.p, &frames);
    d->op->zero(d, t->field_eval.d_attr, frames.n * SPIN_ATTR * sizeof(float));
    d->op->zero(d, t->d_pos, frames.n * 3 * sizeof(float));
    if (t->n_tracks > 0)
        d->op->zero(d, t->d_residual, frames.n * SPIN_RESIDUAL * sizeof(float));
    SPIN_TRY(draw_frames(t, b, first, &frames));
    spin_field_backward(&t->field_eval, network, t->table.p, t->heads.p, &frames, t->table.g,
                        t->heads.g);
    if (t->n_tracks > 0)
        d->op->tracks_back(d, &frames, &tracks);
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
        if (seen_before(b->items, i) || t->frame[b->items[i].frame].size.n == 0)
            continue;
        first[n++] = i;
        if (n == at_once || n == SPIN_MAX_FRAMES) {
            SPIN_TRY(do_frames(t, b, first, n));
            n = 0;
        }
    }
    return n > 0 ? do_frames(t, b, first, n) : SPIN_OK;
}

/* The network's groups; the table may take its step at once. */
static int step_network(struct spin_trainer *t, struct spin_param_group *group)
{
    const size_t *offset = t->field.heads.offset;
    struct spin_device *d = t->device;
    int64_t step = network_steps(t);
    double lr = network_rate_at(t, t->rates.table, step);
    int n = 0;

    if (t->lazy)
        d->op->lazy_adam_step(d, t->lazy, lr);
    else
        group[n++] = spin_param_group(&t->table, 0, t->table.n, lr, step);
    for (int k = 0; k < SPIN_HEADS; k++)
        group[n++] = spin_param_group(&t->heads, offset[k], offset[k + 1],
                                      network_rate_at(t, t->rates.head[k], step), step);
    return n;
}

/* Values first..end of the tracks, or with rate 0 none: they stay as they are. */
static int step_part(const struct spin_trainer *t, size_t first, size_t end, double rate,
                     struct spin_param_group *group)
{
    if (rate > 0)
        *group =
            spin_param_group(&t->tracks, first, end, rate_at(t, rate, t->iteration), t->iteration);
    else
        t->device->op->zero(t->device, t->tracks.g + first, (end - first) * sizeof(float));
    return rate > 0;
}

static int step_tracks(const struct spin_trainer *t, struct spin_param_group *group)
{
    size_t first = 3 * t->n_tracks;
    int n = step_part(t, 0, first, t->rates.displacement, group);

    for (int k = 0; k < SPIN_HEADS; k++) {
        size_t end = first + spin_residual_width[k] * t->n_tracks;

        n += step_part(t, first, end, t->rates.track[k], group + n);
        first = end;
    }
    return n;
}

/* Adam for what all frames share. */
static void step_shared(struct spin_trainer *t)
{
    struct spin_device *d = t->device;
    struct spin_param_group group[2 * SPIN_HEADS + 3];
    int n = 0;

    if (network_works(t))
        n += step_network(t, group + n);
    if (t->n_tracks > 0)
        n += step_tracks(t, group + n);
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
    catch_up(t, network_steps(t));
    t->iteration++;
    SPIN_TRY(do_groups(t, &b));
    step_shared(t);
    return read_values(t, n, values);
}
