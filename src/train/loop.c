/* Runs the training loop, evaluates the test views, saves checkpoints and reserves disk space for
 * them. */
#include "train/loop.h"

#include "base/base.h"
#include "train/checkpoint.h"
#include "train/densify.h"
#include "train/photos.h"

enum { CHECK_EVERY = 100 }; /* number of iterations between checks that all values are finite */
static const double save_seconds = 300; /* seconds between checkpoints without --save-every */

/* ---- Evaluation ------------------------------------------------------------------------------ */

static struct spin_frame_batch frame_of(void *context, int frame)
{
    return spin_trainer_frame(context, frame);
}

/* Measures the quality of the test views in the current state of the training, and writes previews.
 */
static spin_status measure_clip(const struct spin_loop *l, struct spin_quality *q)
{
    struct spin_trainer *t = l->trainer;
    struct spin_player live;
    /* A copy of the plan's lenses, which receives the current falloffs of the training. */
    struct spin_lenses lenses = l->plan->lenses;
    float SPIN_DEV *table = spin_trainer_take_table(t);
    char label[40];
    spin_status status;

    spin_player_open_live(&live, t->device, &t->field, t->network != NULL, table, t->heads.p,
                          frame_of, t);
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

/* Records the best evaluation of this run. */
static void keep_best(struct spin_retrain_report *report, const struct spin_quality *q,
                      int64_t iteration)
{
    if (!q->valid || (report->best_iteration > 0 && q->psnr <= report->best_psnr))
        return;
    report->best_psnr = q->psnr;
    report->best_iteration = iteration;
}

/* Measures the quality of the test views, logs and reports the result, and writes previews. */
static spin_status evaluate_clip(const struct spin_loop *l)
{
    struct spin_quality q;
    FILE *log;

    SPIN_TRY(measure_clip(l, &q));
    if (q.valid)
        spin_log(0, "iteration %lld: test PSNR %.3f dB, SSIM %.4f",
                 (long long)l->trainer->iteration, q.psnr, q.ssim);
    if (q.valid && (log = spin_step_log_begin(l->step_log))) {
        fprintf(
            log,
            "{\"iteration\": %lld, \"seconds\": %.3f, \"test_psnr\": %.6f, \"test_ssim\": %.6f}\n",
            (long long)l->trainer->iteration, spin_checkpoint_seconds(l->checkpoint), q.psnr,
            q.ssim);
        spin_step_log_end(l->step_log, true);
    }
    l->plan->report->test = q;
    keep_best(l->plan->report, &q, l->trainer->iteration);
    return l->looked ? l->looked(l->context) : SPIN_OK;
}

/* ---- One iteration --------------------------------------------------------------------------- */

/* True for the training of a single frame, as in 3DGS. */
static bool is_single_frame(const struct spin_loop *l)
{
    return l->plan->o->method == SPIN_METHOD_FRAMES;
}

struct spin_loop spin_loop_of(struct spin_plan *plan, struct spin_photos *photos,
                              struct spin_trainer *trainer, struct spin_checkpoint *checkpoint,
                              struct spin_step_log *step_log)
{
    struct spin_loop l = {.plan = plan,
                          .photos = photos,
                          .trainer = trainer,
                          .checkpoint = checkpoint,
                          .step_log = step_log,
                          .schedule = spin_plan_schedule(plan)};

    spin_densify_defaults(&l.densify);
    checkpoint->gather_end = l.schedule.every > 0 && l.schedule.until > 1 ? l.schedule.until : 1;
    l.densify.extent = plan->extent;
    l.densify.seed = plan->o->seed;
    l.densify.max_points = (size_t)plan->o->max_points;
    if (is_single_frame(&l))
        l.densify.frame = spin_plan_info(plan, 0)->number;
    else
        l.densify.gradient_threshold = plan->o->densify_threshold / plan->o->batch;
    l.densify.long_axis = !is_single_frame(&l);
    return l;
}

/* True if the iteration gathers densification statistics, that is, if a densification follows in
 * this or a later iteration. */
static bool gathers_at(const struct spin_loop *l, int64_t iteration)
{
    return l->trainer->tracked && l->schedule.every > 0 && iteration < l->schedule.until;
}

/* Releases the statistics if no later iteration gathers them. */
static void drop_unused_statistics(const struct spin_loop *l)
{
    if (!gathers_at(l, l->trainer->iteration + 1))
        spin_trainer_drop_statistics(l->trainer);
}

static bool densifies_at(const struct spin_loop *l, int64_t iteration)
{
    return gathers_at(l, iteration) && iteration > l->schedule.first &&
           iteration % l->schedule.every == 0;
}

static spin_status densify_clip(const struct spin_loop *l, struct spin_densify_change *change)
{
    struct spin_trainer *t = l->trainer;

    memset(change, 0, sizeof *change);
    SPIN_TRY(spin_densify_tracks(t, &l->densify, (int)t->iteration, l->checkpoint->permutation,
                                 l->plan->counts, change));
    if (!is_single_frame(l))
        spin_log(1, "iteration %lld: %zu clones, %zu splits, %zu pruned; now %zu tracks",
                 (long long)t->iteration, change->clones, change->splits, change->pruned,
                 t->n_tracks);
    return SPIN_OK;
}

/* Runs one iteration. After SPIN_OK, the trainer can be saved in a checkpoint. An iteration that
 * densifies a single frame skips the Adam step of its splats, as 3DGS does: there, densification
 * replaces the parameters and thereby discards their gradients. All parameters are checked before a
 * densification, which would silently prune splats with values that are not finite. */
static spin_status run_iteration(const struct spin_loop *l, const struct spin_sampler *sampler,
                                 struct spin_steps *steps)
{
    struct spin_trainer *t = l->trainer;
    int64_t now = t->iteration + 1;
    bool due_now = densifies_at(l, now);

    l->checkpoint->sound = false;
    t->gather = gathers_at(l, now);
    t->absolute = !is_single_frame(l);
    t->hold = due_now && is_single_frame(l);
    SPIN_TRY(spin_trainer_step(t, &sampler->images.images, sampler->items, l->plan->o->batch,
                               &steps->last));
    if (!isfinite(steps->last.loss))
        return spin_malformed("the loss is not finite in iteration %lld: lower the learning rates, "
                              "or check the points of the input",
                              (long long)now);
    if (due_now || now % CHECK_EVERY == 0 || now == l->plan->o->iterations)
        SPIN_TRY(spin_check_parameters(t));
    if (due_now)
        SPIN_TRY(densify_clip(l, &steps->change));
    drop_unused_statistics(l);
    SPIN_TRY(spin_average_step(t));
    l->checkpoint->sound = true;
    return SPIN_OK;
}

static const char *const op_names[] = SPIN_OP_NAMES;

/* Writes a line to the log for the last iteration: its losses, its densification and the seconds of
 * its operations. */
static void log_step(const struct spin_loop *l, const struct spin_sampler *sampler,
                     const struct spin_steps *steps, double seconds)
{
    const struct spin_train_values *v = &steps->last;
    const struct spin_densify_change *change = &steps->change;
    FILE *f = spin_step_log_begin(l->step_log);

    if (!f)
        return;
    fprintf(f,
            "{\"%s\": %lld, \"seconds\": %.3f, \"step_s\": %.5f, \"loss\": %.7g, "
            "\"l1\": %.7g, \"ssim\": %.7g, \"views\": [",
            is_single_frame(l) ? "refine" : "iteration", (long long)l->trainer->iteration,
            spin_checkpoint_seconds(l->checkpoint), seconds, v->loss, v->l1, v->ssim);
    for (int i = 0; i < l->plan->o->batch; i++)
        fprintf(f, "%s[%d, %d]", i ? ", " : "",
                spin_plan_info(l->plan, sampler->pairs[i]->frame)->number,
                l->plan->clip.views.view[sampler->pairs[i]->view].camera_id);
    fprintf(f, "]");
    if (is_single_frame(l))
        fprintf(f, ", \"splats\": %zu", l->trainer->frame[0].size.n);
    if (densifies_at(l, l->trainer->iteration))
        fprintf(f, ", \"clones\": %zu, \"splits\": %zu, \"pruned\": %zu", change->clones,
                change->splits, change->pruned);
    fprintf(f, ", \"ops_s\": {");
    for (int i = 0; i < SPIN_N_OPS; i++)
        fprintf(f, "%s\"%s\": %.6f", i ? ", " : "", op_names[i], steps->step_s[i]);
    fprintf(f, "}}\n");
    spin_step_log_end(l->step_log, false);
}

/* Sets steps->step_s to the seconds that the device spent on each operation since the last call. */
static void read_op_seconds(struct spin_steps *steps, struct spin_device *device)
{
    for (int i = 0; i < SPIN_N_OPS; i++)
        steps->step_s[i] = device->op->clock(device, i);
}

static void count_seconds(struct spin_steps *steps, double seconds)
{
    steps->wall_s += seconds;
    for (int i = 0; i < SPIN_N_OPS; i++)
        steps->op_s[i] += steps->step_s[i];
}

/* If frames are kept in temporary files, reads those of the next iteration in the background. */
static void read_ahead(const struct spin_loop *l, const struct spin_sampler *sampler)
{
    struct spin_trainer *t = l->trainer;

    for (int k = 0; t->scratch && k < l->plan->o->batch; k++) {
        int frame = spin_sampler_next_frame(sampler, t->iteration, (size_t)k);

        if (frame >= 0)
            spin_train_frame_read_ahead(&t->frame[frame]);
    }
}

spin_status spin_loop_step(const struct spin_loop *l, struct spin_sampler *sampler,
                           struct spin_steps *steps)
{
    struct spin_device *d = l->trainer->device;
    double start = spin_now_s(), loaded, seconds, waited, waited_before;
    uint64_t sent, sent_before;

    read_op_seconds(steps, d); /* discard the times of other work since the last iteration */
    SPIN_TRY(spin_sampler_batch(sampler, l->trainer->iteration));
    read_ahead(l, sampler);
    loaded = spin_now_s();
    spin_ranks_spent(&sent_before, &waited_before);
    SPIN_TRY(run_iteration(l, sampler, steps));
    spin_ranks_spent(&sent, &waited);
    steps->sent += (double)(sent - sent_before);
    steps->exchange_s += waited - waited_before;
    steps->done++;
    if (!steps->last.seen && steps->blind++ == 0)
        steps->first_blind = l->trainer->iteration;
    read_op_seconds(steps, d);
    steps->step_s[SPIN_OP_PIXELS] += loaded - start;
    seconds = spin_now_s() - start;
    count_seconds(steps, seconds);
    log_step(l, sampler, steps, seconds);
    return SPIN_OK;
}

/* Logs the seconds of each device operation, and their share of the time of all iterations. */
static void log_seconds(const struct spin_steps *steps)
{
    double named = 0;
    char sent[32];

    if (!(steps->wall_s > 0))
        return;
    for (int i = 0; i < SPIN_N_OPS; i++) {
        named += steps->op_s[i];
        spin_log(1, "  %-13s %9.3f s %6.1f %%", op_names[i], steps->op_s[i],
                 100 * steps->op_s[i] / steps->wall_s);
    }
    spin_log(1, "  %-13s %9.3f s %6.1f %% of %.3f s in iterations", "together", named,
             100 * named / steps->wall_s, steps->wall_s);
    spin_text_bytes((size_t)(steps->sent / (double)(steps->done > 0 ? steps->done : 1)), sent);
    if (spin_n_ranks() > 1)
        spin_log(1, "  %-13s %9.3f s, %s sent per iteration by rank 0", "exchanged",
                 steps->exchange_s, sent);
}

/* ---- The loop -------------------------------------------------------------------------------- */

static bool is_due(int64_t iteration, int every) { return every > 0 && iteration % every == 0; }

/* Computes two decisions that must be the same on all ranks. *stop: true if any rank has received a
 * signal to stop. *save: true if the last checkpoint is older than save_seconds, by the clock of
 * rank 0. */
static spin_status agree_on_stop(const struct spin_loop *l, bool *stop, bool *save)
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

/* Saves a checkpoint during the training. The training can finish without a checkpoint, so a
 * failure to write it, for example on a full disk, is only a warning. */
static spin_status save_on_the_way(const struct spin_loop *l)
{
    struct spin_checkpoint *c = l->checkpoint;
    spin_status status = spin_checkpoint_save(c, l->trainer);

    if (status != SPIN_E_IO && status != SPIN_E_NOT_FOUND && status != SPIN_E_MEMORY)
        return status;
    if (!c->warned && spin_rank() == 0)
        spin_warn("%s; the training continues", spin_last_error());
    c->warned = true;
    return SPIN_OK;
}

/* After a signal to stop, saves a checkpoint and fails with SPIN_E_CANCELLED; otherwise saves a
 * checkpoint if one is due. *tried: true if it tried to save one, also if saving failed. */
static spin_status stop_or_save(const struct spin_loop *l, bool *tried)
{
    bool last = l->trainer->iteration == l->plan->o->iterations, stop, save;

    *tried = false;
    SPIN_TRY(agree_on_stop(l, &stop, &save));
    if (stop) {
        SPIN_TRY(spin_checkpoint_save(l->checkpoint, l->trainer));
        return spin_ranks_agree(spin_fail_cancelled());
    }
    if (last)
        return SPIN_OK;
    *tried =
        l->plan->o->save_every > 0 ? is_due(l->trainer->iteration, l->plan->o->save_every) : save;
    return *tried ? save_on_the_way(l) : SPIN_OK;
}

/* ---- Disk space ------------------------------------------------------------------------------ */

/* Returns the expected growth of the checkpoint, in bytes, up to the next densification: twice the
 * last growth, but at least an eighth of the current size `state`; half of `state` in the first
 * call. Records the size and the growth in *c. */
static uint64_t growth_ahead(struct spin_checkpoint *c, uint64_t state)
{
    bool first = c->bytes == 0;

    if (first || state > c->bytes)
        c->growth = first ? state / 4 : state - c->bytes;
    c->bytes = state;
    return 2 * c->growth > state / 8 ? 2 * c->growth : state / 8;
}

static spin_status fail_space(const struct spin_loop *l, uint64_t bytes, bool grows)
{
    const struct spin_checkpoint *c = l->checkpoint;
    SPIN_FREED char *folder = NULL;
    char need[32], left[32];

    SPIN_TRY(spin_path_folder(c->path, &folder));
    return spin_fail(SPIN_E_IO,
                     "not enough space on the disk of '%s': %s is free, but the checkpoint %s %s; "
                     "free some space",
                     c->path,
                     spin_text_bytes(spin_path_free_bytes(folder) + c->reserve.bytes, left),
                     grows ? "may grow to" : "needs", spin_text_bytes(bytes, need));
}

/* Reserves disk space for the next checkpoint, so that other programs cannot fill the disk
 * meanwhile. If the checkpoint might not fit on the disk after the next densification, stops the
 * training now, while the present checkpoint still fits. After the last densification, once a
 * checkpoint is saved, it suffices to reserve space for the output. */
static spin_status reserve_space(const struct spin_loop *l)
{
    struct spin_checkpoint *c = l->checkpoint;
    int64_t now = l->trainer->iteration;
    bool grows = gathers_at(l, now + 1), saved = now == 0 || c->saved == now;
    uint64_t state, values, ahead;
    struct stat input;

    SPIN_TRY(spin_checkpoint_bytes(c, l->trainer, &state, &values));
    ahead = growth_ahead(c, state);
    ahead = grows ? state + ahead : state;
    if (spin_reserve_set(&c->reserve, c->path, ahead))
        return SPIN_OK;
    if (saved && now > 0 && !grows && stat(l->plan->o->input, &input) == 0 &&
        spin_reserve_set(&c->reserve, c->path, values + (uint64_t)input.st_size))
        return SPIN_OK;
    if (saved || spin_reserve_set(&c->reserve, c->path, state))
        return fail_space(l, ahead, grows);
    if (!c->warned)
        spin_warn("not enough space on the disk of '%s' for a checkpoint; the training continues "
                  "without one",
                  c->path);
    c->warned = true;
    return SPIN_OK;
}

static spin_status ensure_space(const struct spin_loop *l)
{
    return spin_ranks_agree(spin_rank() == 0 ? reserve_space(l) : SPIN_OK);
}

/* Fails if no splat was visible in any iteration so far. Checks this only after about two epochs
 * and at the end of the training. */
static spin_status check_visibility(const struct spin_loop *l, const struct spin_steps *steps)
{
    int64_t epoch = (int64_t)(l->plan->n_train / (size_t)l->plan->o->batch) + 1, n = steps->blind;
    bool last = l->trainer->iteration == l->plan->o->iterations;

    if (n == l->trainer->iteration && (last || n == (epoch > 50 ? 2 * epoch : 100)))
        return spin_malformed(
            "no splat was visible in any view of the first %lld iterations: check that the "
            "cameras belong to these points",
            (long long)n);
    return SPIN_OK;
}

static void warn_blind(const struct spin_steps *steps)
{
    if (steps->blind > 0)
        spin_warn(
            "in %lld of %lld iterations, no splat was visible in any view (first in iteration "
            "%lld): these iterations learned nothing",
            (long long)steps->blind, (long long)steps->done, (long long)steps->first_blind);
}

static spin_status iterate_all(const struct spin_loop *l, struct spin_sampler *sampler,
                               struct spin_steps *steps)
{
    const struct spin_retrain_options *o = l->plan->o;
    const struct spin_train_values *v = &steps->last;
    struct spin_progress progress;
    double *smooth = &l->checkpoint->loss;
    bool tried;
    spin_status status = SPIN_OK; /* returned if no iterations remain */

    drop_unused_statistics(l);
    SPIN_TRY(ensure_space(l));
    spin_progress_begin(&progress, "retraining", "it", l->trainer->iteration, o->iterations);
    while (l->trainer->iteration < o->iterations) {
        SPIN_TRY_OUT(spin_loop_step(l, sampler, steps));
        SPIN_TRY_OUT(check_visibility(l, steps));
        *smooth = *smooth > 0 ? 0.98 * *smooth + 0.02 * v->loss : v->loss;
        if (l->plan->report->test.valid) /* after the first evaluation (--eval-every) */
            spin_progress_set(&progress, l->trainer->iteration, "loss %.4f, test PSNR %.2f dB",
                              *smooth, l->plan->report->test.psnr);
        else
            spin_progress_set(&progress, l->trainer->iteration, "loss %.4f", *smooth);
        SPIN_TRY_OUT(stop_or_save(l, &tried));
        if (tried || densifies_at(l, l->trainer->iteration))
            SPIN_TRY_OUT(ensure_space(l));
        if (is_due(l->trainer->iteration, o->eval_every) && l->trainer->iteration < o->iterations)
            SPIN_TRY_OUT(evaluate_clip(l));
    }
    l->plan->report->loss_last = *smooth;
    warn_blind(steps);
out:
    spin_progress_end(&progress);
    return status;
}

spin_status spin_loop_run(const struct spin_loop *l)
{
    struct spin_retrain_report *report = l->plan->report;
    struct spin_sampler sampler = {0};
    struct spin_steps steps = {0};
    spin_status status;

    SPIN_TRY_OUT(spin_sampler_open(&sampler, l->plan, l->photos));
    status = iterate_all(l, &sampler, &steps);
    log_seconds(&steps);
out:
    spin_sampler_close(&sampler);
    SPIN_TRY(status);
    report->seconds = spin_checkpoint_seconds(l->checkpoint);
    report->seconds_per_iteration =
        (report->seconds - report->refine_seconds) / l->plan->o->iterations;
    SPIN_TRY(evaluate_clip(l));
    if (report->best_psnr > report->test.psnr + 0.05 &&
        !(report->before.valid && report->before.psnr >= report->best_psnr))
        spin_log(0,
                 "the test PSNR was highest at iteration %lld, with %.3f dB: for this clip, fewer "
                 "--iterations may be better",
                 (long long)report->best_iteration, report->best_psnr);
    return SPIN_OK;
}
