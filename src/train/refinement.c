/* The frame-wise stage of a retraining (method.md section 2): every frame is optimised on its own, with
 * explicit attributes, and its points change in number. Before a network only positions and colours go
 * on; in the explicit method this is all there is.
 *
 * Frames are independent, so some are worked on at a time, each on its share of the threads; since a
 * frame's result does not depend on threads, neither does the whole. A finished frame is put on a shelf
 * beside the output (shelf.h) under a key: what it was made from and how. A frame of the input that
 * was refined under the same key is taken as it is. */
#include <inttypes.h>
#include <math.h>
#include <pthread.h>
#include <stdlib.h>
#include <string.h>

#include "base/err.h"
#include "base/log.h"
#include "base/mem.h"
#include "base/pool.h"
#include "eval/metrics.h"
#include "math/sh.h"
#include "train/refine.h"
#include "train/run.h"

static const unsigned whole = SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES;

static bool is_explicit(const struct spin_run *r) { return r->o->method == SPIN_METHOD_EXPLICIT; }

/* All of a refined frame is wanted, not only where its points lie. */
static bool needs_whole(const struct spin_run *r)
{
    return is_explicit(r) || r->o->residual == SPIN_RESIDUAL_SOURCE;
}

static unsigned kept_columns(const struct spin_run *r)
{
    return needs_whole(r) ? whole : SPIN_COL_MEANS | SPIN_COL_RGB;
}

static bool starts_from_source(const struct spin_run *r)
{
    return r->o->refine_start == SPIN_REFINE_FROM_SOURCE;
}

/* The source's columns that a frame starts from. */
static unsigned start_columns(const struct spin_run *r)
{
    unsigned columns = r->clip.bundle.meta.columns;

    if (starts_from_source(r))
        return whole;
    return SPIN_COL_MEANS | (columns & SPIN_COL_RGB ? SPIN_COL_RGB : columns & SPIN_COL_SH);
}

/* ---- Keys ------------------------------------------------------------------------------------ */

/* All that decides a frame's result besides the frame. */
spin_json *spin_run_refine_settings(const struct spin_run *r)
{
    const struct spin_retrain_options *o = r->o;
    spin_json *j = spin_json_object(), *back = spin_json_array();
    char seed[32];

    for (int c = 0; c < 3; c++)
        spin_json_push_number(back, (double)o->background[c]);
    snprintf(seed, sizeof seed, "%" PRIu64, o->seed);
    spin_json_set_integer(j, "iterations", o->refine);
    spin_json_set_string(j, "start", starts_from_source(r) ? "source" : "points");
    spin_json_set_bool(j, "densify", !o->no_densify);
    spin_json_set_integer(j, "max_points", o->max_points);
    spin_json_set_number(j, "lambda_dssim", o->lambda_dssim);
    spin_json_set(j, "background", back);
    spin_json_set_string(j, "seed", seed);
    spin_json_set_number(j, "image_scale", o->image_scale);
    spin_json_set_number(j, "spatial_extent", r->extent);
    if (o->learn_exposure) /* said only where it is not as 3DGS does it, as what follows */
        spin_json_set_number(j, "lr_exposure", o->lr_exposure);
    if (o->lambda_scale > 0)
        spin_json_set_number(j, "lambda_scale", o->lambda_scale);
    if (o->lambda_opacity > 0)
        spin_json_set_number(j, "lambda_opacity", o->lambda_opacity);
    if (o->antialias)
        spin_json_set_bool(j, "antialias", true);
    if (o->dynamic_weight != 1)
        spin_json_set_number(j, "dynamic_weight", o->dynamic_weight);
    return j;
}

/* FNV-1a, 64 bits. */
static uint64_t hash_of(const char *text)
{
    uint64_t hash = 0xcbf29ce484222325u;

    for (; *text; text++)
        hash = (hash ^ (unsigned char)*text) * 0x100000001b3u;
    return hash;
}

static spin_status make_key(struct spin_run *r, int f)
{
    spin_json *j = spin_run_refine_settings(r);
    char images[20], *text;

    snprintf(images, sizeof images, "%016" PRIx64, spin_run_imprint(r, f));
    spin_json_set_string(j, "images", images);
    spin_json_set_integer(j, "frame", spin_run_info(r, f)->number);
    spin_json_set_integer(
        j, "input", spin_bundle_checksum(&r->clip.bundle, spin_run_index(r, f), start_columns(r)));
    text = spin_json_text(j, false);
    spin_json_free(j);
    if (!text)
        return spin_fail(SPIN_E_MEMORY, "out of memory");
    snprintf(r->refined[f].key, sizeof r->refined[f].key, "%016" PRIx64, hash_of(text));
    free(text);
    return SPIN_OK;
}

spin_status spin_run_refine_plan(struct spin_run *r)
{
    void *block = NULL;

    if (starts_from_source(r) && !spin_run_has_source(r))
        return spin_fail(SPIN_E_NOT_FOUND,
                         "'%s' has no attributes of its source: refine from its points, with "
                         "--refine-start points",
                         r->o->input);
    SPIN_TRY(spin_alloc((size_t)r->clip.n_frames, sizeof *r->refined, &block));
    r->refined = block;
    return SPIN_OK;
}

spin_status spin_run_refine_keys(struct spin_run *r)
{
    for (int f = 0; f < r->clip.n_frames; f++)
        SPIN_TRY(make_key(r, f));
    return SPIN_OK;
}

/* ---- Frames that are there ------------------------------------------------------------------- */

/* The input was refined under this key, and kept what we need of it. */
static bool input_has(struct spin_run *r, int f)
{
    const struct spin_bundle *bundle = &r->clip.bundle;
    const spin_json *frames = spin_json_get(spin_json_get(bundle->json, "refined"), "frames");
    const char *key;
    unsigned columns = bundle->refined.columns;
    int index = spin_run_index(r, f);

    if (!(columns & SPIN_COL_MEANS) || (needs_whole(r) && (whole & ~columns)) ||
        !(columns & (SPIN_COL_RGB | SPIN_COL_SH)))
        return false;
    key = spin_json_string(spin_json_get(spin_json_at(frames, (size_t)index), "key"));
    if (!key || strcmp(key, r->refined[f].key) != 0)
        return false;
    r->refined[f].from_input = true;
    r->refined[f].n = bundle->refined.n[index];
    return true;
}

static spin_status read_columns(struct spin_run *r, int f, unsigned columns,
                                struct spin_splats *out)
{
    if (r->refined[f].from_input)
        return spin_bundle_refined_frame(&r->clip.bundle, spin_run_index(r, f), columns, out);
    return spin_frame_cache_get(r->parts, f, r->refined[f].key, columns, out);
}

/* rgb is kept by the network's method only; elsewhere it follows from the first coefficient. */
spin_status spin_run_refined(struct spin_run *r, int f, unsigned columns, struct spin_splats *out)
{
    unsigned there = r->refined[f].from_input ? r->clip.bundle.refined.columns : whole;

    if (!(columns & SPIN_COL_RGB & ~there))
        return read_columns(r, f, columns, out);
    SPIN_TRY(read_columns(r, f, SPIN_COL_MEANS | SPIN_COL_SH, &r->shelved));
    SPIN_TRY(spin_splats_reserve(out, r->shelved.n, columns, 0));
    for (size_t i = 0; i < 3 * out->n; i++) {
        size_t width = spin_column_width(SPIN_COL_SH, r->shelved.sh_degree);
        double c = SPIN_SH_C0 * (double)r->shelved.sh[i / 3 * width + i % 3] + 0.5;

        out->means[i] = r->shelved.means[i];
        out->rgb[i] = (float)fmin(fmax(c, 0), 1);
    }
    return SPIN_OK;
}

/* ---- One frame ------------------------------------------------------------------------------- */

struct stage {
    struct spin_run *r;
    struct spin_refine_options options;
    int *todo, n_todo;        /* frames */
    int first;                /* of those under way */
    int n_hands;              /* frames worked on at a time */
    struct spin_device *hand; /* [n_hands] */
    pthread_mutex_t lock;     /* for all that follows, and for files, pixels, progress and log */
    struct spin_progress progress;
    int64_t done;         /* iterations */
    int64_t drawn, blind; /* iterations with a view; of them, those that showed no splat */
    double start_s;
    spin_status status; /* of the first that failed */
    char why[512];
};

struct job {
    struct stage *stage;
    int frame;
    struct spin_refine_view *view; /* [n_views] */
    const struct spin_pair **pair; /* [n_views] */
    int n_views;
    float *truth, *weight;
    struct spin_refine_cloud cloud;
    struct spin_splats splats;
};

static void log_iteration(const struct job *job, const struct spin_refine_step *step)
{
    struct spin_run *r = job->stage->r;

    fprintf(r->log,
            "{\"refine\": %d, \"frame\": %d, \"seconds\": %.3f, \"loss\": %.7g, \"splats\": %zu, "
            "\"camera\": %d",
            step->iteration, spin_run_info(r, job->frame)->number,
            spin_now_s() - job->stage->start_s, step->loss, step->n,
            r->clip.views.view[job->pair[step->view]->view].camera_id);
    if (step->densified)
        fprintf(r->log, ", \"clones\": %zu, \"splits\": %zu, \"pruned\": %zu", step->change.clones,
                step->change.splits, step->change.pruned);
    fprintf(r->log, "}\n");
    spin_run_logged(r, false);
}

static void watch(void *context, const struct spin_refine_step *step)
{
    const struct job *job = context;
    struct stage *stage = job->stage;

    pthread_mutex_lock(&stage->lock);
    stage->done++;
    if (stage->r->log)
        log_iteration(job, step);
    spin_progress_set(&stage->progress, stage->done, "frame %d, loss %.4f, %zu splats",
                      spin_run_info(stage->r, job->frame)->number, step->loss, step->n);
    pthread_mutex_unlock(&stage->lock);
}

/* The training views of the frame with their pictures. */
static spin_status load_views(struct job *job)
{
    struct spin_run *r = job->stage->r;
    void *view = NULL, *pair = NULL, *truth = NULL, *weight = NULL;
    size_t n = 0;

    for (size_t i = 0; i < r->n_train; i++)
        n += r->train[i].frame == job->frame;
    SPIN_TRY(spin_alloc(n + 1, sizeof *job->view, &view));
    job->view = view;
    SPIN_TRY(spin_alloc(n + 1, sizeof *job->pair, &pair));
    job->pair = pair;
    SPIN_TRY(spin_alloc(n * 3 * r->max_pixels + 1, sizeof(float), &truth));
    job->truth = truth;
    if (r->weight) {
        SPIN_TRY(spin_alloc(n * r->max_pixels + 1, sizeof(float), &weight));
        job->weight = weight;
    }
    for (size_t i = 0; i < r->n_train; i++) {
        float *at = job->truth + (size_t)job->n_views * 3 * r->max_pixels;

        if (r->train[i].frame != job->frame)
            continue;
        SPIN_TRY(spin_image_cache_get(&r->pixels, r->train[i].view, at));
        job->pair[job->n_views] = &r->train[i];
        if (r->weight) {
            float *w = job->weight + (size_t)job->n_views * r->max_pixels;

            SPIN_TRY(spin_run_weigh(r, r->train[i].view, at, w));
            job->view[job->n_views].weight = w;
        }
        job->view[job->n_views].camera = r->clip.views.view[r->train[i].view].camera;
        job->view[job->n_views++].truth = at;
    }
    return SPIN_OK;
}

static spin_status load_start(struct job *job)
{
    struct spin_run *r = job->stage->r;
    struct spin_splats *s = &job->splats;

    SPIN_TRY(
        spin_bundle_frame(&r->clip.bundle, spin_run_index(r, job->frame), start_columns(r), s));
    if (starts_from_source(r)) {
        SPIN_TRY(spin_refine_init_from_splats(s, &job->cloud));
        spin_refine_prune(&job->cloud, 0); /* values that are not finite */
        return SPIN_OK;
    }
    return spin_refine_init_from_colours(s, &job->cloud);
}

static spin_status load(struct job *job)
{
    spin_status status;

    pthread_mutex_lock(&job->stage->lock);
    status = load_views(job);
    if (status == SPIN_OK)
        status = load_start(job);
    pthread_mutex_unlock(&job->stage->lock);
    return status;
}

static spin_status keep(struct job *job, const struct spin_refine_stats *stats)
{
    struct stage *stage = job->stage;
    struct spin_run *r = stage->r;
    struct spin_refined *refined = &r->refined[job->frame];

    SPIN_TRY(spin_refine_to_splats(&job->cloud, &job->splats));
    SPIN_TRY(
        spin_frame_cache_put(r->parts, job->frame, refined->key, r->device.path, &job->splats));
    pthread_mutex_lock(&stage->lock);
    refined->n = job->splats.n;
    stage->done += stage->options.iterations - stats->iterations;
    stage->drawn += stats->iterations;
    stage->blind += stats->blind;
    r->report->loss_last += stats->loss_last / stage->n_todo;
    spin_log(1, "frame %d: %zu splats became %zu, loss %.4f became %.4f",
             spin_run_info(r, job->frame)->number, stats->n_first, stats->n_last, stats->loss_first,
             stats->loss_last);
    pthread_mutex_unlock(&stage->lock);
    return SPIN_OK;
}

static spin_status refine(struct job *job, struct spin_device *device)
{
    struct spin_refine_options o = job->stage->options;
    struct spin_refine_stats stats = {0};

    o.densify.frame = spin_run_info(job->stage->r, job->frame)->number;
    o.watch = watch;
    o.context = job;
    SPIN_TRY(load(job));
    stats.n_first = stats.n_last = job->cloud.n;
    if (job->n_views > 0)
        SPIN_TRY(spin_refine_frame(device, &o, job->view, job->n_views, NULL, &job->cloud, &stats));
    if (!isfinite(stats.loss_last))
        return spin_fail(SPIN_E_MALFORMED, "the loss is not finite; look for bad points");
    return keep(job, &stats);
}

static void refine_task(void *context, int task, int hand)
{
    struct stage *stage = context;
    struct job job = {.stage = stage, .frame = stage->todo[stage->first + task]};
    spin_status status;

    pthread_mutex_lock(&stage->lock);
    status = stage->status;
    pthread_mutex_unlock(&stage->lock);
    if (status != SPIN_OK)
        return;
    status = refine(&job, &stage->hand[hand]);
    if (status != SPIN_OK) {
        pthread_mutex_lock(&stage->lock);
        if (stage->status == SPIN_OK) {
            stage->status = status;
            snprintf(stage->why, sizeof stage->why, "frame %d: %s",
                     spin_run_info(stage->r, job.frame)->number, spin_last_error());
        }
        pthread_mutex_unlock(&stage->lock);
    }
    free(job.view);
    free(job.pair);
    free(job.truth);
    free(job.weight);
    spin_refine_cloud_free(&job.cloud);
    spin_splats_free(&job.splats);
}

/* ---- All frames ------------------------------------------------------------------------------ */

static void set_options(struct stage *stage)
{
    const struct spin_retrain_options *from = stage->r->o;
    struct spin_refine_options *o = &stage->options;

    spin_refine_defaults(o);
    o->iterations = from->refine;
    o->lambda_dssim = from->lambda_dssim;
    memcpy(o->background, from->background, sizeof o->background);
    if (from->no_densify)
        o->densify_until = 0;
    o->lr_exposure = from->learn_exposure ? from->lr_exposure : 0;
    o->lambda_scale = from->lambda_scale;
    o->lambda_opacity = from->lambda_opacity;
    o->antialias = from->antialias;
    o->densify.extent = stage->r->extent;
    o->densify.max_points = (size_t)from->max_points;
    o->densify.seed = from->seed;
}

size_t spin_run_refine_bytes(const struct spin_run *r)
{
    size_t n_views = 0;

    for (size_t i = 0; i < r->n_train; i++)
        n_views += r->train[i].frame == r->train[0].frame;
    return spin_refine_bytes(2 * r->clip.n_max, r->max_pixels) +
           n_views * (r->o->dynamic_weight != 1 ? 4 : 3) * r->max_pixels * sizeof(float);
}

/* Which frames are still to be done. */
static spin_status list_todo(struct stage *stage)
{
    struct spin_run *r = stage->r;
    void *block = NULL;

    SPIN_TRY(spin_alloc((size_t)r->clip.n_frames, sizeof *stage->todo, &block));
    stage->todo = block;
    for (int f = 0; f < r->clip.n_frames; f++) {
        bool found = input_has(r, f), shelved = false;
        struct spin_shelved there;

        if (!found && r->o->resume)
            SPIN_TRY(spin_frame_cache_find(r->parts, f, r->refined[f].key, &shelved, &there));
        if (shelved) {
            r->refined[f].n = there.n;
            spin_run_did(r, there.path);
        }
        if (!found && !shelved)
            stage->todo[stage->n_todo++] = f;
    }
    return SPIN_OK;
}

/* A device for each of n frames worked on at a time, as far as threads and memory go. */
static spin_status take_hands(struct stage *stage, int n, int n_threads)
{
    struct spin_run *r = stage->r;
    void *block = NULL;

    n = n < n_threads ? n : n_threads;
    if (strcmp(r->device.op->name, "cpu") != 0)
        n = 1;
    while (n > 1 && (size_t)n * spin_run_refine_bytes(r) > r->report->bytes_available / 2)
        n--;
    SPIN_TRY(spin_alloc((size_t)n, sizeof *stage->hand, &block));
    stage->hand = block;
    for (int i = 0; i < n; i++) {
        SPIN_TRY(spin_device_open(r->o->device, n_threads / n, &stage->hand[i]));
        stage->n_hands++;
    }
    return SPIN_OK;
}

static void drop_hands(struct stage *stage)
{
    for (int i = 0; i < stage->n_hands; i++)
        spin_device_close(&stage->hand[i]);
    free(stage->hand);
    stage->hand = NULL;
    stage->n_hands = 0;
}

/* The next n of the frames to do, side by side. */
static spin_status run_tasks(struct stage *stage, int n, int n_threads)
{
    struct spin_pool *pool = NULL;
    spin_status status;

    SPIN_TRY_OUT(take_hands(stage, n, n_threads));
    if (stage->n_hands > 1)
        SPIN_TRY_OUT(spin_pool_create(stage->n_hands, &pool));
    spin_pool_run(pool, n, refine_task, stage);
    stage->first += n;
    if (stage->status == SPIN_E_CANCELLED)
        status = spin_fail_cancelled();
    else if (stage->status != SPIN_OK)
        status = spin_fail(stage->status, "%s", stage->why);
out:
    spin_pool_free(pool);
    drop_hands(stage);
    return status;
}

/* Full rows of frames first, a thread to each; then those left over, which share the threads. */
static spin_status run(struct stage *stage)
{
    struct spin_pool *pool = NULL;
    int n_threads;

    SPIN_TRY(spin_pool_create(stage->r->o->n_threads, &pool));
    n_threads = spin_pool_n_threads(pool);
    spin_pool_free(pool);
    while (stage->first < stage->n_todo) {
        int left = stage->n_todo - stage->first;

        SPIN_TRY(run_tasks(stage, left < n_threads ? left : left - left % n_threads, n_threads));
    }
    return SPIN_OK;
}

/* From here on the clip's splats are the refined ones. */
static spin_status count_splats(struct spin_run *r)
{
    r->clip.n_max = 0;
    r->clip.n_mean = 0;
    for (int f = 0; f < r->clip.n_frames; f++) {
        r->counts[f] = r->refined[f].n;
        r->clip.n_max = r->counts[f] > r->clip.n_max ? r->counts[f] : r->clip.n_max;
        r->clip.n_mean += (double)r->counts[f] / r->clip.n_frames;
    }
    if (r->clip.n_max == 0)
        return spin_fail(SPIN_E_MALFORMED, "refining left no splat in any frame");
    r->is_refined = true;
    return SPIN_OK;
}

static bool can_be_drawn(const struct spin_run *r)
{
    bool input = !(whole & ~r->clip.bundle.refined.columns);

    for (int f = 0; f < r->clip.n_frames; f++)
        if (r->refined[f].from_input && !input)
            return false;
    return true;
}

static spin_status read_whole(void *context, int frame, struct spin_splats *out)
{
    const struct spin_run *r = context;

    SPIN_TRY(spin_run_refined(context, frame, whole, out));
    out->antialias = r->o->antialias;
    return SPIN_OK;
}

static spin_status look(struct spin_run *r)
{
    struct spin_quality *q = &r->report->refined;
    struct spin_frame_renderer frame_renderer;
    spin_status status;

    if (!can_be_drawn(r))
        return SPIN_OK;
    spin_frame_renderer_open_reader(&frame_renderer, &r->device, read_whole, r);
    status = spin_run_measure(r, &frame_renderer, r->counts, "evaluating the refined frames", q);
    spin_frame_renderer_close(&frame_renderer);
    if (status == SPIN_OK && q->valid)
        spin_log(0, "refined: %.1f splats a frame, test PSNR %.3f dB, SSIM %.4f", r->clip.n_mean,
                 q->psnr, q->ssim);
    if (status == SPIN_OK) {
        spin_frame_renderer_open_reader(&frame_renderer, &r->device, read_whole, r);
        status = spin_run_preview(r, &frame_renderer, "refined");
        spin_frame_renderer_close(&frame_renderer);
    }
    return status;
}

/* Iterations that showed nothing taught nothing. */
static spin_status judge_blind(const struct stage *stage)
{
    if (stage->blind == 0)
        return SPIN_OK;
    if (stage->blind == stage->drawn && stage->n_todo == stage->r->clip.n_frames)
        return spin_fail(SPIN_E_MALFORMED,
                         "no splat is visible in any view of any frame: do the cameras belong to "
                         "these points");
    spin_warn("no splat was visible in %lld of %lld iterations of refining: nothing was learned in "
              "them",
              (long long)stage->blind, (long long)stage->drawn);
    return SPIN_OK;
}

spin_status spin_run_refine(struct spin_run *r)
{
    struct stage stage = {.r = r, .lock = PTHREAD_MUTEX_INITIALIZER, .start_s = spin_now_s()};
    spin_status status;

    if (!r->o->resume)
        spin_frame_cache_clear(r->parts);
    set_options(&stage);
    SPIN_TRY_OUT(list_todo(&stage));
    spin_log(0, "refining %d of %d frames, %d iterations each", stage.n_todo, r->clip.n_frames,
             r->o->refine);
    spin_progress_begin(&stage.progress, "refining", "it", 0,
                        (long long)stage.n_todo * r->o->refine);
    status = run(&stage);
    spin_progress_end(&stage.progress);
    if (status == SPIN_OK)
        status = judge_blind(&stage);
    r->report->refine_seconds = spin_now_s() - stage.start_s;
    if (status == SPIN_OK)
        status = count_splats(r);
    if (status == SPIN_OK)
        status = look(r);
out:
    free(stage.todo);
    pthread_mutex_destroy(&stage.lock);
    return status;
}

/* ---- The output ------------------------------------------------------------------------------ */

spin_status spin_run_write_refined(struct spin_run *r, struct spin_bundle_writer *w)
{
    unsigned columns = kept_columns(r);

    for (int f = 0; f < r->clip.n_frames; f++) {
        SPIN_TRY(spin_run_refined(r, f, columns, &r->splats));
        SPIN_TRY(spin_bundle_write_refined(w, f, columns, &r->splats));
    }
    return SPIN_OK;
}

spin_json *spin_run_refined_to_json(const struct spin_run *r)
{
    spin_json *j = spin_json_object(), *frames = spin_json_array();

    for (int f = 0; f < r->clip.n_frames; f++) {
        spin_json *frame = spin_json_object();

        spin_json_set_integer(frame, "n", (int64_t)r->refined[f].n);
        spin_json_set_string(frame, "key", r->refined[f].key);
        spin_json_push(frames, frame);
    }
    spin_json_set(j, "columns", spin_column_names(kept_columns(r)));
    spin_json_set_integer(j, "sh_degree", needs_whole(r) ? 0 : -1);
    if (r->o->antialias)
        spin_json_set_bool(j, "antialias", true);
    spin_json_set(j, "options", spin_run_refine_settings(r));
    spin_json_set(j, "frames", frames);
    return j;
}
