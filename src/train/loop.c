/* The iterations of a retraining: which views, one step after the other, how good it is by now. */
#include <errno.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "base/err.h"
#include "base/log.h"
#include "base/mem.h"
#include "eval/metrics.h"
#include "device/clock.h"
#include "train/run.h"
#include "math/rng.h"

enum { STREAM_SHUFFLE = 16 };           /* of the random numbers, see math/rng.h */
enum { CHECK_EVERY = 100 };             /* iterations between looks at the values */
static const double save_seconds = 300; /* between states, when --save-every is not given */

/* ---- The schedule of views --------------------------------------------------------------------- */

static void shuffle(const struct spin_run *r, uint64_t key, uint32_t *list, size_t n)
{
    for (size_t i = n; i > 1; i--) {
        size_t j = spin_rng_below(r->o->seed, STREAM_SHUFFLE, key << 32 | i, (uint32_t)i);
        uint32_t keep = list[i - 1];

        list[i - 1] = list[j];
        list[j] = keep;
    }
}

/* One epoch: a permutation of all (frame, training camera) pairs. With views_per_frame V > 1 the
 * views of a frame are permuted, cut into groups of V, and the groups permuted. A function of the
 * seed and the epoch. */
static void plan_epoch(struct spin_run *r, int64_t epoch)
{
    size_t n = r->n_train, v = (size_t)r->o->views_per_frame, n_groups = 0;
    uint32_t *views = r->sequence + n, *groups = views + n;

    if (r->epoch == epoch)
        return;
    for (size_t i = 0; i < n; i++)
        r->sequence[i] = (uint32_t)i;
    r->epoch = epoch;
    if (v == 1) {
        shuffle(r, 2 * (uint64_t)epoch, r->sequence, n);
        return;
    }
    memcpy(views, r->sequence, n * sizeof *views);
    shuffle(r, 2 * (uint64_t)epoch, views, n);
    /* Stable by frame: pairs of one frame stay in their shuffled order, side by side. */
    for (size_t f = 0, k = 0; f < (size_t)r->clip.n_frames; f++) {
        size_t first = k;

        for (size_t i = 0; i < n; i++)
            if (r->train[views[i]].frame == (int)f)
                r->sequence[k++] = views[i];
        for (size_t i = first; i < k; i += v)
            groups[n_groups++] = (uint32_t)i;
    }
    memcpy(views, r->sequence, n * sizeof *views);
    shuffle(r, 2 * (uint64_t)epoch + 1, groups, n_groups);
    for (size_t g = 0, k = 0; g < n_groups; g++) {
        int frame = r->train[views[groups[g]]].frame;

        for (size_t i = groups[g]; i < n && i < groups[g] + v && r->train[views[i]].frame == frame;
             i++)
            r->sequence[k++] = views[i];
    }
}

spin_status spin_run_weigh(struct spin_run *r, size_t view, const float *truth, float *weight)
{
    const struct spin_camera *camera = &r->clip.views.view[view].camera;
    size_t n = (size_t)camera->width * (size_t)camera->height, dynamic;

    SPIN_TRY(spin_dynamic_mask_find(&r->dynamic, view, truth, &dynamic));
    for (size_t i = 0; i < n; i++)
        weight[i] = dynamic > 0 && r->dynamic.mask[i] ? (float)r->o->dynamic_weight : 1;
    return SPIN_OK;
}

/* Items of iteration i (from 0), pixels loaded. The last incomplete batch of an epoch is dropped. */
static spin_status plan_batch(struct spin_run *r, int64_t i, struct spin_train_item *items,
                              const struct spin_pair **pairs)
{
    size_t batch = (size_t)r->o->batch;
    int64_t per_epoch = (int64_t)(r->n_train / batch);

    if (per_epoch < 1)
        per_epoch = 1;
    plan_epoch(r, i / per_epoch);
    for (size_t k = 0; k < batch; k++) {
        size_t at = ((size_t)(i % per_epoch) * batch + k) % r->n_train;
        const struct spin_pair *pair = &r->train[r->sequence[at]];
        float *truth = r->truth + k * 3 * r->max_pixels;

        SPIN_TRY(spin_image_cache_get(&r->pixels, pair->view, truth));
        items[k].frame = pair->frame;
        items[k].taken.camera = &r->clip.views.view[pair->view].camera;
        items[k].taken.exposure = spin_run_camera(r, r->clip.views.view[pair->view].camera_id);
        items[k].taken.truth = truth;
        items[k].taken.weight = NULL;
        if (r->weight) {
            items[k].taken.weight = r->weight + k * r->max_pixels;
            SPIN_TRY(spin_run_weigh(r, pair->view, truth, r->weight + k * r->max_pixels));
        }
        pairs[k] = pair;
    }
    return SPIN_OK;
}

/* ---- The log ------------------------------------------------------------------------------------ */

void spin_run_logged(struct spin_run *r, bool flush)
{
    if (!ferror(r->log) && (!flush || fflush(r->log) == 0))
        return;
    snprintf(r->log_error, sizeof r->log_error, "%s", strerror(errno ? errno : EIO));
    spin_warn("cannot write the log '%s': %s; the work goes on without it", r->o->log,
              r->log_error);
    fclose(r->log);
    r->log = NULL;
}

/* ---- Looking at it ------------------------------------------------------------------------------ */

spin_status spin_run_measure(struct spin_run *r, struct spin_frame_renderer *frame_renderer,
                             const size_t *live_counts, const char *what, struct spin_quality *out)
{
    struct spin_metrics m = {.frame_renderer = frame_renderer,
                             .clip = &r->clip,
                             .pixels = &r->pixels,
                             .pairs = r->test,
                             .n_pairs = r->n_test,
                             .background = r->o->background,
                             .live_counts = live_counts,
                             .what = what};

    memset(out, 0, sizeof *out);
    return r->n_test > 0 ? spin_metrics_run(&m, out) : SPIN_OK;
}

spin_status spin_run_measure_source(struct spin_run *r, struct spin_quality *out)
{
    struct spin_frame_renderer frame_renderer;
    spin_status status;

    SPIN_TRY(
        spin_frame_renderer_open(&frame_renderer, &r->device, &r->clip.bundle, SPIN_FROM_SOURCE));
    status = spin_run_measure(r, &frame_renderer, NULL, "evaluating the source", out);
    spin_frame_renderer_close(&frame_renderer);
    return status;
}

bool spin_run_has_source(const struct spin_run *r)
{
    return (r->clip.bundle.meta.columns & SPIN_COL_ATTRIBUTES) == SPIN_COL_ATTRIBUTES;
}

/* Truth | before | after of the clip's middle frame, one PNG a test camera. */
static spin_status preview_view(struct spin_run *r, struct spin_frame_renderer *shown,
                                struct spin_frame_renderer *source, const struct spin_pair *pair,
                                const char *label)
{
    const struct spin_view *view = &r->clip.views.view[pair->view];
    size_t pixels = 3 * (size_t)view->camera.width * (size_t)view->camera.height;
    const float *picture[3];
    char name[96];
    char *path = NULL;
    void *block = NULL;
    float *values;
    int n = 0;
    spin_status status;

    SPIN_TRY(spin_alloc(3 * pixels, sizeof(float), &block));
    values = block;
    SPIN_TRY_OUT(spin_image_cache_get(&r->pixels, pair->view, values));
    picture[n++] = values;
    if (source) {
        SPIN_TRY_OUT(spin_frame_renderer_show(source, spin_run_index(r, pair->frame)));
        SPIN_TRY_OUT(
            spin_frame_renderer_draw(source, &view->camera, r->o->background, values + pixels));
        picture[n++] = values + pixels;
    }
    SPIN_TRY_OUT(
        spin_frame_renderer_draw(shown, &view->camera, r->o->background, values + 2 * pixels));
    picture[n++] = values + 2 * pixels;
    snprintf(name, sizeof name, "frame_%05d_cam_%02d_%s.png", spin_run_info(r, pair->frame)->number,
             view->camera_id, label);
    SPIN_TRY_OUT(spin_path_join(r->o->preview, name, &path));
    SPIN_TRY_OUT(spin_write_beside(path, view->camera.width, view->camera.height, picture, n));
out:
    free(block);
    free(path);
    return status;
}

spin_status spin_run_preview(struct spin_run *r, struct spin_frame_renderer *shown,
                             const char *label)
{
    struct spin_frame_renderer source = {0};
    bool with_source = spin_run_has_source(r);
    int middle = r->clip.n_frames / 2;
    spin_status status = SPIN_OK;

    if (!r->o->preview || r->n_test == 0)
        return SPIN_OK;
    if (with_source)
        SPIN_TRY(spin_frame_renderer_open(&source, &r->device, &r->clip.bundle, SPIN_FROM_SOURCE));
    SPIN_TRY_OUT(spin_frame_renderer_show_live(shown, middle, r->counts[middle],
                                               spin_run_info(r, middle)->time));
    for (size_t i = 0; i < r->n_test; i++)
        if (r->test[i].frame == middle)
            SPIN_TRY_OUT(preview_view(r, shown, with_source ? &source : NULL, &r->test[i], label));
out:
    spin_frame_renderer_close(&source);
    return status;
}

/* Measure and draw the network as it stands. */
static spin_status show_network(struct spin_run *r, struct spin_quality *q)
{
    struct spin_frame_renderer live;
    char label[40];
    size_t n = (size_t)r->clip.n_frames;
    void *block = NULL;
    float **pos, **residual;
    spin_status status;

    SPIN_TRY(spin_alloc(2 * n, sizeof(float *), &block));
    pos = block;
    residual = pos + n;
    for (size_t f = 0; f < n; f++) {
        pos[f] = r->trainer.frame[f].pos;
        residual[f] = r->trainer.frame[f].residual;
    }
    SPIN_TRY_OUT(spin_frame_renderer_open_live(&live, &r->device, &r->field,
                                               spin_trainer_take_table(&r->trainer),
                                               r->trainer.heads.p, pos, residual));
    snprintf(label, sizeof label, "iteration_%07lld", (long long)r->trainer.iteration);
    status = spin_run_measure(r, &live, r->counts, "evaluating", q);
    if (status == SPIN_OK)
        status = spin_run_preview(r, &live, label);
    spin_frame_renderer_close(&live);
out:
    spin_trainer_put_back(&r->trainer);
    free(block);
    return status;
}

spin_status spin_run_look(struct spin_run *r)
{
    struct spin_quality q;

    SPIN_TRY(show_network(r, &q));
    if (q.valid)
        spin_log(0, "iteration %lld: test PSNR %.3f dB, SSIM %.4f", (long long)r->trainer.iteration,
                 q.psnr, q.ssim);
    if (r->log && q.valid) {
        fprintf(
            r->log,
            "{\"iteration\": %lld, \"seconds\": %.3f, \"test_psnr\": %.6f, \"test_ssim\": %.6f}\n",
            (long long)r->trainer.iteration, r->worked_before_s + spin_now_s() - r->worked_s,
            q.psnr, q.ssim);
        spin_run_logged(r, true);
    }
    r->report->test = q;
    return SPIN_OK;
}

static const char *const op_names[] = SPIN_OP_NAMES;

/* One line a step, with the seconds of its ops. */
static void log_step(struct spin_run *r, const struct spin_train_values *v,
                     const struct spin_pair *const *pairs, double seconds)
{
    FILE *f = r->log;

    fprintf(f,
            "{\"iteration\": %lld, \"seconds\": %.3f, \"step_s\": %.5f, \"loss\": %.7g, "
            "\"l1\": %.7g, \"ssim\": %.7g, \"views\": [",
            (long long)r->trainer.iteration, r->worked_before_s + spin_now_s() - r->worked_s,
            seconds, v->loss, v->l1, v->ssim);
    for (int i = 0; i < r->o->batch; i++)
        fprintf(f, "%s[%d, %d]", i ? ", " : "", spin_run_info(r, pairs[i]->frame)->number,
                r->clip.views.view[pairs[i]->view].camera_id);
    fprintf(f, "], \"ops_s\": {");
    for (int i = 0; i < SPIN_N_OPS; i++)
        fprintf(f, "%s\"%s\": %.6f", i ? ", " : "", op_names[i], r->device.seconds[i]);
    fprintf(f, "}}\n");
    spin_run_logged(r, false);
}

static void count_seconds(struct spin_run *r, double seconds)
{
    r->stepped_s += seconds;
    for (int i = 0; i < SPIN_N_OPS; i++)
        r->spent_s[i] += r->device.seconds[i];
}

/* Where the time of the steps went. */
static void say_seconds(const struct spin_run *r)
{
    double named = 0;

    if (!(r->stepped_s > 0))
        return;
    for (int i = 0; i < SPIN_N_OPS; i++) {
        named += r->spent_s[i];
        spin_log(1, "  %-13s %9.3f s %6.1f %%", op_names[i], r->spent_s[i],
                 100 * r->spent_s[i] / r->stepped_s);
    }
    spin_log(1, "  %-13s %9.3f s %6.1f %% of %.3f s in steps", "together", named,
             100 * named / r->stepped_s, r->stepped_s);
}

/* ---- The loop ----------------------------------------------------------------------------------- */

static bool due(int64_t iteration, int every) { return every > 0 && iteration % every == 0; }

static spin_status stop_or_save(struct spin_run *r)
{
    bool last = r->trainer.iteration == r->o->iterations;

    if (spin_cancelled()) {
        SPIN_TRY(spin_run_save(r));
        return spin_fail_cancelled();
    }
    if (last)
        return SPIN_OK;
    if (r->o->save_every > 0 ? due(r->trainer.iteration, r->o->save_every)
                             : spin_now_s() - r->saved_s > save_seconds)
        return spin_run_save(r);
    return SPIN_OK;
}

/* Steps that showed nothing: all their views look past the splats, and nothing was learned. */
struct blind {
    int64_t first, n, done; /* iteration of the first; how many; of how many */
};

static spin_status count_blind(const struct spin_run *r, bool seen, struct blind *b)
{
    int64_t epoch = (int64_t)(r->n_train / (size_t)r->o->batch) + 1;
    bool last = r->trainer.iteration == r->o->iterations;

    b->done++;
    if (seen)
        return SPIN_OK;
    if (b->n++ == 0)
        b->first = r->trainer.iteration;
    if (b->n == r->trainer.iteration && (last || b->n == (epoch > 50 ? 2 * epoch : 100)))
        return spin_fail(SPIN_E_MALFORMED,
                         "no splat is visible in any view of %lld iterations: do the cameras "
                         "belong to these points",
                         (long long)b->n);
    return SPIN_OK;
}

static void warn_blind(const struct blind *b)
{
    if (b->n > 0)
        spin_warn("no splat was visible in any view of %lld of %lld iterations, first in "
                  "iteration %lld: nothing was learned in them",
                  (long long)b->n, (long long)b->done, (long long)b->first);
}

spin_status spin_run_loop(struct spin_run *r)
{
    struct spin_trainer *t = &r->trainer;
    struct spin_train_item *items;
    const struct spin_pair **pairs;
    struct spin_progress progress;
    struct spin_train_values v = {0};
    struct blind blind = {0};
    double smooth = 0;
    void *block = NULL, *block2 = NULL;
    spin_status status;

    spin_progress_begin(&progress, "retraining", "it", t->iteration, r->o->iterations);
    SPIN_TRY_OUT(spin_alloc((size_t)r->o->batch, sizeof *items, &block));
    SPIN_TRY_OUT(spin_alloc((size_t)r->o->batch, sizeof *pairs, &block2));
    items = block;
    pairs = block2;
    while (t->iteration < r->o->iterations) {
        double start = spin_now_s(), seconds;

        memset(r->device.seconds, 0, sizeof r->device.seconds);
        SPIN_TRY_OUT(plan_batch(r, t->iteration, items, pairs));
        r->device.seconds[SPIN_OP_PIXELS] += spin_now_s() - start;
        r->sound = false;
        SPIN_TRY_OUT(spin_trainer_step(t, items, r->o->batch, &v));
        if (!isfinite(v.loss)) {
            status = spin_fail(SPIN_E_MALFORMED,
                               "the loss is not finite at iteration %lld; lower "
                               "the learning rates, or look for bad points",
                               (long long)t->iteration);
            goto out;
        }
        if (t->iteration % CHECK_EVERY == 0 || t->iteration == r->o->iterations)
            SPIN_TRY_OUT(spin_run_check_finite(r));
        r->sound = true;
        seconds = spin_now_s() - start;
        count_seconds(r, seconds);
        smooth = smooth > 0 ? 0.98 * smooth + 0.02 * v.loss : v.loss;
        if (r->log)
            log_step(r, &v, pairs, seconds);
        SPIN_TRY_OUT(count_blind(r, v.seen, &blind));
        spin_progress_set(&progress, t->iteration, "loss %.4f", smooth);
        SPIN_TRY_OUT(stop_or_save(r));
        if (due(t->iteration, r->o->eval_every) && t->iteration < r->o->iterations)
            SPIN_TRY_OUT(spin_run_look(r));
    }
    r->report->loss_last = smooth;
    status = SPIN_OK;
    warn_blind(&blind);
out:
    spin_progress_end(&progress);
    say_seconds(r);
    free(block);
    free(block2);
    return status;
}
