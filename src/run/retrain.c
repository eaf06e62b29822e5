/* spin-retrain: a bundle in, a better bundle out, from start to end.
 *
 * Everything that follows from an iteration depends on the options, the seed and the state alone, so
 * a resumed run ends in the same bits as one that was never stopped, on any number of threads. */
#include "train/run.h"

#include <errno.h>
#include <stdlib.h>
#include <string.h>

#include "base/err.h"
#include "base/log.h"
#include "base/mem.h"

/* ---- The output --------------------------------------------------------------------------------- */

static spin_status write_means(struct spin_run *r, struct spin_bundle_writer *w, int frame)
{
    size_t n = r->counts[frame];
    uint64_t shape[2] = {n, 3};
    char name[64];
    void *block = NULL;
    float *ours, *theirs;
    spin_status status;

    SPIN_TRY(spin_alloc(6 * n + 1, sizeof(float), &block));
    ours = block;
    theirs = ours + 3 * n;
    r->device.op->download(&r->device, ours, r->trainer.frame[frame].pos, 3 * n * sizeof(float));
    for (size_t i = 0; i < n; i++)
        memcpy(theirs + 3 * (size_t)r->permutation[frame][i], ours + 3 * i, 3 * sizeof(float));
    snprintf(name, sizeof name, "network/means/%05d", frame);
    status = spin_npz_write(&w->zip, name, "<f4", 2, shape, theirs);
    free(block);
    return status;
}

static spin_status fill_meta(struct spin_run *r, struct spin_bundle_meta *meta)
{
    const struct spin_bundle_meta *from = &r->clip.bundle.meta;
    char *folder = NULL;
    spin_status status;

    SPIN_TRY(spin_bundle_meta_reserve(meta, r->clip.n_frames));
    memcpy(meta->from, from->from, sizeof meta->from);
    memcpy(meta->upstream, from->upstream, sizeof meta->upstream);
    memcpy(meta->variant, from->variant, sizeof meta->variant);
    for (int f = 0; f < r->clip.n_frames; f++) {
        meta->frame[f] = *spin_run_info(r, f);
        meta->source_index[f] = from->source_index[spin_run_index(r, f)];
    }
    meta->n_source_frames = from->n_source_frames;
    meta->numbered = from->numbered;
    meta->columns = from->columns;
    meta->static_columns = from->static_columns;
    meta->sh_degree = from->sh_degree;
    meta->antialias = from->antialias;
    memcpy(meta->data_from, r->clip.data_from, sizeof meta->data_from);
    SPIN_TRY(spin_path_folder(r->o->output, &folder));
    status = spin_path_relative(folder, r->clip.data_path, &meta->data_path);
    free(folder);
    return status;
}

static spin_status write_network(struct spin_run *r, struct spin_bundle_writer *w)
{
    struct spin_trainer *t = &r->trainer;
    uint64_t features = (uint64_t)r->field.grid.n_features;
    uint64_t table[2] = {t->table.n / features, features}, heads[1] = {t->heads.n};

    for (int f = 0; f < r->clip.n_frames; f++)
        SPIN_TRY(write_means(r, w, f));
    for (int f = 0; spin_run_has_residual(r) && f < r->clip.n_frames; f++)
        SPIN_TRY(spin_run_write_residual(r, w, f));
    SPIN_TRY(spin_run_write_array(r, &w->zip, "network/table", 2, table, spin_trainer_take_table(t),
                                  t->table.n));
    spin_trainer_put_back(t);
    return spin_run_write_array(r, &w->zip, "network/heads", 1, heads, t->heads.p, t->heads.n);
}

static void set_quality(spin_json *j, const char *key, const struct spin_quality *q)
{
    spin_json *value;

    if (!q->valid) {
        spin_json_set_null(j, key);
        return;
    }
    value = spin_json_object();
    spin_json_set_number(value, "psnr", q->psnr);
    spin_json_set_number(value, "ssim", q->ssim);
    spin_json_set(j, key, value);
}

/* What was learned of the cameras: by id, the log of the gain and the offset, r g b each. */
static spin_status cameras_to_json(struct spin_run *r, spin_json **out)
{
    const struct spin_param *exposure = &r->trainer.exposures.param;
    spin_json *all = spin_json_array();
    void *block = NULL;

    SPIN_TRY(spin_alloc(exposure->n + 1, sizeof(float), &block));
    r->device.op->download(&r->device, block, exposure->p, exposure->n * sizeof(float));
    for (size_t i = 0; i < exposure->n / 6; i++) {
        spin_json *one = spin_json_object(), *gain = spin_json_array(), *offset = spin_json_array();
        const float *row = (const float *)block + 6 * i;

        for (int c = 0; c < 3; c++) {
            spin_json_push_number(gain, (double)row[c]);
            spin_json_push_number(offset, (double)row[3 + c]);
        }
        spin_json_set_integer(one, "camera", r->camera[i]);
        spin_json_set(one, "log_gain", gain);
        spin_json_set(one, "offset", offset);
        spin_json_push(all, one);
    }
    free(block);
    *out = all;
    return SPIN_OK;
}

static spin_status write_splats(struct spin_run *r, struct spin_bundle_writer *w,
                                const struct spin_bundle_meta *meta)
{
    for (int f = 0; f < r->clip.n_frames; f++) {
        SPIN_TRY(
            spin_bundle_frame(&r->clip.bundle, spin_run_index(r, f), meta->columns, &r->splats));
        SPIN_TRY(spin_bundle_write_frame(w, f, meta->columns, meta->static_columns, &r->splats));
    }
    if (r->refined)
        SPIN_TRY(spin_run_write_refined(r, w));
    return r->o->method == SPIN_METHOD_NETWORK ? write_network(r, w) : SPIN_OK;
}

/* What the method adds to meta.json. */
static spin_status describe(struct spin_run *r, spin_json *extra)
{
    spin_json *refined = NULL, *network, *cameras = NULL;

    if (r->refined) {
        refined = spin_run_refined_to_json(r);
        set_quality(refined, "test", &r->report->refined);
        spin_json_set(extra, "refined", refined);
    }
    if (r->o->method == SPIN_METHOD_NETWORK) {
        SPIN_TRY(cameras_to_json(r, &cameras));
        network = spin_run_to_json(r);
        spin_json_set(network, "cameras", cameras);
        spin_json_set_string(network, "fingerprint", r->fingerprint);
        spin_json_set_string(network, "path", r->paths);
        set_quality(network, "before", &r->report->before);
        set_quality(network, "test", &r->report->test);
        spin_json_set(extra, "network", network);
    } else {
        set_quality(refined, "before", &r->report->before);
        spin_json_set_string(refined, "fingerprint", r->fingerprint);
        spin_json_set_string(refined, "path", r->paths);
    }
    return SPIN_OK;
}

/* Nothing in the output tells when or how fast it was made, so equal runs give equal files. */
static spin_status write_output(struct spin_run *r)
{
    struct spin_bundle_writer w;
    struct spin_bundle_meta meta;
    spin_json *extra = spin_json_object();
    spin_status status;

    memset(&meta, 0, sizeof meta);
    status = spin_bundle_writer_open(r->o->output, r->o->force, true, &w);
    if (status != SPIN_OK) {
        spin_json_free(extra);
        return status;
    }
    SPIN_TRY_OUT(fill_meta(r, &meta));
    SPIN_TRY_OUT(write_splats(r, &w, &meta));
    SPIN_TRY_OUT(describe(r, extra));
    status = spin_bundle_writer_finish(&w, &meta, extra);
    spin_bundle_meta_free(&meta);
    return status;
out:
    spin_json_free(extra);
    spin_bundle_meta_free(&meta);
    spin_bundle_writer_abandon(&w);
    return status;
}

/* ---- From start to end -------------------------------------------------------------------------- */

/* --resume after the run had already finished: the output is there and was made this way. */
static bool already_done(struct spin_run *r)
{
    struct spin_bundle bundle;
    const char *method = r->o->method == SPIN_METHOD_NETWORK ? "network" : "refined", *text;
    bool same;

    if (spin_bundle_open(r->o->output, &bundle) != SPIN_OK)
        return false;
    text = spin_json_string(spin_json_get(spin_json_get(bundle.json, method), "fingerprint"));
    same = text && strcmp(text, r->fingerprint) == 0;
    spin_bundle_close(&bundle);
    return same;
}

/* The output is whole: what led to it goes. */
static void tidy_up(const struct spin_run *r)
{
    remove(r->part);
    spin_frame_cache_clear(r->parts);
    spin_out_sweep(r->part);
    spin_out_sweep(r->o->output);
}

static spin_status check_output(struct spin_run *r, bool *done)
{
    const struct spin_retrain_options *o = r->o;
    bool part = spin_path_is_taken(r->part), parts = spin_path_is_taken(r->parts);

    *done = false;
    if (spin_path_is_taken(o->output) && !o->force) {
        *done = o->resume && already_done(r);
        if (*done) {
            tidy_up(r);
            return SPIN_OK;
        }
        return spin_claim_file(o->output, false); /* says what is there */
    }
    if ((part || parts) && !o->resume && !o->force)
        return spin_fail(SPIN_E_IO,
                         "an unfinished run is in '%s': use --resume to go on, or "
                         "--force to start anew",
                         part ? r->part : r->parts);
    if (o->resume && !part && !parts)
        spin_warn("nothing to resume: '%s' has no unfinished state, the run starts anew",
                  o->output);
    return SPIN_OK;
}

static spin_status check_memory(const struct spin_run *r)
{
    if (r->report->bytes_needed > r->report->bytes_available)
        return spin_fail(SPIN_E_MEMORY,
                         "needs about %.1f GB of memory and %.1f GB are free: lower "
                         "--hash-log2 or --scale, or take a --range of the frames",
                         (double)r->report->bytes_needed / 1e9,
                         (double)r->report->bytes_available / 1e9);
    return SPIN_OK;
}

static spin_status prepare(struct spin_run *r)
{
    const struct spin_retrain_options *o = r->o;
    struct spin_train_rates *rates = &r->trainer.rates;
    void *block = NULL;

    SPIN_TRY(spin_alloc((size_t)o->batch * 3 * r->max_pixels, sizeof(float), &block));
    r->truth = block;
    SPIN_TRY(spin_run_sort(r));
    SPIN_TRY(spin_trainer_open(&r->trainer, &r->device, &r->field, r->clip.n_frames, r->counts,
                               r->max_pixels, r->max_tiles, o->learn_exposure ? r->n_cameras : 0,
                               spin_run_has_residual(r)));
    for (int f = 0; f < r->clip.n_frames; f++)
        r->trainer.frame[f].time = spin_run_info(r, f)->time;
    rates->table = o->lr_table;
    rates->head[SPIN_HEAD_SCALE] = o->lr_scale * o->lr_head_factor;
    rates->head[SPIN_HEAD_ROTATION] = o->lr_rotation * o->lr_head_factor;
    rates->head[SPIN_HEAD_SH] = o->lr_sh * o->lr_head_factor;
    rates->head[SPIN_HEAD_OPACITY] = o->lr_opacity * o->lr_head_factor;
    rates->position = o->lr_position * r->extent;
    spin_run_residual_rates(r, rates->residual);
    rates->exposure = o->lr_exposure;
    rates->end = 1e-7;
    rates->iterations = o->iterations;
    rates->warmup = o->warmup >= 0 ? o->warmup : o->iterations / 40;
    r->trainer.lambda_dssim = (float)o->lambda_dssim;
    r->trainer.lambda_scale = r->extent > 0 ? (float)(o->lambda_scale / r->extent) : 0;
    r->trainer.lambda_opacity = (float)o->lambda_opacity;
    r->trainer.sh_increase_every = o->sh_increase_every;
    memcpy(r->trainer.background, o->background, sizeof r->trainer.background);
    if (spin_run_is_lazy(r))
        SPIN_TRY(spin_trainer_enable_lazy_adam(&r->trainer));
    SPIN_TRY(o->resume && spin_path_exists(r->part) ? spin_run_load(r) : spin_run_begin(r));
    r->sound = true;
    return SPIN_OK;
}

static spin_status open_log(struct spin_run *r)
{
    if (!r->o->log)
        return SPIN_OK;
    r->log = fopen(r->o->log, r->o->resume ? "a" : "w");
    if (!r->log)
        return spin_fail(SPIN_E_IO, "cannot write the log '%s': %s", r->o->log, strerror(errno));
    return SPIN_OK;
}

/* State and network beside each other, when the state is saved and the output written. */
static spin_status check_disk(const struct spin_run *r)
{
    char *folder = NULL;
    size_t floats = r->field.n_table + r->field.n_heads;
    uint64_t bytes, room;

    for (int f = 0; f < r->clip.n_frames; f++)
        floats += r->counts[f] * (spin_run_has_residual(r) ? 3 + SPIN_RESIDUAL : 3);
    bytes = 4 * floats * sizeof(float); /* the values and their two moments, and the values */
    SPIN_TRY(spin_path_folder(r->o->output, &folder));
    room = spin_path_free_bytes(folder);
    free(folder);
    if (r->o->method == SPIN_METHOD_NETWORK && room < bytes)
        return spin_fail(SPIN_E_IO,
                         "cannot write '%s': state and output take %.2f GB and more, and the disk "
                         "has %.2f GB free",
                         r->o->output, (double)bytes / 1e9, (double)room / 1e9);
    return SPIN_OK;
}

/* All that will be written can be, before the first step. */
static spin_status claim_outputs(struct spin_run *r)
{
    SPIN_TRY(spin_claim_file(r->o->output, r->o->force));
    SPIN_TRY(spin_claim_file(r->part, true));
    if (r->refined && spin_path_is_taken(r->parts))
        SPIN_TRY(spin_claim_folder(r->parts));
    SPIN_TRY(check_disk(r));
    if (r->o->preview)
        SPIN_TRY(spin_claim_folder(r->o->preview));
    return open_log(r);
}

/* --dynamic-weight: find what moves. */
static spin_status open_weights(struct spin_run *r)
{
    void *block = NULL;

    if (r->o->dynamic_weight == 1)
        return SPIN_OK;
    SPIN_TRY(spin_dynamic_mask_open(&r->clip.views, &r->pixels, SPIN_DYNAMIC_AUTO, r->train,
                                    r->n_train, &r->dynamic));
    if (r->dynamic.from == SPIN_DYNAMIC_OFF)
        return spin_fail(SPIN_E_UNSUPPORTED,
                         "--dynamic-weight: the data set has no foreground masks, and no camera "
                         "stands still for three frames");
    SPIN_TRY(spin_dynamic_mask_keep(&r->dynamic));
    SPIN_TRY(spin_alloc((size_t)r->o->batch * r->max_pixels, sizeof(float), &block));
    r->weight = block;
    return SPIN_OK;
}

static void say_plan(const struct spin_run *r)
{
    spin_log(0, "%d frames, %.0f splats a frame, %zu training and %zu test views, %s",
             r->clip.n_frames, r->clip.n_mean, r->n_train, r->n_test, r->device.description);
    if (r->o->method == SPIN_METHOD_EXPLICIT)
        return;
    spin_log(0, "%.1f M parameters in the table, %.1f %% of the points outside the unit ball",
             (double)r->field.n_table / 1e6, 100 * r->report->outside_ball);
    if (r->report->outside_ball > 0.9)
        spin_warn("nearly all points lie outside the unit ball: consider --scene-normalise auto");
}

/* The frame-wise stage, and the plan anew: the network starts from what it leaves. */
static spin_status refine(struct spin_run *r)
{
    if (!r->refined)
        return SPIN_OK;
    SPIN_TRY(spin_run_refine(r));
    SPIN_TRY(spin_run_plan(r));
    r->report->splats_mean = r->clip.n_mean;
    return check_memory(r);
}

static spin_status look_at_source(struct spin_run *r)
{
    struct spin_quality *q = &r->report->before;

    if (!spin_run_has_source(r))
        return SPIN_OK;
    SPIN_TRY(spin_run_measure_source(r, q));
    if (q->valid)
        spin_log(0, "before: test PSNR %.3f dB, SSIM %.4f", q->psnr, q->ssim);
    return SPIN_OK;
}

static spin_status train_network(struct spin_run *r)
{
    double refined_s = r->report->refine_seconds;

    SPIN_TRY(prepare(r));
    say_plan(r);
    SPIN_TRY(look_at_source(r));
    memset(r->device.seconds, 0, sizeof r->device.seconds);
    r->saved_s = spin_now_s();
    r->worked_s = r->saved_s - refined_s;
    SPIN_TRY(spin_run_loop(r));
    r->report->seconds = r->worked_before_s + spin_now_s() - r->worked_s;
    r->report->seconds_per_iteration = (r->report->seconds - refined_s) / r->o->iterations;
    return spin_run_look(r);
}

static spin_status keep_frames(struct spin_run *r)
{
    struct spin_retrain_report *report = r->report;

    say_plan(r);
    SPIN_TRY(look_at_source(r));
    report->test = report->refined;
    report->iterations = r->o->refine;
    report->seconds = report->refine_seconds;
    report->seconds_per_iteration = report->seconds / r->clip.n_frames / r->o->refine;
    return SPIN_OK;
}

static spin_status plan(struct spin_run *r)
{
    const struct spin_retrain_options *o = r->o;

    SPIN_TRY(spin_run_check(o));
    SPIN_TRY(spin_run_open_clip(r));
    if (o->refine > 0)
        SPIN_TRY(spin_run_refine_plan(r));
    SPIN_TRY(spin_run_plan(r));
    r->report->frames = r->clip.n_frames;
    r->report->splats_mean = r->clip.n_mean;
    r->report->iterations = o->iterations;
    r->report->seconds_estimated = spin_run_guess(r);
    SPIN_TRY(spin_device_open(o->device, o->n_threads, &r->device));
    memcpy(r->report->device, r->device.description, sizeof r->report->device);
    snprintf(r->paths, sizeof r->paths, "%s", r->device.path);
    return SPIN_OK;
}

static void warn_worse(const struct spin_run *r)
{
    const struct spin_quality *before = &r->report->before, *test = &r->report->test;

    if (before->valid && test->valid && test->psnr < before->psnr)
        spin_warn("the result is worse than the source, test PSNR %.3f dB after %.3f dB: try %s",
                  test->psnr, before->psnr,
                  r->o->method == SPIN_METHOD_EXPLICIT
                      ? "a larger --refine, or --refine-start source"
                      : "more --iterations, --preset short, or --residual source");
}

/* What the run is made from, and whether it is there already. */
static spin_status look_at_input(struct spin_run *r)
{
    SPIN_TRY(spin_image_cache_open(&r->clip.views, r->pixels_budget, r->o->background, &r->pixels));
    SPIN_TRY(open_weights(r));
    SPIN_TRY(spin_run_look_at_images(r));
    if (r->refined)
        SPIN_TRY(spin_run_refine_keys(r));
    return spin_run_fingerprint(r);
}

/* Something failed, or was interrupted: what was trained is kept, so that --resume need not do it again. */
static spin_status keep(struct spin_run *r, spin_status failed)
{
    bool lost = false;
    char why[1024], kept[1024] = "";

    snprintf(why, sizeof why, "%s", spin_last_error());
    if (r->sound && r->trainer.iteration > 0 && r->trainer.iteration != r->saved)
        lost = spin_run_save(r) != SPIN_OK;
    if (lost && strcmp(why, spin_last_error()) != 0)
        snprintf(kept, sizeof kept, "; %s", spin_last_error());
    if (failed == SPIN_E_CANCELLED && !lost)
        return spin_fail_cancelled();
    if (r->saved >= 0)
        return spin_fail(failed, "%s%s; the state of iteration %lld is kept in '%s'%s", why, kept,
                         (long long)r->saved, r->part, r->sound ? ": go on with --resume" : "");
    if (!lost && r->refined && spin_path_is_folder(r->parts))
        return spin_fail(failed,
                         "%s; the frames refined so far are kept in '%s': go on with --resume", why,
                         r->parts);
    return spin_fail(failed, "%s%s", why, kept);
}

static spin_status run(struct spin_run *r)
{
    SPIN_TRY(refine(r));
    SPIN_TRY(r->o->method == SPIN_METHOD_NETWORK ? train_network(r) : keep_frames(r));
    warn_worse(r);
    return write_output(r);
}

static spin_status work(struct spin_run *r)
{
    bool done = false;
    spin_status status;

    SPIN_TRY(plan(r));
    if (r->o->dry_run)
        return SPIN_OK;
    SPIN_TRY(spin_claim_take(r->o->output, &r->claim));
    SPIN_TRY(look_at_input(r));
    SPIN_TRY(check_output(r, &done));
    if (done) {
        spin_log(0, "'%s' is already finished", r->o->output);
        return SPIN_OK;
    }
    SPIN_TRY(check_memory(r));
    SPIN_TRY(claim_outputs(r));
    status = run(r);
    if (status != SPIN_OK)
        return keep(r, status);
    r->report->bytes_peak = spin_memory_peak();
    tidy_up(r);
    return SPIN_OK;
}

/* The work is done and kept, but who asked for a log does not have it. */
static spin_status close_log(struct spin_run *r)
{
    if (r->log)
        spin_run_logged(r, true);
    if (r->log && fclose(r->log) != 0)
        snprintf(r->log_error, sizeof r->log_error, "%s", strerror(errno));
    r->log = NULL;
    if (!*r->log_error)
        return SPIN_OK;
    return spin_fail(SPIN_E_IO, "'%s' is written, but the log '%s' is not whole: %s", r->o->output,
                     r->o->log, r->log_error);
}

static void close_all(struct spin_run *r)
{
    spin_claim_drop(&r->claim);
    spin_trainer_close(&r->trainer);
    spin_device_close(&r->device);
    for (int f = 0; r->permutation && f < r->clip.n_frames; f++)
        free(r->permutation[f]);
    free(r->permutation);
    free(r->counts);
    free(r->camera);
    free(r->truth);
    free(r->weight);
    spin_dynamic_mask_close(&r->dynamic);
    free(r->train);
    free(r->test);
    free(r->sequence);
    free(r->refined);
    free(r->part);
    free(r->parts);
    free(r->fingerprint);
    free(r->imprint);
    spin_splats_free(&r->splats);
    spin_splats_free(&r->shelved);
    spin_image_cache_close(&r->pixels);
    spin_clip_close(&r->clip);
}

/* Where the unfinished run lies. */
static spin_status name_parts(struct spin_run *r)
{
    const char *output = r->o->output ? r->o->output : "";
    size_t n = strlen(output) + sizeof ".parts";
    void *block = NULL;

    SPIN_TRY(spin_alloc(n, 1, &block));
    r->part = block;
    snprintf(r->part, n, "%s.part", output);
    block = NULL;
    SPIN_TRY(spin_alloc(n, 1, &block));
    r->parts = block;
    snprintf(r->parts, n, "%s.parts", output);
    return SPIN_OK;
}

spin_status spin_retrain(const struct spin_retrain_options *o, struct spin_retrain_report *report)
{
    struct spin_run r;
    spin_status status;

    memset(&r, 0, sizeof r);
    memset(report, 0, sizeof *report);
    r.o = o;
    r.report = report;
    r.saved = -1;
    status = name_parts(&r);
    if (status == SPIN_OK)
        status = work(&r);
    if (status == SPIN_OK) {
        status = close_log(&r);
    } else {
        if (r.log)
            fclose(r.log);
        if (status != SPIN_E_CANCELLED && o->input)
            status = spin_fail_context(status, "cannot retrain '%s'", o->input);
    }
    close_all(&r);
    return status;
}
