/* The stages of a training iteration: each is called as in training, and reports the amount of its
 * work. */
#include <stdlib.h>

#include "tests/bench/bench.h"

static void run_contract(struct bench_scene *s)
{
    struct spin_frame_batch frames = bench_frames(s);

    s->device.op->contract(&s->device, &s->trainer.field.transform, &frames,
                           s->trainer.field_eval.x_u);
}

static void run_grid(struct bench_scene *s)
{
    struct spin_field_eval *w = &s->trainer.field_eval;

    s->device.op->grid(&s->device, &s->trainer.field.grid, s->trainer.table.p, s->n, w->x_u, w->z);
}

static void run_grid_lazy(struct bench_scene *s)
{
    struct spin_field_eval *w = &s->trainer.field_eval;

    s->device.op->lazy_adam_grid(&s->device, s->lazy, s->n, w->x_u, w->z);
}

static void run_mlp(struct bench_scene *s)
{
    struct spin_field_eval *w = &s->trainer.field_eval;

    s->device.op->mlp(&s->device, &s->trainer.field.heads, s->trainer.heads.p, s->n, w->z, w->raw);
}

static void run_activate(struct bench_scene *s)
{
    struct spin_field_eval *w = &s->trainer.field_eval;
    struct spin_frame_batch frames = bench_frames(s);

    s->device.op->activate(&s->device, &frames, w->raw, w->attr);
}

static void run_project(struct bench_scene *s)
{
    struct spin_frame_batch frames = bench_frames(s);
    struct spin_view_batch views = bench_views(s);

    s->device.op->project(&s->device, &views, &frames, s->trainer.field_eval.attr,
                          s->trainer.field.sh_degree, s->trainer.raster.splat2d);
}

static void run_lists(struct bench_scene *s)
{
    struct spin_raster *r = &s->trainer.raster;
    struct spin_view_batch views = bench_views(s);

    if (s->device.op->tile_count(&s->device, &views, r->splat2d, &r->tiles) != SPIN_OK)
        exit(1);
    s->device.op->tile_fill(&s->device, &views, r->splat2d, &r->tiles);
}

static void run_blend(struct bench_scene *s)
{
    struct spin_raster *r = &s->trainer.raster;
    struct spin_view_batch views = bench_views(s);

    s->device.op->blend(&s->device, &views, r->splat2d, &r->tiles, r->image, r->final_transmittance,
                        r->last_contributor);
}

static void run_loss(struct bench_scene *s)
{
    struct spin_raster *r = &s->trainer.raster;
    struct spin_view_batch views = bench_views(s);

    s->device.op->loss(&s->device, &views, &s->photo.images, 0.2f, r->image, s->trainer.values,
                       r->d_image);
}

static void run_blend_back(struct bench_scene *s)
{
    struct spin_raster *r = &s->trainer.raster;
    struct spin_view_batch views = bench_views(s);

    s->device.op->blend_back(&s->device, &views, r->splat2d, &r->tiles, r->final_transmittance,
                             r->last_contributor, r->d_image, r->d_splat2d);
}

static void run_project_back(struct bench_scene *s)
{
    struct spin_raster *r = &s->trainer.raster;
    struct spin_frame_batch frames = bench_frames(s);
    struct spin_view_batch views = bench_views(s);

    s->device.op->project_back(&s->device, &views, &frames, s->trainer.field_eval.attr,
                               s->trainer.field.sh_degree, r->splat2d, r->d_splat2d,
                               s->trainer.field_eval.d_attr);
}

/* All rows, as in the reference, whether they have a gradient or not. */
static void run_activate_back(struct bench_scene *s)
{
    struct spin_field_eval *w = &s->trainer.field_eval;
    struct spin_frame_batch frames = bench_frames(s);

    s->device.op->activate_back(&s->device, &frames, &w->active, w->raw, w->d_attr, w->d_raw);
}

static void run_mlp_back(struct bench_scene *s)
{
    struct spin_field_eval *w = &s->trainer.field_eval;

    s->device.op->mlp_back(&s->device, &s->trainer.field.heads, s->trainer.heads.p, &w->active,
                           w->z, w->d_raw, s->trainer.heads.g, w->d_z);
}

static void run_grid_back(struct bench_scene *s)
{
    struct spin_field_eval *w = &s->trainer.field_eval;

    s->device.op->grid_back(&s->device, &s->trainer.field.grid, s->trainer.table.p, &w->active,
                            w->x_u, w->d_z, s->trainer.table.g, w->d_x_u);
}

static void run_adam_lazy(struct bench_scene *s)
{
    s->device.op->lazy_adam_step(&s->device, s->lazy, 1e-7);
}

static void run_adam(struct bench_scene *s)
{
    struct spin_param_group table =
        spin_param_group(&s->trainer.table, 0, s->trainer.table.n, 1e-7, ++s->trainer.iteration);

    s->device.op->adam(&s->device, 1, &table);
}

static void run_step(struct bench_scene *s)
{
    struct spin_train_item item = {.camera = &s->camera};
    struct spin_train_values values = {0};

    if (spin_trainer_step(&s->trainer, &s->photo.images, &item, 1, &values) != SPIN_OK)
        exit(1);
}

/* ---- their work ------------------------------------------------------------------------------ */

static double lookups_of(const struct bench_scene *s)
{
    return (double)s->n * s->trainer.field.grid.n_levels * 16;
}

/* Lines of the table that the points of the scene need, after a look at it with lazy Adam. */
static double lines_of(struct bench_scene *s)
{
    float *last = bench_fetch(s, s->lazy->last, s->lazy->n_lines * sizeof *last);
    double n = 0;

    for (size_t i = 0; i < s->lazy->n_lines; i++)
        n += last[i] > 0;
    free(last);
    return n;
}

static struct bench_work work_grid(struct bench_scene *s)
{
    return (struct bench_work){
        .lookups = lookups_of(s), .bytes = 16 * lookups_of(s), .lines = lines_of(s)};
}

/* Read, add and write the gradient; read the table for the positions. */
static struct bench_work work_grid_back(struct bench_scene *s)
{
    return (struct bench_work){.lookups = 2 * lookups_of(s), .bytes = 48 * lookups_of(s)};
}

static double multiply_adds(const struct bench_scene *s)
{
    const struct spin_heads *h = &s->trainer.field.heads;
    double sum = 0;

    for (int k = 0; k < SPIN_HEADS; k++)
        sum += (double)h->hidden * (h->n_in + h->hidden + h->n_out[k]);
    return sum * (double)s->n;
}

static struct bench_work work_mlp(struct bench_scene *s)
{
    return (struct bench_work){.flop = 2 * multiply_adds(s), .bytes = 480.0 * (double)s->n};
}

/* The activations again, the gradient of the weights and of the inputs. */
static struct bench_work work_mlp_back(struct bench_scene *s)
{
    return (struct bench_work){.flop = 6 * multiply_adds(s), .bytes = 736.0 * (double)s->n};
}

static struct bench_work work_adam(struct bench_scene *s)
{
    return (struct bench_work){.bytes = 32.0 * (double)s->trainer.table.n};
}

static struct bench_work work_none(struct bench_scene *s)
{
    (void)s;
    return (struct bench_work){0};
}

/* clang-format off */
const struct bench_stage bench_stages[BENCH_STAGES] = {
    {"contract", "contraction", run_contract, work_none, PER_SPLAT, BY_NOTHING, 0, {0}, 0},
    {"grid", "encode forward", run_grid, work_grid, PER_SPLAT, BY_LOOKUPS, 1, {7, 35, 131}, 1.5},
    {"lazy_grid", "  of a lazy table", run_grid_lazy, work_grid, PER_SPLAT, BY_LOOKUPS, 0, {0}, 0},
    {"mlp", "heads forward", run_mlp, work_mlp, PER_SPLAT, BY_FMA, 0, {5.5, 27, 109}, 1.3},
    {"activate", "attributes", run_activate, work_none, PER_SPLAT, BY_NOTHING, 0, {0}, 0},
    {"project", "project + SH", run_project, work_none, PER_SPLAT, BY_NOTHING, 0, {1, 4, 17}, 1.5},
    {"lists", "sort + tile lists", run_lists, work_none, PER_SPLAT, BY_NOTHING, 0, {.6, 1.6, 7.5}, 1.5},
    {"blend", "raster forward", run_blend, work_none, PER_PAIR, BY_NOTHING, 0, {8, 14, 26}, 1.5},
    {"loss", "L1 + SSIM, both ways", run_loss, work_none, PER_PIXEL, BY_NOTHING, 0, {6.4, 6.4, 6.4}, 1.5},
    {"blend_back", "raster backward", run_blend_back, work_none, PER_PAIR, BY_NOTHING, 0, {12, 20, 38}, 1.5},
    {"project_back", "project + SH backward", run_project_back, work_none, PER_SPLAT, BY_NOTHING, 0, {1.4, 6.5, 24}, 1.5},
    {"activate_back", "attributes backward", run_activate_back, work_none, PER_SPLAT, BY_NOTHING, 0, {0}, 0},
    {"mlp_back", "heads backward", run_mlp_back, work_mlp_back, PER_SPLAT, BY_FMA, 0, {15.5, 76, 303}, 1.3},
    {"grid_back", "encode backward", run_grid_back, work_grid_back, PER_SPLAT, BY_LOOKUPS, 1, {22, 114, 404}, 1.5},
    {"adam_lazy", "Adam, needed lines", run_adam_lazy, work_none, PER_SPLAT, BY_NOTHING, 1, {25, 57, 68}, 1.5},
    {"adam", "Adam, all parameters", run_adam, work_adam, PER_PARAMETER, BY_UPDATE, 1, {108, 108, 108}, 1.5},
};
const struct bench_stage bench_steps[BENCH_STEPS] = {
    {"step", "whole step", run_step, work_none, PER_SPLAT, BY_NOTHING, 1, {187, 412, 1174}, 1.5},
    {"step_lazy", "whole step, lazy table", run_step, work_none, PER_SPLAT, BY_NOTHING, 1, {104, 361, 1134}, 1.5},
};
/* clang-format on */
