/* Refines frames. The training of a clip starts from the positions and colours of refined frames
 * or, with --residual source, from all their attributes. With --method frames the refined frames
 * are the result.
 *
 * Frames are independent, so several frames are refined at a time, each on a part of the threads.
 * The results do not depend on the number of threads. Finished frames are stored in a cache with a
 * key that identifies their inputs and options. If the input contains a refined frame with the same
 * key, it is used instead of refining the frame again. */
#include "train/refinement.h"

#include <ctype.h>
#include <inttypes.h>
#include <unistd.h>

#include "base/base.h"
#include "math/sh.h"
#include "scene/bundle.h"
#include "train/loop.h"
#include "train/options.h"
#include "train/photos.h"
#include "train/train_frame.h"

/* ---- Settings -------------------------------------------------------------------------------- */

spin_json *spin_settings_refine(const struct spin_plan *plan)
{
    spin_json *j = spin_options_to_json(plan->o, SPIN_OPTIONS_OF_REFINEMENT);

    spin_json_set_number(j, "spatial_extent", plan->extent);
    if (spin_plan_frame_sh_degree(plan) > 0) {
        spin_json_set_integer(j, "sh_degree", spin_plan_frame_sh_degree(plan));
        spin_json_set_integer(j, "sh_increase_every", spin_plan_sh_increase_every(plan));
    }
    return j;
}

spin_json *spin_settings_network(const struct spin_plan *plan)
{
    spin_json *j = spin_options_to_json(plan->o, SPIN_OPTIONS_OF_NETWORK);
    spin_json *test = spin_json_array();

    for (size_t i = 0; i < plan->clip.views.n; i++)
        if (plan->clip.views.view[i].test &&
            plan->clip.views.view[i].dataset_frame == plan->clip.dataset_frame[0])
            spin_json_push_number(test, plan->clip.views.view[i].camera_id);
    spin_json_set_number(j, "spatial_extent", plan->extent);
    spin_json_set(j, "test_cameras", test);
    if (plan->o->refine > 0)
        spin_json_set(j, "refine", spin_settings_refine(plan));
    return j;
}

/* ---- Keys and fingerprints ------------------------------------------------------------------- */

/* Fingerprints are JSON texts, and keys are hashes of such texts. */

static void add_images(spin_json *j, const struct spin_plan *plan, const struct spin_photos *photos,
                       int frame)
{
    char text[20];

    snprintf(text, sizeof text, "%016" PRIx64, spin_photos_digest(photos, plan, frame));
    spin_json_set_string(j, "images", text);
}

/* Adds a hash of the names, sizes and CRCs of the input's arrays. Since names are included, an
 * input with swapped or renamed arrays has another hash. */
static void add_members(spin_json *j, const struct spin_zip *zip)
{
    uint64_t hash = SPIN_HASH_BEGIN;
    char text[20];

    for (size_t i = 0; i < zip->n; i++) {
        const struct spin_zip_member *m = &zip->member[i];

        spin_hash(&hash, m->name, strlen(m->name) + 1);
        spin_hash(&hash, &m->size, sizeof m->size);
        spin_hash(&hash, &m->crc, sizeof m->crc);
    }
    snprintf(text, sizeof text, "%016" PRIx64, hash);
    spin_json_set_string(j, "input", text);
}

spin_status spin_frame_key(struct spin_plan *plan, const struct spin_photos *photos, int f,
                           char key[SPIN_FRAME_KEY])
{
    SPIN_FREED char *text = NULL;
    uint64_t hash = SPIN_HASH_BEGIN;
    uint32_t input;
    spin_json *j;

    SPIN_TRY(spin_bundle_checksum(&plan->clip.bundle, spin_plan_index(plan, f),
                                  spin_plan_start_columns(plan), &input));
    j = spin_settings_refine(plan);
    add_images(j, plan, photos, f);
    spin_json_set_integer(j, "frame", spin_plan_info(plan, f)->number);
    spin_json_set_integer(j, "input", input);
    if (plan->o->learn_exposure == SPIN_EXPOSURE_ON)
        spin_json_set(j, "lenses", spin_lenses_to_json(&plan->lenses));
    text = spin_json_text(j, false);
    spin_json_free(j);
    if (!text)
        return spin_fail(SPIN_E_MEMORY, "out of memory while computing the key of a frame");
    spin_hash(&hash, text, strlen(text));
    snprintf(key, SPIN_FRAME_KEY, "%016" PRIx64, hash);
    return SPIN_OK;
}

spin_status spin_fingerprint(const struct spin_plan *plan, const struct spin_refined *refined,
                             const struct spin_photos *photos, const struct spin_device *device,
                             char **out)
{
    const struct spin_retrain_options *o = plan->o;
    bool network = o->method != SPIN_METHOD_FRAMES;
    spin_json *j = network ? spin_field_to_json(&plan->field, true) : spin_json_object();
    spin_json *frames = spin_json_array();

    if (network) { /* these members and the input determine the scene transform */
        spin_json_set_integer(j, "normalise", o->normalise);
        spin_json_set(j, "options", spin_settings_network(plan));
        spin_json_set_string(j, "device", device->op->name);
    }
    for (int f = 0; f < plan->clip.n_frames; f++) {
        spin_json_push_number(frames, spin_plan_info(plan, f)->number);
        spin_json_push_number(frames, (double)plan->counts[f]);
        if (refined)
            spin_json_push_string(frames, refined[f].key);
    }
    spin_json_set(j, "frames", frames);
    add_images(j, plan, photos, -1);
    add_members(j, &plan->clip.bundle.npz.zip);
    *out = spin_json_text(j, false);
    spin_json_free(j);
    return *out ? SPIN_OK
                : spin_fail(SPIN_E_MEMORY,
                            "out of memory while computing the fingerprint of the run");
}

static const unsigned whole = SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES;
static bool is_per_frame(const struct spin_plan *plan)
{
    return plan->o->method == SPIN_METHOD_FRAMES;
}

/* True if all attributes of refined frames are needed, false if positions and colours suffice. */
static bool needs_whole(const struct spin_plan *plan)
{
    return is_per_frame(plan) || plan->o->residual == SPIN_RESIDUAL_SOURCE;
}

unsigned spin_refinement_columns(const struct spin_plan *plan)
{
    return needs_whole(plan) ? whole : SPIN_COL_MEANS | SPIN_COL_RGB;
}

/* ---- Open and close -------------------------------------------------------------------------- */

spin_status spin_refinement_open(struct spin_refinement *refinement, const struct spin_plan *plan)
{
    size_t n = (size_t)plan->clip.n_frames;

    if (spin_plan_starts_from_source(plan) && !spin_plan_has_source(plan))
        return spin_not_found("'%s' does not contain the attributes of its source, which "
                              "--refine-start source needs: use --refine-start points",
                              plan->o->input);
    SPIN_TRY(spin_alloc(n, sizeof *refinement->frame, (void **)&refinement->frame));
    SPIN_TRY(spin_alloc(n, sizeof *refinement->counts, (void **)&refinement->counts));
    return SPIN_OK;
}

spin_status spin_refinement_keys(struct spin_refinement *refinement, struct spin_plan *plan,
                                 const struct spin_photos *photos)
{
    for (int f = 0; f < plan->clip.n_frames; f++)
        SPIN_TRY(spin_frame_key(plan, photos, f, refinement->frame[f].key));
    return SPIN_OK;
}

void spin_refinement_close(struct spin_refinement *refinement)
{
    free(refinement->frame);
    free(refinement->counts);
    spin_splats_free(&refinement->scratch);
}

/* ---- Frames refined before ------------------------------------------------------------------- */

/* True if the input contains the refined frame f with the key of this run and with all required
 * columns. Then sets from_input and the number of splats of the frame. */
static bool input_has(struct spin_refinement *r, const struct spin_plan *plan, int f)
{
    const struct spin_bundle *bundle = &plan->clip.bundle;
    const spin_json *frames = spin_json_get(spin_json_get(bundle->json, "refined"), "frames");
    const char *key;
    unsigned columns = bundle->refined.columns;
    int index = spin_plan_index(plan, f);

    if (!(columns & SPIN_COL_MEANS) || (needs_whole(plan) && (whole & ~columns)) ||
        !(columns & (SPIN_COL_RGB | SPIN_COL_SH)))
        return false;
    key = spin_json_string(spin_json_get(spin_json_at(frames, (size_t)index), "key"));
    if (!key || strcmp(key, r->frame[f].key) != 0)
        return false;
    r->frame[f].from_input = true;
    r->counts[f] = bundle->refined.n[index];
    return true;
}

static spin_status read_columns(const struct spin_refinement *r, struct spin_plan *plan, int f,
                                unsigned columns, struct spin_splats *out)
{
    if (r->frame[f].from_input)
        return spin_bundle_refined_frame(&plan->clip.bundle, spin_plan_index(plan, f), columns,
                                         out);
    return spin_frame_cache_get(plan->parts, spin_plan_index(plan, f), r->frame[f].key, columns,
                                out);
}

/* Refined frames in the input have the column rgb if the training that wrote them needed only their
 * positions and colours; cached frames never have it. If it is missing, it is computed from the
 * first SH coefficient. */
spin_status spin_refinement_read(struct spin_refinement *r, struct spin_plan *plan, int f,
                                 unsigned columns, struct spin_splats *out)
{
    unsigned there = r->frame[f].from_input ? plan->clip.bundle.refined.columns : whole;

    if (!(columns & SPIN_COL_RGB & ~there))
        return read_columns(r, plan, f, columns, out);
    SPIN_TRY(read_columns(r, plan, f, SPIN_COL_MEANS | SPIN_COL_SH, &r->scratch));
    SPIN_TRY(spin_splats_reserve(out, r->scratch.n, columns, 0));
    for (size_t i = 0; i < 3 * out->n; i++) {
        size_t width = spin_column_width(SPIN_COL_SH, r->scratch.sh_degree);
        double c = SPIN_SH_C0 * (double)r->scratch.sh[i / 3 * width + i % 3] + 0.5;

        out->means[i] = r->scratch.means[i];
        out->rgb[i] = (float)fmin(fmax(c, 0), 1);
    }
    return SPIN_OK;
}

/* ---- One frame ------------------------------------------------------------------------------- */

struct stage {
    struct spin_refinement *refinement;
    struct spin_plan *plan;
    struct spin_photos *photos;
    struct spin_device *device; /* device of the run */
    struct spin_simd_paths *simd_paths;
    struct spin_step_log *step_log;
    /* Frames that this rank refines. */
    int *todo, n_todo;
    /* Frames that all ranks together refine. */
    int *all, n_all;
    int first;                /* index in `todo` of the first frame of the current run_tasks() */
    int n_hands;              /* number of frames that are refined at a time */
    struct spin_device *hand; /* [n_hands] devices, one for each frame that is refined at a time */
    /* Protects all members below, and access to files, images, progress display and log. */
    pthread_mutex_t lock;
    struct spin_progress progress;
    int64_t done; /* number of finished iterations in the progress display */
    /* Number of iterations of finished frames, and number of these without a visible splat. */
    int64_t drawn, blind;
    double start_s;
    spin_status status; /* status of the first frame that failed; SPIN_OK if none has failed */
    char why[512];
};

struct job {
    struct stage *stage;
    int frame;
    struct spin_plan plan; /* plan of this single frame */
    struct spin_sampler sampler;
    struct spin_trainer trainer;
    struct spin_checkpoint clock;
    struct spin_steps steps;
    double loss_first;
    size_t n_first;
    struct spin_refine_cloud cloud;
    struct spin_splats splats;
};

static void close_job(struct job *job)
{
    spin_trainer_close(&job->trainer);
    spin_sampler_close(&job->sampler);
    spin_plan_close_frame(&job->plan);
    spin_refine_cloud_free(&job->cloud);
    spin_splats_free(&job->splats);
}

static spin_status load_start(struct job *job)
{
    struct spin_plan *plan = job->stage->plan;
    struct spin_splats *s = &job->splats;
    int degree = job->plan.field.sh_degree;

    SPIN_TRY(spin_bundle_frame(&plan->clip.bundle, spin_plan_index(plan, job->frame),
                               spin_plan_start_columns(plan), s));
    if (spin_plan_starts_from_source(plan))
        SPIN_TRY(spin_refine_init_from_splats(s, &job->cloud));
    else {
        SPIN_TRY(spin_refine_init_from_colours(s, &job->cloud));
        SPIN_TRY(spin_show_unseen(&job->plan, s, 0, &job->cloud));
    }
    if (degree > 0)
        SPIN_TRY(
            spin_refine_add_sh(degree, spin_plan_starts_from_source(plan) ? s : NULL, &job->cloud));
    spin_refine_prune(&job->cloud, 0); /* removes only non-finite splats */
    return SPIN_OK;
}

/* Makes the plan of the frame, loads the images of the frame, and computes its initial splats. */
static spin_status load_job(struct job *job, struct spin_device *device)
{
    struct stage *stage = job->stage;
    spin_status status;

    pthread_mutex_lock(&stage->lock);
    SPIN_TRY_OUT(spin_plan_of_frame(stage->plan, job->frame, device, &job->plan));
    if (job->plan.n_train > 0)
        SPIN_TRY_OUT(spin_sampler_open(&job->sampler, &job->plan, stage->photos));
    status = load_start(job);
out:
    pthread_mutex_unlock(&stage->lock);
    return status;
}

static void show_progress(const struct job *job)
{
    struct stage *stage = job->stage;

    pthread_mutex_lock(&stage->lock);
    spin_progress_set(&stage->progress, ++stage->done, "frame %d, loss %.4f, %zu splats",
                      spin_plan_info(stage->plan, job->frame)->number, job->steps.last.loss,
                      job->trainer.frame[0].size.n);
    pthread_mutex_unlock(&stage->lock);
}

/* Trains the splats of job->cloud and stores the result in job->cloud. Stops early if densification
 * has removed all splats of the frame. */
static spin_status train_cloud(struct job *job, struct spin_device *device)
{
    size_t n = job->cloud.n;
    struct spin_frame_size frame = {n, n, n, n};
    struct spin_trainer_size size = {.n_frames = 1, .frame = &frame, .tracked = true};
    struct spin_trainer *t = &job->trainer;
    const struct spin_loop loop =
        spin_loop_of(&job->plan, job->stage->photos, t, &job->clock, job->stage->step_log);

    job->clock.start_s = job->stage->start_s;
    SPIN_TRY(spin_plan_open_trainer(&job->plan, device, &size, t));
    SPIN_TRY(spin_refine_cloud_send(&job->cloud, device, &t->frame[0]));
    while (t->iteration < job->plan.o->iterations && t->frame[0].size.n > 0) {
        if (spin_cancelled())
            return spin_fail_cancelled();
        SPIN_TRY(spin_loop_step(&loop, &job->sampler, &job->steps));
        if (t->iteration == 1)
            job->loss_first = job->steps.last.loss;
        show_progress(job);
    }
    SPIN_TRY(spin_refine_cloud_reserve(&job->cloud, t->frame[0].size.n));
    job->cloud.n = t->frame[0].size.n;
    SPIN_TRY(spin_refine_cloud_fetch(&job->cloud, device, &t->frame[0]));
    spin_refine_prune(&job->cloud, spin_prune_opacity);
    return SPIN_OK;
}

static spin_status store_frame(struct job *job)
{
    struct stage *stage = job->stage;
    struct spin_plan *plan = stage->plan;
    const struct spin_steps *steps = &job->steps;

    SPIN_TRY(spin_refine_to_splats(&job->cloud, &job->splats));
    SPIN_TRY(spin_frame_cache_put(plan->parts, spin_plan_index(plan, job->frame),
                                  stage->refinement->frame[job->frame].key, stage->device->path,
                                  &job->splats));
    pthread_mutex_lock(&stage->lock);
    stage->refinement->counts[job->frame] = job->splats.n;
    stage->done += plan->o->refine - steps->done;
    stage->drawn += steps->done;
    stage->blind += steps->blind;
    plan->report->loss_last += steps->last.loss / stage->n_all;
    spin_log(1, "frame %d: %zu splats became %zu, loss %.4f became %.4f",
             spin_plan_info(plan, job->frame)->number, job->n_first, job->splats.n, job->loss_first,
             steps->last.loss);
    pthread_mutex_unlock(&stage->lock);
    return SPIN_OK;
}

static spin_status refine_frame(struct job *job, struct spin_device *device)
{
    SPIN_TRY(load_job(job, device));
    job->n_first = job->cloud.n;
    if (job->plan.n_train > 0 && job->cloud.n > 0)
        SPIN_TRY(train_cloud(job, device));
    return store_frame(job);
}

static void refine_task(void *context, int task)
{
    struct stage *stage = context;
    struct job job = {.stage = stage, .frame = stage->todo[stage->first + task]};
    spin_status status;

    pthread_mutex_lock(&stage->lock);
    status = stage->status;
    pthread_mutex_unlock(&stage->lock);
    if (status != SPIN_OK)
        return;
    status = refine_frame(&job, &stage->hand[spin_pool_worker()]);
    if (status != SPIN_OK) {
        pthread_mutex_lock(&stage->lock);
        if (stage->status == SPIN_OK) {
            stage->status = status;
            snprintf(stage->why, sizeof stage->why, "frame %d: %s",
                     spin_plan_info(stage->plan, job.frame)->number, spin_last_error());
        }
        pthread_mutex_unlock(&stage->lock);
    }
    close_job(&job);
}

/* ---- All frames ------------------------------------------------------------------------------ */

/* Sets *found to whether frame f is in the cache; if it is, records its number of splats, and the
 * SIMD path of the device that refined it. */
static spin_status find_cached(struct stage *stage, int f, bool *found)
{
    struct spin_refinement *r = stage->refinement;
    struct spin_shelved there;

    SPIN_TRY(spin_frame_cache_find(stage->plan->parts, spin_plan_index(stage->plan, f),
                                   r->frame[f].key, found, &there));
    if (*found) {
        r->counts[f] = there.n;
        spin_simd_paths_add(stage->simd_paths, there.path);
    }
    return SPIN_OK;
}

/* Lists the frames to refine, that is, those that are neither in the input nor in the cache: all of
 * them in stage->all, those of this rank in stage->todo. */
static spin_status list_todo(struct stage *stage)
{
    struct spin_plan *plan = stage->plan;

    SPIN_TRY(
        spin_alloc((size_t)plan->clip.n_frames, 2 * sizeof *stage->todo, (void **)&stage->todo));
    stage->all = stage->todo + plan->clip.n_frames;
    for (int f = 0; f < plan->clip.n_frames; f++) {
        bool found = input_has(stage->refinement, plan, f);

        if (!found && (plan->o->resume || plan->o->cache))
            SPIN_TRY(find_cached(stage, f, &found));
        if (found)
            continue;
        if (stage->n_all % spin_n_ranks() == spin_rank())
            stage->todo[stage->n_todo++] = f;
        stage->all[stage->n_all++] = f;
    }
    /* Wait until all ranks have searched the cache, since a rank that searches later would find
     * frames that other ranks have just added. */
    return spin_ranks_agree(SPIN_OK);
}

/* Waits until all ranks have refined their frames, adds the statistics of the other ranks to those
 * of this rank, and looks up the frames of the other ranks in the cache. */
static spin_status join_ranks(struct stage *stage)
{
    struct work {
        int64_t drawn, blind;
        double loss;
    } * all;
    spin_status status;

    if (spin_n_ranks() == 1)
        return SPIN_OK;
    SPIN_TRY(spin_alloc((size_t)spin_n_ranks(), sizeof *all, (void **)&all));
    all[spin_rank()] = (struct work){stage->drawn, stage->blind, stage->plan->report->loss_last};
    status = spin_ranks_gather(all, sizeof *all);
    for (int i = 0; i < spin_n_ranks(); i++) {
        stage->drawn += i == spin_rank() ? 0 : all[i].drawn;
        stage->blind += i == spin_rank() ? 0 : all[i].blind;
        stage->plan->report->loss_last += i == spin_rank() ? 0 : all[i].loss;
    }
    free(all);
    for (int i = 0; i < stage->n_all && status == SPIN_OK; i++) {
        bool found = true;

        if (i % spin_n_ranks() != spin_rank())
            status = find_cached(stage, stage->all[i], &found);
        if (!found)
            status = spin_not_found(
                "frame %d, refined by another process, is missing in '%s': processes on several "
                "machines need a shared folder",
                spin_plan_info(stage->plan, stage->all[i])->number, stage->plan->parts);
    }
    return spin_ranks_agree(status);
}

/* Opens the devices that refine frames at the same time: n devices, but at most one per thread, and
 * at most as many as fit into half of the memory; only one device on a GPU. */
static spin_status open_devices(struct stage *stage, int n, int n_threads)
{
    struct spin_plan *plan = stage->plan;

    n = n < n_threads ? n : n_threads;
    if (strcmp(stage->device->op->name, "cpu") != 0)
        n = 1;
    while (n > 1 && (size_t)n * spin_plan_refine_bytes(plan) > plan->report->bytes_available / 2)
        n--;
    SPIN_TRY(spin_alloc((size_t)n, sizeof *stage->hand, (void **)&stage->hand));
    for (int i = 0; i < n; i++) {
        SPIN_TRY(spin_device_open(plan->o->device, n_threads / n, &stage->hand[i]));
        stage->n_hands++;
    }
    return SPIN_OK;
}

static void close_devices(struct stage *stage)
{
    for (int i = 0; i < stage->n_hands; i++)
        spin_device_close(&stage->hand[i]);
    free(stage->hand);
    stage->hand = NULL;
    stage->n_hands = 0;
}

/* Refines the next n frames of stage->todo, several at a time. */
static spin_status run_tasks(struct stage *stage, int n, int n_threads)
{
    struct spin_pool *pool = NULL;
    spin_status status;

    SPIN_TRY_OUT(open_devices(stage, n, n_threads));
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
    close_devices(stage);
    return status;
}

/* Refines all frames of stage->todo. With T threads and n frames, the first n - n % T frames are
 * refined on one thread each, and the remaining n % T frames on several threads each. */
static spin_status refine_all(struct stage *stage)
{
    struct spin_pool *pool = NULL;
    int n_threads;

    SPIN_TRY(spin_pool_create(stage->plan->o->n_threads, &pool));
    n_threads = spin_pool_n_threads(pool);
    spin_pool_free(pool);
    while (stage->first < stage->n_todo) {
        int left = stage->n_todo - stage->first;

        SPIN_TRY(run_tasks(stage, left < n_threads ? left : left - left % n_threads, n_threads));
    }
    return SPIN_OK;
}

/* True if all refined frames have all attributes; refined frames of the input may lack some. */
static bool has_all_attributes(const struct stage *stage)
{
    bool input = !(whole & ~stage->plan->clip.bundle.refined.columns);

    for (int f = 0; f < stage->plan->clip.n_frames; f++)
        if (stage->refinement->frame[f].from_input && !input)
            return false;
    return true;
}

static spin_status read_whole(void *context, int frame, struct spin_splats *out)
{
    const struct stage *stage = context;

    SPIN_TRY(spin_refinement_read(stage->refinement, stage->plan, frame, whole, out));
    out->antialias = stage->plan->o->antialias;
    return SPIN_OK;
}

static spin_status open_shown(struct stage *stage, struct spin_player *shown)
{
    spin_player_open_reader(shown, stage->device, read_whole, stage);
    if (stage->plan->o->learn_exposure != SPIN_EXPOSURE_ON)
        return SPIN_OK;
    return spin_player_set_lenses(shown, &stage->plan->lenses);
}

/* Renders the refined frames in the test views, measures their quality, and writes previews. */
static spin_status measure_frames(struct stage *stage)
{
    struct spin_plan *plan = stage->plan;
    struct spin_quality *q = &plan->report->refined;
    struct spin_player shown;
    spin_status status;

    if (!has_all_attributes(stage))
        return SPIN_OK;
    SPIN_TRY(open_shown(stage, &shown));
    status = spin_test_views_measure(plan, stage->photos, &shown, plan->counts,
                                     "evaluating the refined frames", q);
    spin_player_close(&shown);
    SPIN_TRY(status);
    if (spin_rank() > 0)
        return SPIN_OK;
    if (q->valid)
        spin_log(0, "refined: %.0f splats per frame, test PSNR %.3f dB, SSIM %.4f",
                 plan->clip.n_mean, q->psnr, q->ssim);
    SPIN_TRY(open_shown(stage, &shown));
    status = spin_test_views_preview(plan, stage->photos, &shown, "refined");
    spin_player_close(&shown);
    return status;
}

/* Warns if any iteration had no visible splat, since it learned nothing. Fails if all iterations of
 * all frames had none. */
static spin_status check_visibility(const struct stage *stage)
{
    if (stage->blind == 0)
        return SPIN_OK;
    if (stage->blind == stage->drawn && stage->n_all == stage->plan->clip.n_frames)
        return spin_malformed(
            "no splat was visible in any view of any frame: check that the cameras belong to these "
            "points");
    spin_warn("no splat was visible in %lld of %lld iterations of the refinement: these iterations "
              "learned nothing",
              (long long)stage->blind, (long long)stage->drawn);
    return SPIN_OK;
}

/* Updates the numbers of splats and the estimated memory in the plan, and the budget of the image
 * cache. Cached images are kept. */
static spin_status recount(const struct stage *stage)
{
    struct spin_image_cache *cache = &stage->photos->cache;

    SPIN_TRY(spin_plan_recount(stage->plan, stage->refinement->counts, cache->held));
    cache->budget = stage->plan->pixels_budget;
    return SPIN_OK;
}

spin_status spin_refinement_run(struct spin_refinement *refinement, struct spin_plan *plan,
                                struct spin_photos *photos, struct spin_device *device,
                                struct spin_simd_paths *simd_paths, struct spin_step_log *step_log)
{
    struct stage stage = {.refinement = refinement,
                          .plan = plan,
                          .photos = photos,
                          .device = device,
                          .simd_paths = simd_paths,
                          .step_log = step_log,
                          .lock = PTHREAD_MUTEX_INITIALIZER,
                          .start_s = spin_now_s()};
    char count[48];
    spin_status status;

    if (!plan->o->resume && !plan->o->cache && spin_rank() == 0)
        spin_frame_cache_clear(plan->parts);
    SPIN_TRY(spin_ranks_agree(SPIN_OK));
    SPIN_TRY_OUT(list_todo(&stage));
    spin_log(0, "refining %d of %d frames, %s each", stage.n_all, plan->clip.n_frames,
             spin_text_count(plan->o->refine, "iteration", count));
    spin_progress_begin(&stage.progress, "refining", "it", 0,
                        (long long)stage.n_todo * plan->o->refine);
    status = refine_all(&stage);
    spin_progress_end(&stage.progress);
    if (status == SPIN_OK)
        status = join_ranks(&stage);
    if (status == SPIN_OK)
        status = check_visibility(&stage);
    plan->report->refine_seconds = spin_now_s() - stage.start_s;
    plan->report->seconds_per_iteration =
        plan->report->refine_seconds / stage.n_all / plan->o->refine;
    if (stage.n_all == 0) /* all frames were in the input or in the cache */
        plan->report->seconds_per_iteration = plan->report->loss_last = NAN;
    if (status == SPIN_OK)
        status = recount(&stage);
    if (status == SPIN_OK)
        status = measure_frames(&stage);
out:
    free(stage.todo);
    pthread_mutex_destroy(&stage.lock);
    return status;
}

spin_json *spin_refinement_to_json(const struct spin_refinement *refinement,
                                   const struct spin_plan *plan)
{
    spin_json *j = spin_json_object(), *frames = spin_json_array();

    for (int f = 0; f < plan->clip.n_frames; f++) {
        spin_json *frame = spin_json_object();

        spin_json_set_integer(frame, "n", (int64_t)refinement->counts[f]);
        spin_json_set_string(frame, "key", refinement->frame[f].key);
        spin_json_push(frames, frame);
    }
    spin_json_set(j, "columns", spin_column_names(spin_refinement_columns(plan)));
    spin_json_set_integer(j, "sh_degree", needs_whole(plan) ? spin_plan_frame_sh_degree(plan) : -1);
    if (plan->o->antialias)
        spin_json_set_bool(j, "antialias", true);
    spin_json_set(j, "options", spin_settings_refine(plan));
    spin_json_set(j, "frames", frames);
    return j;
}

/* ---- Cache of refined frames ----------------------------------------------------------------- */

static const unsigned held = SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES;

static spin_status path_of(const char *folder, int index, char **out)
{
    char name[32];

    snprintf(name, sizeof name, "%05d.spin", index);
    return spin_path_join(folder, name, out);
}

spin_status spin_frame_cache_put(const char *folder, int index, const char *key,
                                 const char *code_path, const struct spin_splats *splats)
{
    SPIN_LEAVES(spin_bundle_writer_abandon) struct spin_bundle_writer w = {0};
    SPIN_LEAVES(spin_bundle_meta_free) struct spin_bundle_meta meta = {0};
    spin_json *extra;
    SPIN_FREED char *path = NULL;

    SPIN_TRY(spin_folder_make(folder));
    SPIN_TRY(path_of(folder, index, &path));
    SPIN_TRY(spin_bundle_meta_reserve(&meta, 1));
    meta.frame[0].number = index;
    meta.frame[0].n = splats->n;
    meta.n_source_frames = 1;
    meta.columns = held;
    meta.sh_degree = splats->sh_degree;
    SPIN_TRY(spin_bundle_writer_open(path, true, true, &w));
    w.zip.n_threads = 1; /* since several threads write frames at the same time */
    SPIN_TRY(spin_bundle_write_frame(&w, 0, held, 0, splats));
    extra = spin_json_object();
    spin_json_set_string(extra, "key", key);
    spin_json_set_string(extra, "path", code_path);
    return spin_bundle_writer_finish(&w, &meta, extra);
}

/* Opens the bundle of a cached frame. SPIN_E_USAGE if the bundle has another key. */
static spin_status open_frame(const char *path, const char *key, struct spin_bundle *out)
{
    const char *text;

    SPIN_TRY(spin_bundle_open(path, out));
    text = spin_json_string(spin_json_get(out->json, "key"));
    if (text && strcmp(text, key) == 0 && out->meta.columns == held)
        return SPIN_OK;
    spin_bundle_close(out);
    return spin_misuse("the input, the options or the images differ from those of the refined "
                       "frame '%s'; give the same ones, or --force without --resume to start anew",
                       path);
}

spin_status spin_frame_cache_find(const char *folder, int index, const char *key, bool *found,
                                  struct spin_shelved *out)
{
    struct spin_bundle bundle;
    const char *text;
    SPIN_FREED char *path = NULL;

    *found = false;
    SPIN_TRY(path_of(folder, index, &path));
    if (!spin_path_exists(path))
        return SPIN_OK;
    SPIN_TRY(open_frame(path, key, &bundle));
    text = spin_json_string(spin_json_get(bundle.json, "path"));
    *found = true;
    out->n = bundle.meta.frame[0].n;
    snprintf(out->path, sizeof out->path, "%s", text ? text : "");
    spin_bundle_close(&bundle);
    return SPIN_OK;
}

spin_status spin_frame_cache_get(const char *folder, int index, const char *key, unsigned columns,
                                 struct spin_splats *out)
{
    SPIN_LEAVES(spin_bundle_close) struct spin_bundle bundle = {0};
    SPIN_FREED char *path = NULL;

    SPIN_TRY(path_of(folder, index, &path));
    SPIN_TRY(open_frame(path, key, &bundle));
    return spin_bundle_frame(&bundle, 0, columns, out);
}

/* True for names of cached frames, such as "00012.spin", and of temporary files that a killed run
 * left, such as "00012.spin.tmp.*". */
static bool is_ours(const char *name)
{
    size_t digits = 0;

    while (isdigit((unsigned char)name[digits]))
        digits++;
    return digits >= 5 && strncmp(name + digits, ".spin", 5) == 0;
}

void spin_frame_cache_clear(const char *folder)
{
    char **names = NULL;
    size_t n = 0;

    if (!spin_path_is_folder(folder) || spin_folder_list(folder, &names, &n) != SPIN_OK)
        return;
    for (size_t i = 0; i < n; i++) {
        char *path = NULL;

        if (is_ours(names[i]) && spin_path_join(folder, names[i], &path) == SPIN_OK)
            remove(path);
        free(path);
    }
    spin_folder_list_free(names);
    rmdir(folder);
}
