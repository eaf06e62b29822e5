/* The calls of spin.h that combine the modules: opening a clip, reading, exporting, rendering. */
#include "base/base.h"
#include "spin_run.h"
#include "run/decimate.h"
#include "run/run.h"
#include "run/scene_edit.h"
#include "io/file.h"
#include "io/output.h"
#include "io/ranks.h"
#include "render/player.h"
#include "run/share_splats.h"
#include "run/training.h"
#include "scene/data_path.h"
#include "scene/lens.h"
#include "scene/probe.h"

void spin_set_verbosity(int level) { spin_log_set_level(level); }

/* ---- A clip, open for reading ---------------------------------------------------------------- */

struct spin_scene {
    struct spin_bundle bundle;
    struct spin_device device;
    struct spin_player player; /* of the trained splats; opened when first needed */
    bool is_trained, device_open, player_open;
};

spin_status spin_scene_open(const char *path, struct spin_scene **out)
{
    struct spin_scene *scene;
    spin_status status;

    SPIN_TRY(spin_alloc(1, sizeof *scene, (void **)&scene));
    status = spin_bundle_open(path, &scene->bundle);
    if (status != SPIN_OK) {
        free(scene);
        return status;
    }
    scene->is_trained = spin_bundle_is_trained(&scene->bundle);
    *out = scene;
    return SPIN_OK;
}

void spin_scene_close(struct spin_scene *scene)
{
    if (!scene)
        return;
    if (scene->player_open)
        spin_player_close(&scene->player);
    if (scene->device_open)
        spin_device_close(&scene->device);
    spin_bundle_close(&scene->bundle);
    free(scene);
}

int spin_scene_n_frames(const struct spin_scene *scene) { return scene->bundle.meta.n_frames; }

const struct spin_frame_info *spin_scene_frame(const struct spin_scene *scene, int frame)
{
    return &scene->bundle.meta.frame[frame];
}

bool spin_scene_is_trained(const struct spin_scene *scene) { return scene->is_trained; }

unsigned spin_scene_columns(const struct spin_scene *scene) { return scene->bundle.meta.columns; }

spin_status spin_scene_read(struct spin_scene *scene, int frame, enum spin_splat_source from,
                            unsigned columns, struct spin_splats *out)
{
    const struct spin_bundle *bundle = &scene->bundle;

    if (from == SPIN_FROM_BEST)
        from = scene->is_trained                                ? SPIN_FROM_TRAINED
               : SPIN_COL_ATTRIBUTES & ~bundle->refined.columns ? SPIN_FROM_SOURCE
                                                                : SPIN_FROM_REFINED;
    if (from == SPIN_FROM_SOURCE)
        return spin_bundle_frame(&scene->bundle, frame, columns, out);
    if (from == SPIN_FROM_REFINED)
        return spin_bundle_refined_frame(&scene->bundle, frame, columns, out);
    if (!scene->is_trained)
        return spin_not_found("'%s' was not trained: run spin-retrain", scene->bundle.path);
    if (!scene->device_open) {
        SPIN_TRY(spin_device_open("auto", 0, &scene->device));
        scene->device_open = true;
    }
    if (!scene->player_open) {
        SPIN_TRY(
            spin_player_open(&scene->player, &scene->device, &scene->bundle, SPIN_FROM_TRAINED));
        scene->player_open = true;
    }
    return spin_player_splats(&scene->player, frame, columns, out);
}

/* ---- Drawing --------------------------------------------------------------------------------- */

struct spin_renderer {
    struct spin_player player;
};

spin_status spin_render(struct spin_renderer *r, const struct spin_splats *splats,
                        const struct spin_camera *camera, const float background[3], float *image)
{
    SPIN_TRY(spin_player_show_splats(&r->player, splats));
    return spin_player_draw(&r->player, camera, background, image);
}

spin_status spin_render_layers(struct spin_renderer *r, float *alpha, float *depth)
{
    return spin_player_layers(&r->player, alpha, depth);
}

/* ---- Export ---------------------------------------------------------------------------------- */

struct export
{
    const struct spin_export_options *o;
    struct spin_export_report *report;
    const struct spin_exporter *exporter;
    struct spin_clip clip;
    struct spin_device device;
    struct spin_player player;
    struct spin_renderer *renderer;
    struct spin_splats splats, received; /* of this rank; received from another */
    struct spin_decimation decimation;   /* used with --decimate */
    struct spin_splats thinned;          /* current frame after decimation */
    bool decimates;
    const char *output; /* current output: the final path, or a temporary one of --decimate */
    bool checks;        /* whether the current output is read back */
    const char **pairs; /* options of the exporter with --decimate, else NULL */
    enum spin_splat_source from;
    size_t *counts; /* [n_frames] */
    int *source_index, *numbers;
    char *data;                             /* path of the data set recorded in the bundle */
    double *times;                          /* [n_frames] */
    const struct spin_splats_4d *splats_4d; /* 4D splats to write instead of frames, or NULL */
    struct spin_scene_edit edit;
    struct spin_splats edited; /* current frame after filters and transforms */
    double n_written;          /* splats written so far, in all frames */
    void *self;
};

static spin_status find_exporter(const char *name, const struct spin_exporter **out)
{
    char known[256] = "";

    *out = spin_exporter_named(name);
    if (*out)
        return SPIN_OK;
    for (const struct spin_exporter *const *i = spin_exporter_list(); *i; i++) {
        size_t used = strlen(known);

        snprintf(known + used, sizeof known - used, "%s%s", used ? ", " : "", (*i)->name);
    }
    if (spin_plugin_fault(name))
        return spin_unsupported("%s", spin_plugin_fault(name));
    return spin_misuse("unknown exporter '%s'; available: %s", name, known);
}

static double clip_stride(const struct spin_clip *clip)
{
    const struct spin_frame_info *info = clip->bundle.meta.frame;
    int n = clip->n_frames;

    return n < 2
               ? 1
               : (double)(info[clip->frame[n - 1]].number - info[clip->frame[0]].number) / (n - 1);
}

/* Frame rate of the exported frames: --range with a step lowers it. */
static double clip_fps(const struct spin_clip *clip)
{
    const struct spin_frame_info *first = &clip->bundle.meta.frame[clip->frame[0]];
    const struct spin_frame_info *last = &clip->bundle.meta.frame[clip->frame[clip->n_frames - 1]];
    double span = last->time - first->time, fps = clip->bundle.meta.fps / clip_stride(clip);

    /* Times that advance by one per frame, also where --range skips frames, are frame numbers and
     * not seconds. */
    if (clip->n_frames < 2 || span <= 0 || span == clip->n_frames - 1 ||
        span == last->number - first->number)
        return fps;
    return fps > 0 ? fps : (clip->n_frames - 1) / span;
}

/* Replaces *splats, frame f, by the splats that --decimate keeps. */
static spin_status thin(struct export *x, int f, bool counts, struct spin_splats **splats)
{
    if (!x->decimates)
        return SPIN_OK;
    SPIN_TRY(spin_decimation_frame(&x->decimation, f, *splats, counts, &x->thinned));
    *splats = &x->thinned;
    return SPIN_OK;
}

/* Replaces *splats, frame f, by the filtered and transformed splats. */
static spin_status edit(struct export *x, int f, bool counts, struct spin_splats **splats)
{
    if (spin_scene_edit_is_none(&x->edit))
        return SPIN_OK;
    SPIN_TRY(spin_scene_edit_frame(&x->edit, f, *splats, counts, &x->edited));
    *splats = &x->edited;
    return SPIN_OK;
}

/* Each rank computes one frame of the round, and rank 0 writes them in order. */
static spin_status write_round(struct export *x, int first, int n)
{
    unsigned columns = SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES;
    int own = spin_rank();

    if (spin_cancelled())
        return spin_fail_cancelled();
    if (own < n)
        SPIN_TRY(spin_player_splats(&x->player, x->clip.frame[first + own], columns, &x->splats));
    for (int r = 0; r < n; r++) {
        struct spin_splats *splats = r == own ? &x->splats : &x->received;
        struct spin_frame_info info = x->clip.bundle.meta.frame[x->clip.frame[first + r]];

        SPIN_TRY(spin_share_splats(splats, columns, r));
        SPIN_TRY(thin(x, first + r, true, &splats));
        if (own == 0)
            SPIN_TRY(edit(x, first + r, true, &splats));
        x->n_written += (double)splats->n;
        x->report->splats_mean =
            x->n_written /
            (first + r + 1); /* a preliminary mean, which the exporter may overwrite */
        info.n = splats->n;
        if (own == 0)
            SPIN_TRY(x->exporter->frame(x->self, first + r, &info, splats));
    }
    spin_bundle_rest(&x->splats);
    return SPIN_OK;
}

static spin_status write_frames(struct export *x)
{
    struct spin_progress progress;
    spin_status status = SPIN_OK;

    x->n_written = 0;
    spin_scene_edit_again(&x->edit);
    spin_progress_begin(&progress, "exporting", "frames", 0, x->clip.n_frames);
    for (int f = 0; f < x->clip.n_frames && status == SPIN_OK; f += spin_n_ranks()) {
        int left = x->clip.n_frames - f, n = left < spin_n_ranks() ? left : spin_n_ranks();

        status = write_round(x, f, n);
        spin_progress_set(&progress, f + n, "%zu splats", x->splats.n);
    }
    spin_progress_end(&progress);
    if (status == SPIN_OK)
        spin_scene_edit_say(&x->edit);
    return status;
}

static spin_status source_frame(void *source_of, int frame, struct spin_splats *out)
{
    struct export *x = source_of;
    const unsigned columns = SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES;
    struct spin_splats *splats = &x->received, *thinned = &x->thinned;
    bool edits = !spin_scene_edit_is_none(&x->edit), plain = !x->decimates && !edits;

    SPIN_TRY(
        spin_bundle_frame(&x->clip.bundle, x->clip.frame[frame], columns, plain ? out : splats));
    if (x->decimates)
        SPIN_TRY(spin_decimation_source(&x->decimation, frame, splats, edits ? thinned : out));
    return edits
               ? spin_scene_edit_frame(&x->edit, frame, x->decimates ? thinned : splats, false, out)
               : SPIN_OK;
}

static spin_status read_again(void *context, int frame, const struct spin_splats **out)
{
    struct export *x = context;
    struct spin_splats *splats = &x->splats;

    if (spin_cancelled())
        return spin_fail_cancelled();
    SPIN_TRY(spin_player_splats(&x->player, x->clip.frame[frame],
                                SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES, splats));
    SPIN_TRY(thin(x, frame, false, &splats));
    SPIN_TRY(edit(x, frame, false, &splats));
    *out = splats;
    return SPIN_OK;
}

/* Finds the 4D splats of the clip for exporters that accept them. */
static spin_status find_4d(struct export *x)
{
    struct spin_bundle *bundle = &x->clip.bundle;

    if (!x->exporter->splats_4d)
        return SPIN_OK;
    if (x->from == SPIN_FROM_SOURCE)
        SPIN_TRY(spin_bundle_splats_4d(bundle, &x->splats_4d));
    if (x->splats_4d || x->exporter->frame)
        return SPIN_OK;
    if (bundle->meta.four_d.n > 0)
        return spin_unsupported(
            "'%s' stores 4D splats, but the training produced frames: convert them with "
            "'spin-retrain --method 4d', or export the imported 4D splats with --source",
            x->o->to);
    return spin_unsupported(
        "'%s' stores 4D splats, but this clip has frames: convert them with 'spin-retrain --method "
        "4d', import a source of 4D splats without --frames, or choose another format",
        x->o->to);
}

/* Decimates, filters and transforms the 4D splats, and counts how many each frame shows. */
static spin_status change_4d(struct export *x, const struct spin_splats_4d **splats_4d)
{
    *splats_4d = x->splats_4d;
    if (!x->splats_4d || (!x->decimates && spin_scene_edit_is_none(&x->edit)))
        return SPIN_OK;
    if (x->decimates)
        SPIN_TRY(spin_decimation_4d(&x->decimation, splats_4d));
    if (!spin_scene_edit_is_none(&x->edit))
        SPIN_TRY(spin_scene_edit_4d(&x->edit, *splats_4d, splats_4d));
    spin_scene_edit_say(&x->edit);
    return spin_splats_4d_counts(*splats_4d, x->times, (size_t)x->clip.n_frames, x->counts);
}

static spin_status begin_export(struct export *x)
{
    static const float black[3] = {0};
    const struct spin_export_options *o = x->o;
    struct spin_plugin_values values = {.pairs = x->pairs ? x->pairs : o->plugin_pairs};
    struct spin_export_job job = {
        .output = x->output,
        .force = o->force,
        .sync = o->sync,
        .n_frames = x->clip.n_frames,
        .fps = clip_fps(&x->clip),
        .stride = clip_stride(&x->clip),
        .n_source_frames = x->clip.bundle.meta.n_source_frames,
        .numbered = x->clip.bundle.meta.numbered,
        .pair = x->o->pair ? x->o->pair : x->clip.bundle.meta.pair,
        .data_from = x->clip.bundle.meta.data_from,
        .identity = x->from == SPIN_FROM_SOURCE && x->clip.bundle.meta.identity &&
                    !x->edit.filters && !(x->decimates && x->decimation.n_sets > 1),
        .source = x->clip.bundle.meta.from,
        .sh_degree = x->clip.bundle.meta.sh_degree,
        .antialias = x->clip.bundle.meta.antialias,
        .values = &values,
        .dataset_frame_of = x->clip.dataset_frame,
        .renderer = x->renderer,
        .background = o->transparent ? black : o->background,
        .transparent = o->transparent,
        .n_threads = o->n_threads,
        .source_of = x,
        .source_sh_degree = x->clip.bundle.meta.sh_degree,
        .source_antialias = x->clip.bundle.meta.antialias,
        .retrained = x->from == SPIN_FROM_TRAINED,
        .report = x->report,
        .check = x->checks,
        .again = read_again,
        .context = x,
    };
    const struct spin_splats_4d *splats_4d = x->splats_4d;
    double sum = 0;
    spin_status status;

    if (x->from == SPIN_FROM_TRAINED) {
        job.sh_degree = x->player.field.sh_degree;
        job.antialias = x->player.field.antialias;
    } else if (x->from == SPIN_FROM_REFINED) {
        job.sh_degree = x->clip.bundle.refined.sh_degree;
        job.antialias = x->clip.bundle.refined.antialias;
    }
    if (x->from != SPIN_FROM_SOURCE && !(SPIN_COL_ATTRIBUTES & ~x->clip.bundle.meta.columns))
        job.source_frame = source_frame;
    for (int f = 0; f < x->clip.n_frames; f++) {
        x->counts[f] = x->decimates ? spin_decimation_count(&x->decimation, f)
                                    : spin_bundle_count(&x->clip.bundle, x->clip.frame[f], x->from);
        x->source_index[f] = x->clip.bundle.meta.source_index[x->clip.frame[f]];
        x->numbers[f] = x->clip.bundle.meta.frame[x->clip.frame[f]].number;
        x->times[f] = x->clip.bundle.meta.frame[x->clip.frame[f]].time;
    }
    SPIN_TRY(change_4d(x, &splats_4d));
    for (int f = 0; f < x->clip.n_frames; f++)
        sum += (double)x->counts[f];
    job.data = x->data && spin_path_exists(x->data) && !x->edit.moves ? x->data : NULL;
    job.source_index = x->source_index;
    job.numbers = x->numbers;
    job.times = x->times;
    job.splats_4d = splats_4d;
    x->report->frames = x->clip.n_frames;
    x->report->splats_mean = sum / x->clip.n_frames;
    SPIN_TRY(spin_scene_edit_views(&x->edit, &job.views));
    job.counts = x->edit.filters && !x->splats_4d ? NULL : x->counts;
    if (job.antialias && !x->exporter->antialias)
        spin_warn("these splats were trained with antialiasing, which '%s' files cannot record: "
                  "enable it in the viewer",
                  o->to);
    if (spin_rank() > 0)
        return x->splats_4d ? SPIN_OK : write_frames(x);
    spin_out_sweep(x->output);
    SPIN_TRY(x->exporter->begin(&job, &x->self));
    status = x->splats_4d ? SPIN_OK : write_frames(x);
    if (status != SPIN_OK) {
        x->exporter->abort(x->self);
        return status;
    }
    return x->exporter->end(x->self);
}

/* ---- Decimation ------------------------------------------------------------------------------ */

/* The exporter's options with --max-scale 0: rows that are too large are already marked, and the
 * exporter would compare with the bounding box of the kept splats. */
static spin_status make_pairs(struct export *x)
{
    const char *const *pairs = x->o->plugin_pairs;
    size_t n = 0;

    while (pairs && pairs[n])
        n++;
    SPIN_TRY(spin_alloc(n + 3, sizeof *x->pairs, (void **)&x->pairs));
    for (size_t i = 0; i < n; i++)
        x->pairs[i] = pairs[i];
    x->pairs[n] = "max-scale"; /* later values override earlier ones */
    x->pairs[n + 1] = "0";
    return SPIN_OK;
}

/* Whether an exporter drops undrawable splats: those with --min-opacity do. */
static bool filters(const struct spin_exporter *exporter)
{
    for (const struct spin_plugin_option *o = exporter->options; o && o->key; o++)
        if (strcmp(o->key, "min-opacity") == 0)
            return true;
    return false;
}

/* Reports existing output before the work. */
static spin_status check_output(const struct spin_export_options *o)
{
    if (spin_path_is_folder(o->output))
        return spin_output_check_empty_folder(o->output, o->force);
    return spin_out_check(o->output, o->force);
}

static spin_status write_try(void *context, const char *output)
{
    struct export *x = context;
    struct spin_export_report before = *x->report;
    spin_status status;

    x->output = output;
    x->checks = false;
    status = begin_export(x);
    x->output = x->o->output;
    x->checks = x->o->check;
    *x->report = before;
    return status;
}

static spin_status decimate(struct export *x, const struct spin_decimate_goal *goal)
{
    struct spin_decimation *d = &x->decimation;
    int n_tries = 0;
    uint64_t reached = 0;

    SPIN_TRY(check_output(x->o));
    if (spin_n_ranks() > 1)
        return spin_unsupported("--decimate runs in a single process only, not under mpirun");
    d->clip = &x->clip;
    d->frames = &x->player;
    d->splats_4d = x->splats_4d;
    d->background = x->o->background;
    d->filters = filters(x->exporter);
    d->edit = &x->edit;
    d->values = &(struct spin_plugin_values){.pairs = x->o->plugin_pairs};
    SPIN_TRY(spin_decimation_open(d));
    SPIN_TRY(make_pairs(x));
    x->decimates = x->edit.chosen = true;
    if (goal->unit == SPIN_DECIMATE_BYTES)
        SPIN_TRY(spin_decimation_choose_bytes(d, goal->amount, x->o->output, write_try, x, &n_tries,
                                              &reached));
    else if (goal->unit == SPIN_DECIMATE_DB)
        SPIN_TRY(spin_decimation_choose_loss(d, goal->amount));
    else
        SPIN_TRY(spin_decimation_choose(d, goal->unit, goal->amount));
    SPIN_TRY(spin_decimation_measure(d, &x->report->decimated));
    x->report->decimated.n_tries = n_tries;
    x->report->decimated.reached = reached;
    return SPIN_OK;
}

/* Exports have no lens falloff and the colours of the mean camera, since both are properties of the
 * cameras and not of the scene. */
static spin_status say_lens(const struct export *x)
{
    size_t n_cameras =
        spin_json_length(spin_json_get(spin_training_of(&x->clip.bundle, x->from), "cameras"));
    struct spin_lenses lenses;
    double corner;

    if (n_cameras > 0)
        spin_log(0,
                 "exporting the colours of the mean camera: the training learned an exposure for "
                 "each of its %zu cameras",
                 n_cameras);
    if (!spin_bundle_has_lenses(&x->clip.bundle, x->from))
        return SPIN_OK;
    SPIN_TRY(spin_lenses_from_json(spin_json_get(x->clip.bundle.json, "lenses"), 1, &lenses));
    corner = spin_lenses_corner(&lenses);
    if (lenses.n > 0)
        spin_log(0,
                 "exporting without the lens falloff, which leaves %.0f %% of the brightness in "
                 "the corners of the images",
                 100 * corner);
    spin_lenses_free(&lenses);
    return SPIN_OK;
}

static void warn_of_background(const struct export *x)
{
    const struct spin_export_options *o = x->o;
    const float *rgb = o->background;
    bool draws = x->exporter->needs_renderer || strcmp(x->exporter->name, "html") == 0;

    if (draws && !o->transparent)
        spin_training_warn_background(&x->clip.bundle, x->from, rgb, "draws");
    else if (!o->transparent && !o->check && !o->decimate &&
             (rgb[0] != 0 || rgb[1] != 0 || rgb[2] != 0))
        spin_warn("no effect without rendered images: --background");
}

static spin_status run_export(struct export *x)
{
    const struct spin_export_options *o = x->o;
    struct spin_clip_options c = {.input = o->input,
                                  .data = o->data,
                                  .data_from = o->data_from,
                                  .pair = o->pair,
                                  .range = o->range,
                                  .as_trained = true};
    struct spin_decimate_goal goal;

    if (o->decimate)
        SPIN_TRY(spin_decimate_parse(o->decimate, &goal));
    SPIN_TRY(find_exporter(o->to, &x->exporter));
    SPIN_TRY(spin_exporter_check_name(x->exporter, o->output));
    SPIN_TRY(spin_plugin_check(o->to, x->exporter->options, o->plugin_pairs));
    if (o->check && !x->exporter->checks)
        return spin_misuse("--check: the output of '%s' cannot be read back", o->to);
    if (o->transparent && !x->exporter->alpha)
        return spin_misuse(
            "--background none: the output of '%s' has no alpha channel; use --to images", o->to);
    c.wants_views = x->exporter->looks_at_views || o->check || o->decimate || o->min_views > 0;
    SPIN_TRY(spin_clip_open(&c, &x->clip));
    SPIN_TRY(spin_scene_edit_begin(&x->edit, o, &x->clip));
    x->clip.bundle.told_not_finite = true; /* exporters report non-finite rows themselves */
    SPIN_TRY(spin_player_choose(&x->clip.bundle, o->source, &x->from));
    SPIN_TRY(spin_device_open(o->device, o->n_threads, &x->device));
    SPIN_TRY(spin_player_open(&x->player, &x->device, &x->clip.bundle, x->from));
    if (x->exporter->needs_renderer || o->check) {
        SPIN_TRY(spin_alloc(1, sizeof *x->renderer, (void **)&x->renderer));
        SPIN_TRY(spin_player_open(&x->renderer->player, &x->device, NULL, SPIN_FROM_SOURCE));
    }
    if (spin_rank() == 0)
        warn_of_background(x);
    SPIN_TRY(say_lens(x));
    SPIN_TRY(find_4d(x));
    SPIN_TRY(spin_bundle_data_path(&x->clip.bundle, &x->data));
    SPIN_TRY(spin_alloc((size_t)x->clip.n_frames, sizeof *x->counts, (void **)&x->counts));
    SPIN_TRY(spin_alloc((size_t)x->clip.n_frames, sizeof(int), (void **)&x->source_index));
    SPIN_TRY(spin_alloc((size_t)x->clip.n_frames, sizeof(int), (void **)&x->numbers));
    SPIN_TRY(spin_alloc((size_t)x->clip.n_frames, sizeof *x->times, (void **)&x->times));
    if (o->decimate)
        SPIN_TRY(decimate(x, &goal));
    SPIN_TRY(begin_export(x));
    if (x->report->decimated.n_tries > 0 &&
        x->report->bytes > 0) /* of the final output, whose size may depend on its path */
        x->report->decimated.reached = x->report->bytes;
    return SPIN_OK;
}

spin_status spin_export_clip(const struct spin_export_options *o, struct spin_export_report *report)
{
    SPIN_LEAVES(spin_inputs_end) int inputs = spin_inputs_begin();
    struct export x = {.o = o, .report = report, .output = o->output, .checks = o->check};
    spin_status status;

    (void)inputs;
    memset(report, 0, sizeof *report);
    status = run_export(&x);
    if (x.renderer)
        spin_player_close(&x.renderer->player);
    free(x.renderer);
    spin_decimation_close(&x.decimation);
    spin_player_close(&x.player);
    spin_device_close(&x.device);
    spin_splats_free(&x.splats);
    spin_splats_free(&x.thinned);
    free(x.pairs);
    spin_splats_free(&x.received);
    spin_splats_free(&x.edited);
    report->filtered = x.edit.n_seen - x.edit.n_kept;
    spin_scene_edit_end(&x.edit);
    spin_clip_close(&x.clip);
    free(x.counts);
    free(x.data);
    free(x.source_index);
    free(x.numbers);
    free(x.times);
    return spin_fail_context(status, "cannot export '%s'", o->input);
}

static spin_json *check_json(const struct spin_export_check *c)
{
    static const char *const keys[] = {"place",   "log_scale", "rotation_deg",
                                       "opacity", "colour",    "sh"};
    spin_json *j;

    if (c->frames == 0)
        return json_null();
    j = json_pack("{s:i, s:I, s:o}", "frames", c->frames, "splats", (json_int_t)c->splats, "bounds",
                  spin_json_number_value(c->bounds));
    for (int p = 0; p < 6; p++)
        spin_json_set(j, keys[p],
                      json_pack("{s:o, s:o}", "rms", spin_json_number_value(c->rms[p]), "largest",
                                spin_json_number_value(c->largest[p])));
    spin_json_set_number(j, "place_sizes", c->place_sizes);
    spin_json_set_number(j, "place_pixels", c->place_pixels);
    spin_json_set(j, "sh_lost", json_integer((json_int_t)c->sh_lost));
    spin_json_set(j, "rendered", c->rendered < 0 ? json_null() : json_integer(c->rendered));
    spin_json_set_number(j, "psnr", c->psnr); /* null: infinite or not measured */
    return j;
}

static spin_json *decimated_json(const struct spin_decimated *d)
{
    spin_json *j;

    if (d->before == 0)
        return json_null();
    j = json_pack("{s:f, s:f, s:s, s:s, s:s, s:i}", "before", d->before, "after", d->after, "unit",
                  d->in_all ? "in all" : "a frame", "by",
                  d->by_views ? "their contribution to the images" : "opacity and size", "cameras",
                  d->by_views ? "training cameras" : "all around", "pictures", d->n_pictures);
    spin_json_set_number(j, "psnr", d->n_pictures > 0 ? d->psnr : (double)NAN);
    spin_json_set(j, "tries", json_integer(d->n_tries));
    spin_json_set(j, "reached",
                  d->n_tries > 0 ? json_integer((json_int_t)d->reached) : json_null());
    return j;
}

spin_status spin_export(const struct spin_export_options *o, char **report)
{
    const struct spin_exporter *exporter = spin_exporter_named(o->to);
    struct spin_export_options as_spelled = *o;
    struct spin_export_report r;

    *report = NULL;
    as_spelled.to = exporter ? exporter->name : o->to;
    o = &as_spelled;
    SPIN_TRY(spin_export_clip(o, &r));
    return spin_json_finish(
        json_pack("{s:o, s:o, s:i, s:o, s:f, s:o, s:I, s:I, s:o, s:o}", "to",
                  spin_json_text_value(o->to), "output", spin_json_text_value(o->output), "frames",
                  r.frames, "images", r.images ? json_integer((json_int_t)r.images) : json_null(),
                  "splats_mean", r.splats_mean, "bytes",
                  r.bytes ? json_integer((json_int_t)r.bytes) : json_null(), "left_out",
                  (json_int_t)r.left_out, "filtered", (json_int_t)r.filtered, "check",
                  check_json(&r.check), "decimated", decimated_json(&r.decimated)),
        report);
}
