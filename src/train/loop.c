/* One step after the other, and how good it is by now. */
#include "train/loop.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "spin_train.h"
#include "base/err.h"
#include "base/log.h"
#include "base/mem.h"
#include "base/text.h"
#include "io/ranks.h"
#include "train/densify_tracks.h"
#include "train/sampler.h"
#include "train/test_views.h"

enum { CHECK_EVERY = 100 };             /* iterations between checks that all values are finite */
static const double save_seconds = 300; /* between states, when --save-every is not given */

/* ---- Looking at it ------------------------------------------------------------------------------ */

static struct spin_frame_batch frame_of(void *context, int frame)
{
    return spin_trainer_frame(context, frame);
}

/* Measure and draw the clip as it stands. */
static spin_status show_network(const struct spin_loop *l, struct spin_quality *q)
{
    struct spin_trainer *t = l->trainer;
    struct spin_player live;
    struct spin_lenses lenses = l->plan->lenses; /* with the falloff of now */
    float SPIN_DEV *table = spin_trainer_take_table(t);
    char label[40];
    spin_status status;

    spin_player_open_live(&live, t->device, &t->field, spin_trainer_network(t) != NULL, table,
                          t->heads.p, frame_of, t);
    status = spin_exposures_read_lenses(&t->exposures, t->device, &lenses);
    if (status == SPIN_OK && t->exposures.param.n)
        status = spin_player_set_lenses(&live, &lenses);
    snprintf(label, sizeof label, "iteration_%07lld", (long long)t->iteration);
    if (status == SPIN_OK)
        status =
            spin_test_views_measure(l->plan, l->photos, &live, l->plan->counts, "evaluating", q);
    if (status == SPIN_OK && spin_rank() == 0)
        status = spin_test_views_preview(l->plan, l->photos, &live, label);
    status = spin_ranks_agree(status);
    spin_player_close(&live);
    spin_trainer_put_back(t);
    return status;
}

/* Measure the network, say so, draw the previews. */
static spin_status look(const struct spin_loop *l)
{
    struct spin_quality q;

    SPIN_TRY(show_network(l, &q));
    if (q.valid)
        spin_log(0, "iteration %lld: test PSNR %.3f dB, SSIM %.4f",
                 (long long)l->trainer->iteration, q.psnr, q.ssim);
    if (l->step_log->file && q.valid) {
        fprintf(
            l->step_log->file,
            "{\"iteration\": %lld, \"seconds\": %.3f, \"test_psnr\": %.6f, \"test_ssim\": %.6f}\n",
            (long long)l->trainer->iteration, spin_checkpoint_seconds(l->checkpoint), q.psnr,
            q.ssim);
        spin_step_log_check(l->step_log, true);
    }
    l->plan->report->test = q;
    return SPIN_OK;
}

static const char *const op_names[] = SPIN_OP_NAMES;

/* Seconds of the last step's operations; of all steps: those of each operation, and on the wall. */
struct spent {
    double step[SPIN_N_OPS], op[SPIN_N_OPS], wall;
    double exchange_s, sent, steps; /* with other ranks: seconds, bytes that this one sent */
};

/* One line a step, with the seconds of its ops. */
static void log_step(const struct spin_loop *l, const struct spin_train_values *v,
                     const struct spin_pair *const *pairs, const struct spent *spent,
                     double seconds)
{
    FILE *f = l->step_log->file;

    fprintf(f,
            "{\"iteration\": %lld, \"seconds\": %.3f, \"step_s\": %.5f, \"loss\": %.7g, "
            "\"l1\": %.7g, \"ssim\": %.7g, \"views\": [",
            (long long)l->trainer->iteration, spin_checkpoint_seconds(l->checkpoint), seconds,
            v->loss, v->l1, v->ssim);
    for (int i = 0; i < l->plan->o->batch; i++)
        fprintf(f, "%s[%d, %d]", i ? ", " : "", spin_plan_info(l->plan, pairs[i]->frame)->number,
                l->plan->clip.views.view[pairs[i]->view].camera_id);
    fprintf(f, "], \"ops_s\": {");
    for (int i = 0; i < SPIN_N_OPS; i++)
        fprintf(f, "%s\"%s\": %.6f", i ? ", " : "", op_names[i], spent->step[i]);
    fprintf(f, "}}\n");
    spin_step_log_check(l->step_log, false);
}

/* What the device did since the last call. */
static void take_seconds(struct spent *spent, struct spin_device *device)
{
    for (int i = 0; i < SPIN_N_OPS; i++)
        spent->step[i] = device->op->clock(device, i);
}

static void count_seconds(struct spent *spent, double seconds)
{
    spent->wall += seconds;
    for (int i = 0; i < SPIN_N_OPS; i++)
        spent->op[i] += spent->step[i];
}

/* Where the time of the steps went. */
static void say_seconds(const struct spent *spent)
{
    double named = 0;
    char sent[32];

    if (!(spent->wall > 0))
        return;
    for (int i = 0; i < SPIN_N_OPS; i++) {
        named += spent->op[i];
        spin_log(1, "  %-13s %9.3f s %6.1f %%", op_names[i], spent->op[i],
                 100 * spent->op[i] / spent->wall);
    }
    spin_log(1, "  %-13s %9.3f s %6.1f %% of %.3f s in steps", "together", named,
             100 * named / spent->wall, spent->wall);
    spin_text_bytes((size_t)(spent->sent / (spent->steps > 0 ? spent->steps : 1)), sent);
    if (spin_n_ranks() > 1)
        spin_log(1, "  %-13s %9.3f s, %s sent a step by rank 0", "exchanged", spent->exchange_s,
                 sent);
}

/* ---- The loop ----------------------------------------------------------------------------------- */

static bool due(int64_t iteration, int every) { return every > 0 && iteration % every == 0; }

/* A signal to one stops all, and the clock of rank 0 says when to save. */
static spin_status stop_and_save(const struct spin_loop *l, bool *stop, bool *save)
{
    struct wish {
        bool stop, save;
    } * all;
    spin_status status;

    *stop = spin_cancelled();
    *save = spin_now_s() - l->checkpoint->saved_s > save_seconds;
    if (spin_n_ranks() == 1)
        return SPIN_OK;
    SPIN_TRY(spin_alloc((size_t)spin_n_ranks(), sizeof *all, (void **)&all));
    all[spin_rank()] = (struct wish){*stop, *save};
    status = spin_ranks_gather(all, sizeof *all);
    for (int r = 0; r < spin_n_ranks(); r++)
        *stop |= all[r].stop;
    *save = all[0].save;
    free(all);
    return status;
}

static spin_status stop_or_save(const struct spin_loop *l)
{
    bool last = l->trainer->iteration == l->plan->o->iterations, stop, save;

    SPIN_TRY(stop_and_save(l, &stop, &save));
    if (stop) {
        SPIN_TRY(spin_checkpoint_save(l->checkpoint, l->trainer));
        return spin_ranks_agree(spin_fail_cancelled());
    }
    if (last)
        return SPIN_OK;
    if (l->plan->o->save_every > 0 ? due(l->trainer->iteration, l->plan->o->save_every) : save)
        return spin_checkpoint_save(l->checkpoint, l->trainer);
    return SPIN_OK;
}

/* Steps that showed nothing: all their views look past the splats, and nothing was learned. */
struct blind {
    int64_t first, n, done; /* iteration of the first; how many; of how many */
};

static spin_status count_blind(const struct spin_loop *l, bool seen, struct blind *b)
{
    int64_t epoch = (int64_t)(l->plan->n_train / (size_t)l->plan->o->batch) + 1;
    bool last = l->trainer->iteration == l->plan->o->iterations;

    b->done++;
    if (seen)
        return SPIN_OK;
    if (b->n++ == 0)
        b->first = l->trainer->iteration;
    if (b->n == l->trainer->iteration && (last || b->n == (epoch > 50 ? 2 * epoch : 100)))
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

/* ---- Densification of tracks -------------------------------------------------------------------- */

static bool densifies(const struct spin_loop *l, int64_t iteration)
{
    return l->trainer->tracked && spin_plan_densifies_by(l->plan, iteration);
}

static spin_status densify(const struct spin_loop *l)
{
    const struct spin_retrain_options *o = l->plan->o;
    struct spin_trainer *t = l->trainer;
    struct spin_densify_options d;
    struct spin_densify_change change = {0};

    if (!densifies(l, t->iteration) || t->iteration % o->densify_every != 0)
        return SPIN_OK;
    spin_densify_defaults(&d);
    d.extent = l->plan->extent;
    d.seed = o->seed;
    d.gradient_threshold = o->densify_threshold / o->batch;
    d.max_points = (size_t)o->max_points;
    SPIN_TRY(spin_densify_tracks(t, &d, (int)t->iteration, l->frames->permutation, l->plan->counts,
                                 &change));
    spin_log(1, "iteration %lld: %zu clones, %zu splits, %zu pruned: %zu tracks",
             (long long)t->iteration, change.clones, change.splits, change.pruned, t->n_tracks);
    return SPIN_OK;
}

/* One step, after which the trainer is sound; its loss goes into v. */
static spin_status take_step(const struct spin_loop *l, const struct spin_sampler *sampler,
                             struct spin_train_values *v)
{
    struct spin_trainer *t = l->trainer;

    l->checkpoint->sound = false;
    t->gather = densifies(l, t->iteration);
    SPIN_TRY(spin_trainer_step(t, &sampler->images.images, sampler->items, l->plan->o->batch, v));
    if (!isfinite(v->loss))
        return spin_fail(SPIN_E_MALFORMED,
                         "the loss is not finite at iteration %lld; lower the learning rates, or "
                         "look for bad points",
                         (long long)t->iteration);
    if (t->iteration % CHECK_EVERY == 0 || t->iteration == l->plan->o->iterations)
        SPIN_TRY(spin_check_parameters(t));
    SPIN_TRY(densify(l));
    l->checkpoint->sound = true;
    return SPIN_OK;
}

/* A step with its images and its line in the log. */
static spin_status iterate(const struct spin_loop *l, struct spin_sampler *sampler,
                           struct spent *spent, struct blind *blind, struct spin_train_values *v)
{
    struct spin_device *d = l->trainer->device;
    double start = spin_now_s(), loaded, seconds, waited, waited_before;
    uint64_t sent, sent_before;

    take_seconds(spent, d); /* of what was done between steps */
    SPIN_TRY(spin_sampler_batch(sampler, l->trainer->iteration));
    loaded = spin_now_s();
    spin_ranks_spent(&sent_before, &waited_before);
    SPIN_TRY(take_step(l, sampler, v));
    spin_ranks_spent(&sent, &waited);
    spent->sent += (double)(sent - sent_before);
    spent->exchange_s += waited - waited_before;
    spent->steps++;
    take_seconds(spent, d);
    spent->step[SPIN_OP_PIXELS] += loaded - start;
    seconds = spin_now_s() - start;
    count_seconds(spent, seconds);
    if (l->step_log->file)
        log_step(l, v, sampler->pairs, spent, seconds);
    return count_blind(l, v->seen, blind);
}

static spin_status iterate_all(const struct spin_loop *l, struct spin_sampler *sampler,
                               struct spent *spent)
{
    const struct spin_retrain_options *o = l->plan->o;
    struct spin_train_values v = {0};
    struct spin_progress progress;
    struct blind blind = {0};
    double *smooth = &l->checkpoint->loss;
    spin_status status = SPIN_OK;

    spin_progress_begin(&progress, "retraining", "it", l->trainer->iteration, o->iterations);
    while (l->trainer->iteration < o->iterations) {
        SPIN_TRY_OUT(iterate(l, sampler, spent, &blind, &v));
        *smooth = *smooth > 0 ? 0.98 * *smooth + 0.02 * v.loss : v.loss;
        if (l->plan->report->test.valid) /* of the last --eval-every */
            spin_progress_set(&progress, l->trainer->iteration, "loss %.4f, test PSNR %.2f dB",
                              *smooth, l->plan->report->test.psnr);
        else
            spin_progress_set(&progress, l->trainer->iteration, "loss %.4f", *smooth);
        SPIN_TRY_OUT(stop_or_save(l));
        if (due(l->trainer->iteration, o->eval_every) && l->trainer->iteration < o->iterations)
            SPIN_TRY_OUT(look(l));
    }
    l->plan->report->loss_last = *smooth;
    warn_blind(&blind);
out:
    spin_progress_end(&progress);
    return status;
}

spin_status spin_loop_run(const struct spin_loop *l)
{
    struct spin_retrain_report *report = l->plan->report;
    struct spin_sampler sampler = {0};
    struct spent spent = {0};
    spin_status status;

    SPIN_TRY_OUT(spin_sampler_open(&sampler, l->plan, l->photos));
    status = iterate_all(l, &sampler, &spent);
    say_seconds(&spent);
out:
    spin_sampler_close(&sampler);
    SPIN_TRY(status);
    report->seconds = spin_checkpoint_seconds(l->checkpoint);
    report->seconds_per_iteration =
        (report->seconds - report->refine_seconds) / l->plan->o->iterations;
    return look(l);
}
