/* Frames and their views through network and rasteriser, and back. */
#include "train/step_parts.h"

#include <string.h>

#include "base/err.h"
#include "io/ranks.h"

/* Draw the views, add their gradients to d_attr and d_pos, and empty the batch of views. */
static spin_status draw_views(struct spin_trainer *t, const struct spin_step_batch *b,
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

static void add_item(struct spin_trainer *t, const struct spin_step_batch *b, int item, int frame,
                     size_t n, struct spin_view_batch *views)
{
    struct spin_view_of_batch *view = spin_raster_add_view(
        &t->raster, views, frame, n, b->items[item].camera, t->field.antialias);

    view->weight = 1.0f / (float)b->n;
    view->image = b->items[item].image;
    view->exposure = b->items[item].exposure;
    view->lens = b->items[item].lens;
    view->value = t->n_drawn;
    t->drawn[t->n_drawn++] = item;
}

/* All views of the frames; first[f]: the first item that shows frame f of the batch. */
static spin_status draw_frames(struct spin_trainer *t, const struct spin_step_batch *b,
                               const int *first, struct spin_frame_batch *frames)
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
static void step_frames(struct spin_trainer *t, const struct spin_step_batch *b, const int *first,
                        const struct spin_frame_batch *frames)
{
    struct spin_param_group group[SPIN_MAX_FRAMES * SPIN_TRAIN_FRAME_GROUPS];
    double lr_pos =
        t->rates.position == 0 ? 0 : spin_trainer_rate(t, t->rates.position, t->iteration);
    double lr[SPIN_HEADS];
    bool fixed = t->rates.residual[SPIN_HEAD_SCALE] == 0; /* residual values stay as they are */
    int n_groups = 0;

    for (int k = 0; k < SPIN_HEADS; k++)
        lr[k] = spin_trainer_rate(t, t->rates.residual[k], t->iteration);
    for (int f = 0; f < frames->n_frames; f++)
        n_groups += spin_train_frame_step(
            &t->frame[b->items[first[f]].frame], lr_pos, lr, t->rates.tracked,
            frames->frame[f].d_means, fixed ? NULL : frames->frame[f].d_residual, group + n_groups);
    t->device->op->adam(t->device, n_groups, group);
}

static void add_frame(const struct spin_trainer *t, int number, struct spin_frame_batch *frames)
{
    struct spin_frame_of_batch *to = &frames->frame[frames->n_frames++];
    struct spin_train_frame at = spin_trainer_at(t, number), *frame = &at;
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
    if (t->tracked) {
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

void spin_step_add_tracks(struct spin_trainer *t, const struct spin_frame_batch *frames)
{
    struct spin_tracks_f32 tracks = tracks_of(t);

    if (t->tracked)
        t->device->op->tracks(t->device, frames, &tracks, t->means, t->residual);
}

struct spin_frame_batch spin_trainer_frame(struct spin_trainer *t, int frame)
{
    struct spin_frame_batch frames = {0};

    add_frame(t, frame, &frames);
    spin_step_add_tracks(t, &frames);
    return frames;
}

struct spin_frame_batch spin_step_frames(struct spin_trainer *t, const struct spin_step_batch *b,
                                         const int *first, int n)
{
    struct spin_frame_batch frames = {0};

    for (int i = 0; i < n; i++)
        add_frame(t, b->items[first[i]].frame, &frames);
    return frames;
}

spin_status spin_step_draw(struct spin_trainer *t, const struct spin_step_batch *b,
                           const int *first, struct spin_frame_batch *frames)
{
    struct spin_device *d = t->device;

    d->op->zero(d, t->field_eval.d_attr, frames->n * SPIN_ATTR * sizeof(float));
    d->op->zero(d, t->d_pos, frames->n * 3 * sizeof(float));
    if (t->tracked ||
        (spin_n_ranks() > 1 && t->residuals)) /* no Adam here, which would leave zeros */
        d->op->zero(d, t->d_residual, frames->n * SPIN_RESIDUAL * sizeof(float));
    return draw_frames(t, b, first, frames);
}

void spin_step_tracks_back(struct spin_trainer *t, const struct spin_frame_batch *frames)
{
    struct spin_tracks_f32 tracks = tracks_of(t);

    if (t->tracked)
        t->device->op->tracks_back(t->device, frames, &tracks);
}

void spin_step_finish(struct spin_trainer *t, const struct spin_step_batch *b, const int *first,
                      const struct spin_frame_batch *frames)
{
    spin_step_tracks_back(t, frames);
    step_frames(t, b, first, frames);
}

/* ---- What all frames share ------------------------------------------------------------------- */

size_t spin_step_shared(const struct spin_trainer *t) { return t->heads.n + t->exposures.param.n; }

void spin_step_take_shared(struct spin_trainer *t, float SPIN_DEV *out)
{
    const struct spin_param *param[2] = {&t->heads, &t->exposures.param};
    struct spin_device *d = t->device;

    for (int i = 0; i < 2; out += param[i++]->n) {
        if (param[i]->n == 0)
            continue;
        d->op->copy_rows(d, 1, param[i]->n, param[i]->g, param[i]->n, out, param[i]->n);
        d->op->zero(d, param[i]->g, param[i]->n * sizeof(float));
    }
}

void spin_step_add_shared(struct spin_trainer *t, const float SPIN_DEV *from)
{
    t->device->op->add(t->device, spin_step_shared(t), from, t->shared);
}
