/* Trains a single frame through the training loop, with complete settings: those of 3DGS unless
 * a test changes them. */
#ifndef SPIN_TESTS_TRAIN_ONE_FRAME_H
#define SPIN_TESTS_TRAIN_ONE_FRAME_H

#include "base/err.h"
#include "math/rng.h"
#include "tests/check.h"
#include "tests/tap.h"
#include "train/train_frame.h"
#include "train/loop.h"

/* The record of one iteration. */
struct one_step {
    int iteration, view; /* from 1; index of the rendered view */
    size_t n;            /* points drawn */
    double loss;
    bool densified;
    struct spin_densify_change change;
};

struct one_frame {
    int iterations, sh_increase_every;
    struct spin_train_rates rates;
    struct spin_schedule schedule;
    struct spin_densify_options densify;
    bool learns_exposure;
    const float *falloff; /* [SPIN_EXPOSURE] of all lenses, or NULL */
    double lambda_dssim;
    bool antialias, no_final_prune;
    float background[3];
    void (*watch)(void *context, const struct one_step *step); /* or NULL */
    void *context;
};

/* The record of all iterations. */
struct one_stats {
    int densifications;
    struct spin_densify_change change;
    size_t n_first, n_last;
    double loss_first, loss_last;
};

/* The table of docs/method.md section 2. */
__attribute__((unused)) static void one_frame_defaults(struct one_frame *o, int iterations,
                                                       double extent)
{
    memset(o, 0, sizeof *o);
    o->iterations = iterations;
    o->sh_increase_every = 1000;
    o->rates = (struct spin_train_rates){
        .position = 1.6e-4 * extent,
        .position_end = 1.6e-6 * extent,
        .residual = {5e-3, 1e-3, 2.5e-3, 0.05},
        .sh = 2.5e-3 / 20,
        .tracked = 1,
        .lenses_stay = true,
        .iterations = iterations,
    };
    o->schedule = (struct spin_schedule){iterations / 5 < 500 ? iterations / 5 : 500,
                                         3 * iterations / 4, 100};
    spin_densify_defaults(&o->densify);
    o->densify.extent = extent;
    o->lambda_dssim = 0.2;
}

/* Everything that a loop needs. */
struct one_bench {
    struct spin_retrain_options o;
    struct spin_plan plan;
    struct spin_frame_info info;
    struct spin_sampler sampler;
    struct spin_trainer trainer;
    struct spin_checkpoint clock;
    struct spin_step_log log;
    size_t counts[1];
    int frame[1];
};

static void one_plan(struct one_bench *b, const struct one_frame *o, struct spin_device *d,
                     const struct spin_camera *camera, int n_views, const int *order)
{
    struct spin_plan *p = &b->plan;

    b->o.method = SPIN_METHOD_FRAMES;
    b->o.iterations = o->iterations;
    b->o.batch = b->o.views_per_frame = 1;
    b->info.number = o->densify.frame;
    p->o = &b->o;
    p->device = d;
    p->clip.n_frames = 1;
    p->clip.frame = b->frame;
    p->clip.bundle.meta.frame = &b->info;
    p->counts = b->counts;
    p->clip.views.n = p->n_cameras = n_views;
    p->clip.views.view = calloc((size_t)n_views, sizeof *p->clip.views.view);
    p->camera = calloc((size_t)n_views, sizeof *p->camera);
    p->n_train = (size_t)(order ? o->iterations : n_views);
    p->train = calloc(p->n_train, sizeof *p->train);
    if (!p->clip.views.view || !p->camera || !p->train)
        exit(1);
    for (int i = 0; i < n_views; i++) {
        struct spin_camera_f32 cam = spin_camera_f32_from(&camera[i]);
        size_t pixels = (size_t)cam.width * (size_t)cam.height,
               tiles = (size_t)cam.tiles_x * (size_t)cam.tiles_y;

        p->clip.views.view[i].camera = camera[i];
        p->clip.views.view[i].camera_id = p->camera[i] = i;
        p->max_pixels = pixels > p->max_pixels ? pixels : p->max_pixels;
        p->max_tiles = tiles > p->max_tiles ? tiles : p->max_tiles;
    }
    for (size_t i = 0; i < p->n_train; i++)
        p->train[i].view = order ? (size_t)order[i] : i;
    if (spin_lenses_list(&p->clip.views, p->train, p->n_train, 1, &p->lenses) != SPIN_OK)
        exit(1);
    p->exposure = calloc((size_t)(n_views + p->lenses.n), SPIN_EXPOSURE * sizeof *p->exposure);
    if (!p->exposure)
        exit(1);
    for (int i = 0; o->falloff && i < p->lenses.n; i++)
        memcpy(p->exposure + SPIN_EXPOSURE * (n_views + i), o->falloff,
               SPIN_EXPOSURE * sizeof(float));
}

/* With a given order, one epoch is the whole run. images is indexed by the numbers of the views. */
static void one_sampler(struct one_bench *b, const struct one_frame *o,
                        const struct spin_images *images, int n_views, bool ordered)
{
    struct spin_sampler *s = &b->sampler;
    uint32_t number;

    s->plan = &b->plan;
    s->seed = spin_rng_u64(o->densify.seed, 33, (uint64_t)o->densify.frame);
    s->epoch = ordered ? 0 : -1;
    s->sequence = calloc(3 * b->plan.n_train, sizeof *s->sequence);
    s->items = calloc(1, sizeof *s->items);
    s->pairs = calloc(1, sizeof *s->pairs);
    if (!s->sequence || !s->items || !s->pairs ||
        spin_image_store_open(&s->images, b->plan.device, (size_t)n_views, 1, SPIN_IMAGE_RGB8,
                              false) != SPIN_OK)
        exit(1);
    for (uint32_t i = 0; i < b->plan.n_train; i++)
        s->sequence[i] = i;
    for (size_t i = 0; i < (size_t)n_views; i++)
        spin_image_store_find(&s->images, i, &number);
    s->images.images = *images;
}

static spin_status one_trainer(struct one_bench *b, const struct one_frame *o,
                               const struct spin_refine_cloud *cloud)
{
    const struct spin_frame_size frame = {cloud->n, cloud->n, cloud->n, cloud->n};
    const struct spin_trainer_size size = {.n_frames = 1,
                                           .frame = &frame,
                                           .tracked = true,
                                           .alone = true,
                                           .sh_degree = cloud->sh_degree,
                                           .max_items = 1,
                                           .max_pixels = b->plan.max_pixels,
                                           .max_tiles = b->plan.max_tiles,
                                           .n_cameras = o->learns_exposure ? b->plan.n_cameras : 0,
                                           .n_lenses = b->plan.lenses.n,
                                           .exposure = b->plan.exposure};
    struct spin_trainer *t = &b->trainer;

    SPIN_TRY(spin_trainer_open(t, b->plan.device, &b->plan.field, &size));
    t->field.antialias = o->antialias;
    t->rates = o->rates;
    t->lambda_dssim = (float)o->lambda_dssim;
    t->sh_increase_every = o->sh_increase_every;
    memcpy(t->background, o->background, sizeof t->background);
    return spin_refine_cloud_send(cloud, b->plan.device, &t->frame[0]);
}

static spin_status one_loop(struct one_bench *b, const struct one_frame *o, struct one_stats *stats)
{
    struct spin_trainer *t = &b->trainer;
    struct spin_loop loop = spin_loop_of(&b->plan, NULL, t, &b->clock, &b->log);
    struct spin_steps steps = {0};

    loop.schedule = o->schedule;
    loop.densify = o->densify;
    while (t->iteration < o->iterations && t->frame[0].size.n > 0) {
        struct one_step now = {.n = t->frame[0].size.n};

        if (spin_cancelled())
            return spin_fail_cancelled();
        SPIN_TRY(spin_loop_step(&loop, &b->sampler, &steps));
        now.iteration = (int)t->iteration;
        now.view = (int)b->sampler.pairs[0]->view;
        now.loss = steps.last.loss;
        now.densified = t->hold;
        if (now.densified) {
            now.change = steps.change;
            stats->densifications++;
            stats->change.clones += now.change.clones;
            stats->change.splits += now.change.splits;
            stats->change.pruned += now.change.pruned;
        }
        stats->loss_last = now.loss;
        if (now.iteration == 1)
            stats->loss_first = now.loss;
        if (o->watch)
            o->watch(o->context, &now);
    }
    return SPIN_OK;
}

/* Returns the cloud's points after the iterations, and their record. order [iterations]: the
 * view of each; NULL: drawn at random. images is indexed by the numbers of the views. */
__attribute__((unused)) static spin_status
one_frame_run(struct spin_device *d, const struct one_frame *o, const struct spin_images *images,
              const struct spin_camera *camera, int n_views, const int *order,
              struct spin_refine_cloud *cloud, struct one_stats *stats)
{
    struct one_bench b = {0};
    struct one_stats own = {.n_first = cloud->n};
    const struct spin_train_frame *frame;
    spin_status status;

    one_plan(&b, o, d, camera, n_views, order);
    one_sampler(&b, o, images, n_views, order != NULL);
    SPIN_TRY_OUT(one_trainer(&b, o, cloud));
    SPIN_TRY_OUT(one_loop(&b, o, &own));
    frame = &b.trainer.frame[0];
    SPIN_TRY_OUT(spin_refine_cloud_reserve(cloud, frame->size.n));
    cloud->n = frame->size.n;
    if (cloud->n > 0)
        memset(cloud->point, 0, cloud->n * sizeof *cloud->point);
    SPIN_TRY_OUT(spin_refine_cloud_fetch(cloud, d, frame));
    if (!o->no_final_prune)
        own.change.pruned += spin_refine_prune(cloud, o->densify.prune_opacity);
    own.n_last = cloud->n;
out:
    if (stats)
        *stats = own;
    spin_trainer_close(&b.trainer);
    spin_sampler_close(&b.sampler);
    free(b.plan.clip.views.view);
    free(b.plan.camera);
    free(b.plan.exposure);
    free(b.plan.train);
    spin_lenses_free(&b.plan.lenses);
    return status;
}

#endif
