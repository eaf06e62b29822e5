/* spin_retrain(): retrains a bundle. The stages are, in this order: plan, refinement, frames, loop,
 * output.
 *
 * The result of an iteration depends only on the options, the seed and the state before it, which
 * the checkpoint stores. A resumed training therefore ends with the same bits as an uninterrupted
 * one, whatever the number of threads. */
#include "base/base.h"
#include "spin_run.h"
#include "io/output.h"
#include "io/json.h"
#include "io/ranks.h"
#include "render/draw_renders.h"
#include "run/run.h"
#include "run/watch_run.h"
#include "scene/clip.h"
#include "scene/columns.h"
#include "train/backdrop.h"
#include "train/loop.h"
#include "train/options.h"
#include "train/photometric_fit.h"
#include "train/trained_output.h"
#include "train/rows_4d.h"
#include "train/photos.h"

/* With --learn-exposure auto, exposures are learned if the colours of the cameras differ by more
 * than the fraction least_spread, or if the brightness at the corners of their images differs from
 * that at the centre by more than the fraction least_falloff. */
static const double least_spread = 0.05, least_falloff = 0.05;

/* Owns the objects of a training. Each stage receives the objects that it needs. */
struct run {
    struct spin_plan plan;
    struct spin_device device;
    struct spin_photos photos;
    struct spin_refinement refinement;
    struct spin_tracks tracks;
    struct spin_frame_size *sizes; /* [frames] NULL until the tracks are found */
    struct spin_rows_4d rows;      /* set with --method 4d only */
    struct spin_frames frames;
    struct spin_trainer trainer;
    char *fingerprint;
    struct spin_simd_paths simd_paths;
    struct spin_checkpoint checkpoint;
    struct spin_step_log step_log;
    struct spin_output_lock lock; /* prevents a second training of the same output */
    struct spin_watch watch;
    /* Differences in colour and brightness between the cameras; photometric.spread is NaN if they
     * were not measured. */
    struct spin_photometric_result photometric;
    bool resume; /* whether the training continues from a checkpoint */
};

static bool trains_4d(const struct run *r) { return r->plan.o->method == SPIN_METHOD_4D; }
static bool trains_clip(const struct run *r) { return r->plan.o->method != SPIN_METHOD_FRAMES; }

/* ---- Before the work ------------------------------------------------------------------------- */

/* Deletes the checkpoint and other intermediate files once the output is complete. */
static void delete_intermediate_files(const struct run *r)
{
    remove(r->plan.part);
    remove(r->plan.clip_of_state);
    if (!r->plan.o->cache)
        spin_frame_cache_clear(r->plan.parts);
    spin_out_sweep(r->plan.part);
    spin_out_sweep(r->plan.o->output);
}

static spin_status check_output(const struct run *r, bool *done)
{
    const struct spin_retrain_options *o = r->plan.o;
    bool part = spin_path_is_taken(r->plan.part),
         parts = !o->cache && spin_path_is_taken(r->plan.parts);

    *done = false;
    if (spin_path_is_taken(o->output) && !o->force) {
        *done = o->resume && spin_output_is_done(&r->plan, r->fingerprint);
        spin_inputs_own(o->output);
        if (*done) {
            delete_intermediate_files(r);
            return SPIN_OK;
        }
        return spin_output_check_file(o->output, false); /* fails since the file exists */
    }
    if ((part || parts) && !o->resume && !o->force)
        return spin_fail(SPIN_E_IO,
                         "an unfinished training is in '%s': use --resume to continue it, or "
                         "--force to start again",
                         part ? r->plan.part : r->plan.parts);
    if (o->resume && !part && !parts)
        spin_warn("nothing to resume: '%s' has no checkpoint, starting from the beginning",
                  o->output);
    return SPIN_OK;
}

/* Returns a lower bound, in bytes, of the total size of the checkpoint and the output of a training
 * of the clip. With tracks, the number of splats to store is not known yet, but it is at least that
 * of the largest frame. */
static uint64_t clip_bytes(const struct run *r)
{
    const struct spin_plan *p = &r->plan;
    size_t all = 0, most = 0, floats;

    if (!trains_clip(r))
        return 0;
    for (int f = 0; f < p->clip.n_frames; f++) {
        all += p->counts[f];
        most = p->counts[f] > most ? p->counts[f] : most;
    }
    floats = (trains_4d(r)   ? r->rows.n
              : p->o->tracks ? most
                             : all) *
             (spin_plan_has_residual(p) ? 3 + SPIN_RESIDUAL : 3);
    if (p->o->method == SPIN_METHOD_NETWORK)
        floats += p->field.n_table + p->field.n_heads;
    /* The checkpoint stores three floats for each parameter, its value and the two moments of Adam;
     * the output stores the value. */
    return 4 * (uint64_t)floats * sizeof(float);
}

/* Returns a lower bound, in bytes, of the total size of all refined frames. */
static uint64_t refined_bytes(const struct spin_plan *p)
{
    int degree = spin_plan_frame_sh_degree(p);
    uint64_t floats = 0, all = 0;

    for (unsigned column = 1; column < SPIN_COLUMNS_END; column <<= 1)
        if (column & (SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES))
            floats += spin_column_width(column, degree);
    for (int f = 0; f < p->clip.n_frames; f++)
        all += p->counts[f];
    return all * floats * sizeof(float);
}

/* Returns the share of the frames that are not in the cache yet. */
static double uncached_share(const struct spin_plan *p)
{
    double n = p->clip.n_frames;
    size_t n_cached = 0;
    char **names;

    if (spin_path_is_taken(p->parts) && spin_folder_list(p->parts, &names, &n_cached) == SPIN_OK)
        spin_folder_list_free(names);
    return n > (double)n_cached ? (n - (double)n_cached) / n : 0;
}

static spin_status check_space(const char *folder, const char *path, const char *files,
                               uint64_t bytes)
{
    uint64_t room = spin_path_free_bytes(folder);
    char need[32], left[32];

    if (room >= bytes)
        return SPIN_OK;
    return spin_fail(SPIN_E_IO, "cannot write '%s': %s need at least %s, but the disk has %s free",
                     path, files, spin_text_bytes(bytes, need), spin_text_bytes(room, left));
}

/* Checks that the temporary files of the frames fit on the disk, beside the other files of the run,
 * `others` bytes in `folder`, if these are on the same disk. */
static spin_status check_scratch_space(const struct spin_plan *p, const char *folder,
                                       uint64_t others)
{
    const struct spin_retrain_report *report = p->report;
    char need[32], left[32], output[32], beside[96] = "";

    if (!p->scratch)
        return SPIN_OK;
    others = spin_path_same_disk(p->scratch, folder) ? others : 0;
    if (report->bytes_disk >= report->bytes_scratch + others)
        return SPIN_OK;
    if (others > 0)
        snprintf(beside, sizeof beside, " beside at least %s for checkpoint and output",
                 spin_text_bytes(others, output));
    return spin_fail(SPIN_E_IO,
                     "the state of the training needs about %s in temporary files in '%s'%s, but "
                     "the disk has %s free: free some space, or give a folder on another disk with "
                     "--scratch",
                     spin_text_bytes(report->bytes_scratch, need), p->scratch, beside,
                     spin_text_bytes(report->bytes_disk, left));
}

/* Checks that the files that the run keeps until its end fit on the disk together. */
static spin_status check_disk(const struct run *r)
{
    const struct spin_plan *p = &r->plan;
    const struct spin_retrain_options *o = p->o;
    uint64_t refined = o->refine > 0 ? refined_bytes(p) : 0,
             cache = (uint64_t)((double)refined * uncached_share(p)),
             output = clip_bytes(r) + (o->method == SPIN_METHOD_FRAMES ? refined : 0);
    SPIN_FREED char *folder = NULL;

    SPIN_TRY(spin_path_folder(o->output, &folder));
    SPIN_TRY(check_scratch_space(p, folder, output + (o->cache ? 0 : cache)));
    if (o->cache)
        SPIN_TRY(check_space(p->parts, p->parts, "the refined frames", cache));
    else if (refined > 0)
        return check_space(folder, o->output, "refined frames, checkpoint and output",
                           cache + output);
    return check_space(folder, o->output, "checkpoint and output", output);
}

/* With --force, removes the previews of an earlier training. */
static void remove_former_previews(const struct run *r)
{
    const struct spin_retrain_options *o = r->plan.o;

    if (o->resume || !o->force)
        return;
    if (o->preview)
        spin_previews_remove(o->preview);
    if (o->watch && strcmp(o->preview, r->watch.pictures) != 0)
        spin_previews_remove(r->watch.pictures);
}

/* Checks before the first iteration that all outputs can be written. */
static spin_status check_outputs(struct run *r)
{
    const struct spin_retrain_options *o = r->plan.o;
    const struct spin_watch *w = &r->watch;
    const char *all[] = {o->output, r->plan.part, r->plan.clip_of_state, o->log, w->page, w->now,
                         w->state,  w->clip};

    SPIN_TRY(spin_output_check_distinct(all, sizeof all / sizeof *all));
    SPIN_TRY(spin_output_check_file(o->output, o->force));
    SPIN_TRY(spin_output_check_file(r->plan.part, true));
    SPIN_TRY(spin_out_check(r->plan.clip_of_state, true));
    if (o->refine > 0 && (o->cache || spin_path_is_taken(r->plan.parts)))
        SPIN_TRY(spin_output_check_folder(r->plan.parts));
    SPIN_TRY(check_disk(r));
    if (o->watch) {
        SPIN_TRY(spin_output_check_empty_folder(o->watch, o->force || o->resume));
        SPIN_TRY(spin_out_check(w->state, true)); /* state.spin must not be an input */
    }
    if (o->preview)
        SPIN_TRY(spin_output_check_empty_folder(o->preview, o->force || o->resume));
    SPIN_TRY(spin_step_log_open(&r->step_log, o->log, o->resume, o->force));
    remove_former_previews(r);
    return o->watch ? spin_watch_begin(&r->watch) : SPIN_OK;
}

/* Fails if ranks use different SIMD paths, since their results would differ in the last bits. */
static spin_status check_paths(const struct run *r)
{
    char(*path)[16];
    spin_status status;

    SPIN_TRY(spin_alloc((size_t)spin_n_ranks(), sizeof *path, (void **)&path));
    snprintf(path[spin_rank()], sizeof *path, "%s", r->device.path);
    status = spin_ranks_gather(path, sizeof *path);
    for (int i = 1; i < spin_n_ranks() && status == SPIN_OK; i++)
        if (strcmp(path[i], path[0]) != 0)
            status = spin_misuse("rank %d uses the SIMD path '%s' but rank 0 '%s': set the same "
                                 "one on all ranks with SPIN_CPU",
                                 i, path[i], path[0]);
    free(path);
    return spin_ranks_agree(status);
}

/* Logs the preset, the number of iterations and the estimated time. */
static void log_recipe(const struct spin_plan *p)
{
    const struct spin_retrain_options *o = p->o;
    char time[32], count[48], frames[48], about[64] = "", refining[96] = "";

    spin_text_count(p->clip.n_frames, "frame", frames);
    if (o->refine > 0)
        snprintf(refining, sizeof refining, "%s on each frame%s",
                 spin_text_count(o->refine, "iteration", count),
                 o->method == SPIN_METHOD_FRAMES ? "" : ", then ");
    if (isfinite(p->report->seconds_estimated))
        snprintf(about, sizeof about, "; about %s here",
                 spin_text_about(p->report->seconds_estimated, time));
    if (o->method == SPIN_METHOD_FRAMES)
        spin_log(0, "preset %s: %s, %s%s", o->preset, refining, frames, about);
    else
        spin_log(0, "preset %s: %s%s, %s%s", o->preset, refining,
                 spin_text_count(o->iterations, "iteration", count), frames, about);
}

static void log_scratch(const struct spin_plan *p)
{
    char state[32], left[32];

    if (p->scratch)
        spin_log(0,
                 "the state of the training, %s, does not fit into the %s of memory that are free: "
                 "it is kept in temporary files in '%s'",
                 spin_text_bytes(p->report->bytes_scratch, state),
                 spin_text_bytes(p->report->bytes_available, left), p->scratch);
}

/* For --watch, writes the log and the previews to the folder of the page, and evaluates twenty
 * times during the training. Options that the user has set are left unchanged. */
static spin_status prepare_watch(struct run *r)
{
    struct spin_retrain_options *o = &r->plan.report->options;

    if (!o->watch)
        return SPIN_OK;
    SPIN_TRY(spin_watch_open(&r->watch, o->watch));
    o->log = o->log ? o->log : r->watch.log;
    o->preview = o->preview ? o->preview : r->watch.pictures;
    if (o->eval_every == 0)
        o->eval_every = o->iterations > 20 ? o->iterations / 20 : 1;
    return SPIN_OK;
}

/* Estimates the memory again, now that it is known which splats share the values of a track. */
static spin_status estimate_again(struct run *r)
{
    struct spin_plan *p = &r->plan;

    SPIN_TRY(spin_alloc((size_t)p->clip.n_frames, sizeof *r->sizes, (void **)&r->sizes));
    for (int f = 0; f < p->clip.n_frames; f++)
        r->sizes[f] = spin_tracks_size(&r->tracks, f, p->counts[f]);
    spin_plan_set_sizes(p, r->sizes, r->tracks.n, r->photos.cache.held);
    return SPIN_OK;
}

/* Finds tracks with --tracks, if they were not found before. Refined frames have no tracks, since
 * they share no splats. */
static spin_status find_tracks(struct run *r)
{
    const struct spin_retrain_options *o = r->plan.o;

    if (!o->tracks || o->refine > 0 || r->tracks.of)
        return SPIN_OK;
    SPIN_TRY(spin_tracks_find(&r->tracks, &r->plan, o->dynamic_residual ? &r->photos : NULL));
    SPIN_TRY(spin_backdrop_add(&r->plan, &r->tracks));
    return estimate_again(r);
}

/* Largest number of pixels that a dry run decodes to find tracks, which takes about ten seconds.
 * With more pixels, it finds no tracks, and its estimate of the memory stays an upper bound. */
static const double most_pixels = 1e9;

static spin_status make_plan(struct run *r, const struct spin_retrain_options *o,
                             struct spin_retrain_report *report)
{
    SPIN_TRY(spin_plan_open(&r->plan, o, report));
    if (trains_4d(r)) {
        if (spin_rank() == 0)
            spin_training_warn_test_cameras(&r->plan.clip, o->n_test_cameras);
        SPIN_TRY(spin_rows_4d_cut(&r->rows, &r->plan));
    }
    if (o->refine > 0)
        SPIN_TRY(spin_refinement_open(&r->refinement, &r->plan));
    SPIN_TRY(spin_device_open(o->device, o->n_threads, &r->device));
    r->device.deterministic = o->deterministic;
    if (o->scratch && !r->device.is_host && spin_rank() == 0)
        spin_warn("--scratch has no effect on a GPU, which keeps the state of the training in its "
                  "own memory");
    spin_plan_set_device(&r->plan, &r->device);
    SPIN_TRY(check_paths(r));
    spin_simd_paths_begin(&r->simd_paths, r->device.path);
    SPIN_TRY(prepare_watch(r));
    /* In all other cases the means are checked later, when the frames are loaded. */
    if (!trains_4d(r) && (o->dry_run || o->refine > 0))
        SPIN_TRY(spin_frames_check_points(&r->plan));
    if (!o->dry_run || spin_tracks_pixels(&r->plan) > most_pixels)
        return SPIN_OK;
    SPIN_TRY(spin_photos_open(&r->photos, &r->plan));
    SPIN_TRY(spin_photos_measure_content(&r->photos, &r->plan));
    return find_tracks(r);
}

/* Returns the brightness at the corners of the images, relative to the centre. */
static double corner_brightness(const struct run *r) { return spin_lenses_corner(&r->plan.lenses); }

static bool has_falloff(const struct spin_lens *lens)
{
    static const float none[6];

    return memcmp(lens->falloff, none, sizeof none) != 0;
}

/* Resolves --learn-exposure auto to on or off. With auto, the falloff of the lenses is learned only
 * if one was measured for every lens, since the training would otherwise fit a falloff to anything
 * in the scene that resembles one. */
static spin_status choose_exposure(struct run *r)
{
    enum spin_exposure *choice = &r->plan.report->options.learn_exposure;
    const struct spin_lenses *lenses = &r->plan.lenses;

    r->photometric.spread = NAN;
    if (*choice == SPIN_EXPOSURE_OFF)
        return SPIN_OK;
    SPIN_TRY(spin_photometric_fit_cameras(&r->plan, &r->photos, &r->photometric));
    if (trains_4d(r))
        SPIN_TRY(spin_rows_4d_photometric(&r->plan));
    if (*choice == SPIN_EXPOSURE_ON)
        return SPIN_OK;
    *choice =
        (r->photometric.spread > least_spread && r->photometric.gains == SPIN_PHOTOMETRIC_SEEN) ||
                fabs(corner_brightness(r) - 1) > least_falloff
            ? SPIN_EXPOSURE_ON
            : SPIN_EXPOSURE_OFF;
    for (int i = 0; i < lenses->n; i++)
        r->plan.lenses_stay |= !has_falloff(&lenses->lens[i]);
    return SPIN_OK;
}

static const char *rejection_text(enum spin_photometric_why why)
{
    static const char *const text[] = {
        [SPIN_PHOTOMETRIC_SEEN] = "",
        [SPIN_PHOTOMETRIC_FEW] = "too few points are visible in three training cameras",
        [SPIN_PHOTOMETRIC_SAME_RADII] =
            "each point is about equally far from the centre in all images",
        [SPIN_PHOTOMETRIC_ODD] = "the measured falloff fits no lens",
        [SPIN_PHOTOMETRIC_NOT_HELD_OUT] = "held-out points do not confirm the measurement",
    };

    return text[why];
}

/* Describes the measured differences between cameras, and the reason if a measurement was rejected.
 */
static void describe_differences(const struct run *r, bool on, char text[400])
{
    const struct spin_photometric_result *photometric = &r->photometric;
    bool refused = !on && photometric->spread > least_spread;
    char falloff[160];

    if (corner_brightness(r) != 1)
        snprintf(falloff, sizeof falloff,
                 "their images keep %.1f %% of the brightness in the corners",
                 100 * corner_brightness(r));
    else
        snprintf(falloff, sizeof falloff, "no falloff is measured (%s)",
                 rejection_text(photometric->falloff));
    snprintf(text, 400, "cameras differ in colour by %.1f %%%s%s%s, %s", 100 * photometric->spread,
             refused ? " (" : "", refused ? rejection_text(photometric->gains) : "",
             refused ? ")" : "", falloff);
}

static void log_exposure(const struct run *r)
{
    bool on = r->plan.o->learn_exposure == SPIN_EXPOSURE_ON;
    char text[400];

    if (isnan(r->photometric.spread))
        return;
    if (on && spin_rank() == 0)
        spin_lenses_warn(&r->plan.lenses, &r->plan.clip.views, r->plan.test, r->plan.n_test);
    describe_differences(r, on, text);
    if (on && r->photometric.spread < 0)
        spin_log(0, "no point is visible in three training cameras to compare their colours: "
                    "the learned exposures and falloff start from neutral values");
    else if (on)
        spin_log(0, "%s: learning an exposure for each camera%s", text,
                 r->plan.lenses_stay ? "" : " and the falloff of the lenses");
    else if (r->photometric.spread < 0)
        spin_log(1, "no point is visible in three training cameras to compare their colours: no "
                    "exposure is learned");
    else
        spin_log(r->photometric.spread > least_spread ? 0 : 1, "%s: no exposure is learned", text);
}

/* Opens the images, and computes what the training derives from them: exposures, the backdrop, the
 * cache key of each frame to refine, and the fingerprint of all inputs. */
static spin_status open_inputs(struct run *r)
{
    SPIN_TRY(spin_photos_open(&r->photos, &r->plan));
    SPIN_TRY(spin_photos_check_images(&r->photos, &r->plan));
    SPIN_TRY(spin_photos_measure_content(&r->photos, &r->plan));
    SPIN_TRY(choose_exposure(r));
    SPIN_TRY(spin_backdrop_choose(&r->plan, &r->photos));
    SPIN_TRY(spin_photos_choose_alpha(&r->photos, &r->plan));
    if (r->plan.o->refine > 0)
        SPIN_TRY(spin_refinement_keys(&r->refinement, &r->plan, &r->photos));
    return spin_fingerprint(&r->plan, r->refinement.frame, &r->photos, &r->device, &r->fingerprint);
}

/* ---- The work -------------------------------------------------------------------------------- */

static void log_plan(const struct run *r)
{
    double outside = r->plan.report->outside_ball;
    char frames[48];

    spin_log(0, "%s, %.0f splats a frame, %zu training and %zu test views, %s",
             spin_text_count(r->plan.clip.n_frames, "frame", frames), r->plan.clip.n_mean,
             r->plan.n_train, r->plan.n_test, r->device.description);
    if (trains_4d(r))
        spin_log(0, "%zu 4D splats, of which %zu are the same in all frames", r->rows.n,
                 r->rows.n_whole);
    if (r->plan.o->method != SPIN_METHOD_NETWORK)
        return;
    spin_log(0,
             "the hash table has %.1f million parameters; %.1f %% of the points are outside the "
             "unit ball",
             (double)r->plan.field.n_table / 1e6, 100 * outside);
    if (outside > 0.9)
        spin_warn("nearly all points are outside the unit ball: consider --scene-normalise auto");
}

static spin_status measure_source(struct run *r)
{
    struct spin_quality *q = &r->plan.report->before;

    SPIN_TRY(spin_test_views_measure_input(&r->plan, &r->photos, &r->device, q));
    if (q->valid)
        spin_log(0, "before retraining: test PSNR %.3f dB, SSIM %.4f", q->psnr, q->ssim);
    return SPIN_OK;
}

static void log_tracks(const struct run *r)
{
    const struct spin_tracks *t = &r->tracks;

    if (!r->plan.o->tracks)
        return;
    if (r->refinement.frame) {
        spin_log(0, "no tracks: refined frames share no splats");
        return;
    }
    if (t->n_backdrop > 0)
        spin_log(0, "added a backdrop of %zu splats behind the surfaces of the scene",
                 t->n_backdrop);
    if (t->n == 0)
        spin_log(0, "no splat matches a splat of another frame: no tracks%s",
                 spin_plan_densifies(&r->plan) ? ", each frame is densified independently" : "");
    else
        spin_log(0, "%zu tracks, %zu dynamic%s, %zu with attributes per frame", t->n, t->n_moving,
                 t->identity ? "" : " (matched between neighbouring frames)", t->n_varying);
}

/* Allocates the trainer for frames, tracks and network. */
static spin_status open_trainer(struct run *r, bool resume)
{
    struct spin_plan *p = &r->plan;
    struct spin_trainer_size size = {.n_frames = p->clip.n_frames};
    SPIN_FREED void *block = NULL;
    struct spin_frame_size *frame;

    SPIN_TRY(spin_alloc((size_t)size.n_frames, sizeof *frame, &block));
    size.frame = frame = block;
    SPIN_TRY(find_tracks(r));
    log_tracks(r);
    size.tracked = r->tracks.n > 0 || trains_4d(r) || spin_plan_densifies(p);
    size.n_tracks = trains_4d(r) ? r->rows.n : r->tracks.n;
    size.n_moving = r->tracks.n_moving;
    size.n_varying = r->tracks.n_varying;
    size.n_backdrop = r->tracks.n_backdrop;
    for (int f = 0; f < size.n_frames; f++) {
        size_t n = p->counts[f];

        frame[f] = spin_plan_frame_size(p, n);
        if (size.tracked && !trains_4d(r))
            frame[f] = spin_tracks_size(&r->tracks, f, n);
    }
    if (resume && size.tracked) {
        SPIN_TRY(spin_checkpoint_sizes(&r->checkpoint, frame, &size));
        for (int f = 0; f < size.n_frames; f++)
            r->plan.counts[f] = frame[f].n;
    }
    return spin_plan_open_trainer(p, &r->device, &size, &r->trainer);
}

static const double table_range = 1e-4;     /* the hash table is initialised with -1e-4 to 1e-4 */
static const double initial_log_scale = -5; /* of the splats, for scenes in metres */

/* Initialises the hash table and the heads of the network. */
static spin_status init_network(struct run *r)
{
    const struct spin_retrain_options *o = r->plan.o;
    struct spin_trainer *t = &r->trainer;
    struct spin_device *d = &r->device;
    float *heads;
    SPIN_FREED float *table = NULL;

    if (!t->network)
        return SPIN_OK;
    SPIN_TRY(spin_alloc(t->field.n_table + t->heads.n, sizeof(float), (void **)&table));
    heads = table + t->field.n_table;
    spin_field_init(&t->field, o->seed, table_range, initial_log_scale, table, heads);
    if (o->sh_increase_every > 0)
        spin_field_clear_sh(&t->field, heads);
    if (spin_plan_has_residual(&r->plan))
        spin_field_clear_heads(&t->field, heads);
    d->op->upload(d, t->table.p, table, t->table.n * sizeof(float));
    d->op->upload(d, t->heads.p, heads, t->heads.n * sizeof(float));
    return SPIN_OK;
}

/* Updates the mean number of splats, which densification changes. */
static void count_splats(struct run *r)
{
    double *mean = &r->plan.report->splats_mean;

    *mean = 0;
    for (int f = 0; f < r->trainer.n_frames; f++)
        *mean += (double)r->trainer.frame[f].size.n;
    *mean /= r->trainer.n_frames;
}

static struct spin_output output_of(struct run *r)
{
    return (struct spin_output){.plan = &r->plan,
                                .refinement = &r->refinement,
                                .frames = &r->frames,
                                .trainer = &r->trainer,
                                .fingerprint = r->fingerprint,
                                .simd_paths = r->simd_paths.all};
}

/* Updates the page of --watch. A failure to write the page does not end the training. */
static spin_status update_watch(void *context)
{
    struct run *r = context;
    struct spin_output output = output_of(r);
    bool done = r->trainer.iteration == r->plan.o->iterations;

    if (spin_rank() > 0)
        return SPIN_OK;
    if (spin_step_log_begin(&r->step_log)) /* flush the log, which the page reads */
        spin_step_log_end(&r->step_log, true);
    (void)spin_plan_beside(&r->plan, spin_watch_update(&r->watch, &output, r->plan.o->log, done));
    return SPIN_OK; /* the loop handles interrupts and writes the checkpoint */
}

static spin_status train_network(struct run *r)
{
    bool resume = r->resume;
    struct spin_checkpoint *c = &r->checkpoint;
    struct spin_loop loop = spin_loop_of(&r->plan, &r->photos, &r->trainer, c, &r->step_log);

    loop.looked = r->plan.o->watch ? update_watch : NULL;
    loop.context = r;
    c->path = r->plan.part;
    c->fingerprint = r->fingerprint;
    c->restart = spin_options_restart(r->plan.o);
    c->simd_paths = &r->simd_paths;

    SPIN_TRY(open_trainer(r, resume));
    SPIN_TRY(trains_4d(r) ? spin_rows_4d_load(&r->rows, &r->plan, &r->trainer, &r->frames)
                          : spin_frames_load(&r->frames, &r->plan, &r->refinement, &r->tracks,
                                             &r->trainer, !resume));
    c->permutation = r->frames.permutation;
    SPIN_TRY(resume ? spin_checkpoint_load(c, &r->trainer) : init_network(r));
    c->sound = true;
    log_plan(r);
    SPIN_TRY(measure_source(r));
    if (spin_rank() == 0)
        remove(r->plan.clip_of_state); /* the partial clip that an earlier interrupt left */
    c->saved_s = spin_now_s();
    c->start_s = c->saved_s - r->plan.report->refine_seconds;
    c->refine_s += r->plan.report->refine_seconds;
    r->plan.report->refine_seconds = c->refine_s;
    SPIN_TRY(spin_loop_run(&loop));
    count_splats(r);
    return SPIN_OK;
}

/* With --method frames, uses the refined frames as the result of the training. */
static spin_status use_refined_frames(struct run *r)
{
    struct spin_retrain_report *report = r->plan.report;

    log_plan(r);
    SPIN_TRY(measure_source(r));
    report->test = report->refined;
    report->seconds = report->refine_seconds;
    return SPIN_OK;
}

/* Warns if the result is worse than the source, unless the images are renders of the source, from
 * which any result differs more than the source itself. */
static void warn_worse(const struct run *r)
{
    const struct spin_quality *before = &r->plan.report->before, *test = &r->plan.report->test;

    if (spin_clip_is_drawn(&r->plan.clip))
        return;
    if (before->valid && test->valid && test->psnr < before->psnr)
        spin_warn("the result is worse than the %s, test PSNR %.3f dB instead of %.3f dB: try %s",
                  trains_4d(r) ? "input clip" : "source", test->psnr, before->psnr,
                  trains_clip(r) && r->plan.o->method != SPIN_METHOD_NETWORK
                      ? "more --iterations, or --preset best"
                  : trains_clip(r) ? "more --iterations, --preset short, or --residual source"
                                   : "a larger --refine, or --refine-start source");
}

static spin_status run_stages(struct run *r)
{
    struct spin_plan *p = &r->plan;
    struct spin_output output = output_of(r);

    if (p->o->refine > 0) {
        SPIN_TRY(spin_refinement_run(&r->refinement, p, &r->photos, &r->device, &r->simd_paths,
                                     &r->step_log));
        if (trains_clip(r))
            SPIN_TRY(spin_plan_check_memory(p));
    }
    SPIN_TRY(trains_clip(r) ? train_network(r) : use_refined_frames(r));
    spin_reserve_set(&r->checkpoint.reserve, NULL, 0);
    SPIN_TRY(spin_output_write(&output));
    warn_worse(r);
    return SPIN_OK;
}

/* After an interrupt, writes the result so far as a bundle beside the checkpoint.
 * spin_bundle_open() finds this bundle there, so that users can view the result. */
static void write_partial_clip(struct run *r)
{
    struct spin_retrain_options o = *r->plan.o;
    struct spin_plan plan = r->plan;
    struct spin_output output = output_of(r);

    o.output = r->plan.clip_of_state;
    o.force = true;
    plan.o = &o;
    output.plan = &plan;
    if (spin_output_write(&output) != SPIN_OK && spin_rank() == 0)
        spin_warn("cannot write the splats trained so far as a clip for viewing: %s",
                  spin_last_error());
}

/* After a failure or an interrupt, saves the checkpoint for --resume and adds its path to the
 * error. */
static spin_status save_after_failure(struct run *r, spin_status failed)
{
    struct spin_checkpoint *c = &r->checkpoint;
    const char *go_on = spin_options_continue(r->plan.o);
    bool shared = r->plan.o->cache && !r->plan.o->resume;
    /* `said`: the error message already reports that the checkpoint could not be saved */
    bool lost = false, said = c->failed;
    char why[1024], kept[1024] = "";

    snprintf(why, sizeof why, "%s", spin_last_error());
    if (spin_ranks_agreed() && c->sound && r->trainer.iteration > 0 &&
        r->trainer.iteration != c->saved)
        lost = spin_checkpoint_save(c, &r->trainer) != SPIN_OK;
    if (lost && !said)
        snprintf(kept, sizeof kept, "; %s", spin_last_error());
    if (failed == SPIN_E_CANCELLED && spin_ranks_agreed() && c->sound &&
        c->saved == r->trainer.iteration)
        write_partial_clip(r);
    if (c->saved >= 0)
        return spin_fail(failed, "%s%s; the checkpoint of iteration %lld is kept in '%s'%s%s", why,
                         kept, (long long)c->saved, r->plan.part, c->sound ? ": " : "",
                         c->sound ? go_on : "");
    if (!lost && r->refinement.frame && spin_path_is_folder(r->plan.parts))
        return spin_fail(failed, "%s; the frames refined so far are kept in '%s'%s%s", why,
                         r->plan.parts, shared ? "" : ": ", shared ? "" : go_on);
    return spin_fail(failed, "%s%s", why, kept);
}

static spin_status prepare_outputs(struct run *r, bool *done)
{
    bool found[2] = {false, r->plan.o->resume && spin_path_exists(r->plan.part)};
    spin_status status = spin_rank() == 0 ? check_output(r, &found[0]) : SPIN_OK;

    if (status == SPIN_OK && !found[0] && (spin_plan_is_short(&r->plan) || r->plan.scratch))
        status = find_tracks(r); /* a clip with tracks may need less memory */
    if (status == SPIN_OK && !found[0])
        status = spin_plan_check_memory(&r->plan);
    if (status == SPIN_OK && !found[0] && spin_rank() == 0)
        status = check_outputs(r);
    SPIN_TRY(spin_ranks_agree(status));
    SPIN_TRY(spin_ranks_broadcast(found, sizeof found, 0));
    *done = found[0];
    r->resume = found[1];
    return SPIN_OK;
}

static spin_status run_training(struct run *r)
{
    struct spin_plan *p = &r->plan;
    bool done = false;
    spin_status status;

    /* Only rank 0 writes files: lock, log and checkpoint. */
    SPIN_TRY(spin_ranks_agree(spin_rank() == 0 ? spin_output_lock_take(p->o->output, &r->lock)
                                               : SPIN_OK));
    SPIN_TRY(open_inputs(r));
    SPIN_TRY(prepare_outputs(r, &done));
    if (done) {
        spin_log(0, "'%s' is already finished", p->o->output);
        return SPIN_OK;
    }
    log_recipe(p);
    log_scratch(p);
    log_exposure(r);
    status = run_stages(r);
    if (status != SPIN_OK)
        return save_after_failure(r, status);
    p->report->bytes_peak = spin_memory_peak();
    if (spin_rank() == 0)
        delete_intermediate_files(r);
    return SPIN_OK;
}

/* Closes the log. An incomplete log or preview is an error even though the training is complete. */
static spin_status close_log(struct run *r)
{
    const char *output = r->plan.o->output, *incomplete = r->plan.report->incomplete;

    spin_step_log_close(&r->step_log);
    if (*r->step_log.error)
        return spin_fail(SPIN_E_IO, "'%s' is complete, but the log '%s' is not: %s", output,
                         r->step_log.path, r->step_log.error);
    return *incomplete
               ? spin_fail(SPIN_E_IO, "'%s' is complete, but an additional output is not: %s",
                           output, incomplete)
               : SPIN_OK;
}

static void close_all(struct run *r)
{
    spin_output_lock_drop(&r->lock);
    spin_reserve_set(&r->checkpoint.reserve, NULL, 0);
    spin_trainer_close(&r->trainer);
    spin_frames_close(&r->frames);
    spin_tracks_close(&r->tracks);
    free(r->sizes);
    spin_rows_4d_close(&r->rows);
    spin_refinement_close(&r->refinement);
    spin_photos_close(&r->photos);
    spin_device_close(&r->device);
    spin_plan_close(&r->plan);
    spin_watch_close(&r->watch);
    free(r->fingerprint);
}

spin_status spin_train(const struct spin_retrain_options *o, struct spin_retrain_report *report)
{
    SPIN_LEAVES(spin_inputs_end) int inputs = spin_inputs_begin();
    SPIN_LEAVES(spin_renders_end) int renders = spin_renders_begin(o->n_threads);
    struct run r;
    spin_status status;

    (void)inputs;
    (void)renders;
    memset(&r, 0, sizeof r);
    memset(report, 0, sizeof *report);
    r.checkpoint.saved = -1;
    status = o->output ? spin_bundle_check_name(o->output) : SPIN_OK;
    if (status == SPIN_OK)
        status = make_plan(&r, o, report);
    if (status == SPIN_OK && !o->dry_run)
        status = run_training(&r);
    if (status == SPIN_OK) {
        status = close_log(&r);
    } else {
        spin_step_log_close(&r.step_log);
        if (status != SPIN_E_CANCELLED && o->input)
            status = spin_fail_context(status, "cannot retrain '%s'", o->input);
    }
    close_all(&r);
    return status;
}

/* ---- The report ------------------------------------------------------------------------------ */

static spin_json *quality_json(const struct spin_quality *q)
{
    return !q->valid ? json_null()
                     : json_pack("{s:o, s:o, s:o, s:o}", "psnr", spin_json_number_value(q->psnr),
                                 "ssim", spin_json_number_value(q->ssim), "psnr_channel_mean",
                                 spin_json_number_value(q->psnr_channel_mean), "psnr_colour_fitted",
                                 spin_json_number_value(q->psnr_colour_fitted));
}

spin_status spin_retrain(const struct spin_retrain_options *o, char **report)
{
    static const char *const method[] = {"network", "frames", "tracks", "4d"};
    struct spin_retrain_report r;
    spin_json *j;

    *report = NULL;
    SPIN_TRY(spin_train(o, &r));
    j = spin_json_object();
    spin_json_set_string(j, "method", method[o->method]);
    spin_json_set_string(j, "preset", o->preset);
    spin_json_set_integer(j, "iterations", r.iterations);
    spin_json_set_integer(j, "densify_every", r.densify_every);
    spin_json_set_integer(j, "refine", o->refine);
    spin_json_set_integer(j, "frames", r.frames);
    spin_json_set_number(j, "splats_mean", r.splats_mean);
    spin_json_set_string(j, "device", r.device);
    spin_json_set_number(j, "outside_ball", r.outside_ball);
    spin_json_set_integer(j, "bytes_needed", (int64_t)r.bytes_needed);
    spin_json_set_integer(j, "bytes_available", (int64_t)r.bytes_available);
    spin_json_set_integer(j, "bytes_scratch", (int64_t)r.bytes_scratch);
    if (o->dry_run) {
        spin_json_set_bool(j, "dry_run", true);
        spin_json_set_bool(j, "fits_disk", r.bytes_disk >= r.bytes_scratch);
        spin_json_set_bool(j, "full", o->max_points > 0 && r.splats_mean >= o->max_points);
        spin_json_set_bool(j, "fits", !r.bytes_available || r.bytes_needed <= r.bytes_available);
        spin_json_set_string(j, "fitting", r.fitting);
        spin_json_set_number(j, "seconds_estimated", r.seconds_estimated);
        spin_json_set_integer(j, "ranks", r.ranks);
        spin_json_set_number(j, "bytes_sent", r.bytes_sent);
    } else {
        spin_json_set_number(j, "seconds", r.seconds);
        spin_json_set_number(j, "seconds_per_iteration", r.seconds_per_iteration);
        spin_json_set_number(j, "loss", r.loss_last);
        spin_json_set_integer(j, "bytes_peak", (int64_t)r.bytes_peak);
        if (o->refine > 0) {
            spin_json_set_number(j, "refine_seconds", r.refine_seconds);
            spin_json_set(j, "refined", quality_json(&r.refined));
        }
        spin_json_set(j, "test", quality_json(&r.test));
        spin_json_set(j, "before", quality_json(&r.before));
        spin_json_set_string(j, "output", o->output);
    }
    return spin_json_finish(j, report);
}
