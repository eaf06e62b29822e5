/* spin_export(): gets each frame from the player, applies the row filter and passes the frame to
 * the exporter. */
#include "base/base.h"
#include "spin_run.h"
#include "run/antialias_bake.h"
#include "run/decimate.h"
#include "run/export_sound.h"
#include "run/run.h"
#include "run/row_filter.h"
#include "run/scene_move.h"
#include "io/file.h"
#include "io/output.h"
#include "io/ranks.h"
#include "render/draw_renders.h"
#include "render/player.h"
#include "run/targets.h"
#include "scene/clip.h"
#include "scene/columns.h"
#include "scene/dataset.h"
#include "scene/lens.h"
#include "scene/probe.h"

struct export
{
    const struct spin_export_options *o;
    struct spin_export_report *report;
    const struct spin_exporter *exporter;
    struct spin_clip_options opened; /* the options that `clip` was opened with */
    struct spin_clip clip;
    struct spin_device device;
    struct spin_player player;
    struct spin_renderer *renderer;
    /* the frame of this rank; a frame received from another rank */
    struct spin_splats splats, received;
    struct spin_row_filter filter;
    struct spin_scene_move move;
    struct spin_export_sound sound;
    struct spin_antialias_bake bake;
    struct spin_export_options moved;  /* the options, with --crop in coordinates of the bundle */
    struct spin_decimation decimation; /* set if --decimate is given */
    /* path of the current output: the final path, or a temporary one of --decimate */
    const char *output;
    bool checks; /* true: the current output is read back and compared with the exported splats */
    enum spin_splat_source from;
    size_t *counts; /* [n_frames] */
    int *source_index, *numbers;
    char *data;                             /* path of the data set recorded in the bundle */
    double *times;                          /* [n_frames] */
    const struct spin_splats_4d *splats_4d; /* 4D splats to write instead of frames, or NULL */
    /* the 4D splats that remain of splats_4d after the row filter, scaled and translated */
    const struct spin_splats_4d *final_4d;
    bool identity;    /* row i is the same splat in all frames, unless the row filter drops rows */
    double n_written; /* splats written so far, in all frames */
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

/* Returns the frame rate of the exported frames, which is lower than that of the clip if --range
 * has a step. */
static double clip_fps(const struct spin_clip *clip)
{
    const struct spin_frame_info *first = &clip->bundle.meta.frame[clip->frame[0]];
    const struct spin_frame_info *last = &clip->bundle.meta.frame[clip->frame[clip->n_frames - 1]];
    double span = last->time - first->time, fps = clip->bundle.meta.fps / clip_stride(clip);

    /* If the times advance by 1 from each frame of the clip, or from each exported frame, to the
     * next, they are frame numbers and not seconds. */
    if (clip->n_frames < 2 || span <= 0 || span == clip->n_frames - 1 ||
        span == last->number - first->number)
        return fps;
    return fps > 0 ? fps : (clip->n_frames - 1) / span;
}

/* Returns whether the splats to export must be drawn with antialiasing. */
static bool is_antialiased(const struct export *x)
{
    return x->from == SPIN_FROM_TRAINED   ? x->player.field.antialias
           : x->from == SPIN_FROM_REFINED ? x->clip.bundle.refined.antialias
                                          : x->clip.bundle.meta.antialias;
}

/* Finds out whether row i is the same splat in all frames. Retrained frames meet this condition if
 * each row has the same track in all frames. */
static spin_status find_identity(struct export *x)
{
    struct spin_bundle_tracks *tracks = &x->player.tracks;
    SPIN_FREED uint32_t *track = NULL;
    size_t n = spin_bundle_count(&x->clip.bundle, x->clip.frame[0], x->from), i = 0;

    x->identity = x->from == SPIN_FROM_SOURCE && x->clip.bundle.meta.identity;
    if (x->from != SPIN_FROM_TRAINED || !tracks->values || !tracks->same_rows)
        return SPIN_OK;
    SPIN_TRY(spin_alloc(n + 1, sizeof *track, (void **)&track));
    SPIN_TRY(spin_bundle_tracks_numbers(tracks, x->clip.frame[0], n, track));
    while (i < n && track[i] != SPIN_NOT_TRACKED)
        i++;
    x->identity = i == n;
    return SPIN_OK;
}

static void report_rows(struct export *x)
{
    memcpy(x->report->dropped, x->filter.n_by, sizeof x->report->dropped);
    x->report->rows_differ = !x->filter.same_rows;
    x->report->left_out = spin_row_filter_n_undrawable(&x->filter);
    x->report->filtered = spin_row_filter_n_filtered(&x->filter);
}

/* Exports up to one frame per rank, from frame `first` on: each rank computes one of these frames,
 * and rank 0 writes them in order. */
static spin_status write_round(struct export *x, int first, int n)
{
    unsigned columns = SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES;
    int own = spin_rank();

    if (spin_cancelled())
        return spin_fail_cancelled();
    if (own < n)
        SPIN_TRY(spin_player_splats(&x->player, x->clip.frame[first + own], columns, &x->splats));
    for (int r = 0; r < n; r++) {
        struct spin_splats *shared = r == own ? &x->splats : &x->received;
        const struct spin_splats *splats = shared;
        struct spin_frame_info info = x->clip.bundle.meta.frame[x->clip.frame[first + r]];

        SPIN_TRY(spin_share_splats(shared, columns, r));
        if (own != 0)
            continue;
        SPIN_TRY(spin_row_filter_frame(&x->filter, first + r, &splats));
        report_rows(x);
        x->bake.measures = x->output == x->o->output;
        SPIN_TRY(spin_antialias_bake_frame(&x->bake, first + r, &splats));
        SPIN_TRY(spin_scene_move_frame(&x->move, &splats));
        x->n_written += (double)splats->n;
        /* the mean over the frames so far; an exporter that drops more splats replaces it */
        x->report->splats_mean = x->n_written / (first + r + 1);
        info.n = splats->n;
        SPIN_TRY(x->exporter->frame(x->self, first + r, &info, splats));
    }
    spin_bundle_release(&x->splats);
    return SPIN_OK;
}

static spin_status write_frames(struct export *x)
{
    struct spin_progress progress;
    spin_status status = SPIN_OK;

    x->n_written = 0;
    spin_progress_begin(&progress, "exporting", "frames", 0, x->clip.n_frames);
    for (int f = 0; f < x->clip.n_frames && status == SPIN_OK; f += spin_n_ranks()) {
        int left = x->clip.n_frames - f, n = left < spin_n_ranks() ? left : spin_n_ranks();

        status = write_round(x, f, n);
        spin_progress_set(&progress, f + n, "%zu splats", x->splats.n);
    }
    spin_progress_end(&progress);
    if (status == SPIN_OK) {
        spin_row_filter_log(&x->filter);
        spin_antialias_bake_log(&x->bake);
    }
    return status;
}

static spin_status source_frame(void *source_of, int frame, struct spin_splats *out)
{
    struct export *x = source_of;

    SPIN_TRY(spin_bundle_frame(&x->clip.bundle, x->clip.frame[frame],
                               SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES, &x->received));
    SPIN_TRY(spin_row_filter_source(&x->filter, frame, &x->received, out));
    spin_scene_move_rows(&x->move, out);
    return SPIN_OK;
}

static spin_status read_again(void *context, int frame, const struct spin_splats **out)
{
    const unsigned columns = SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES;
    struct export *x = context;

    if (spin_cancelled())
        return spin_fail_cancelled();
    *out = &x->splats;
    if (x->final_4d)
        return spin_splats_4d_slice(x->final_4d, x->times[frame], columns, &x->splats);
    SPIN_TRY(spin_player_splats(&x->player, x->clip.frame[frame], columns, &x->splats));
    SPIN_TRY(spin_row_filter_reread(&x->filter, frame, out));
    x->bake.measures = false;
    SPIN_TRY(spin_antialias_bake_frame(&x->bake, frame, out));
    return spin_scene_move_frame(&x->move, out);
}

/* Chooses frames instead of 4D splats if a .4dgs file cannot store the windows of the 4D splats.
 * The format stores 4D splats with Gaussian windows only, but it can also store frames. */
static void write_as_frames(struct export *x)
{
    const struct spin_splats_4d *s = x->splats_4d;

    if (!s || !(s->plateaus || s->gates) || strcmp(x->exporter->name, "4dgs") != 0)
        return;
    spin_log(0,
             "writing %d frames as keyframes and deltas: a .4dgs stores Gaussian windows in time, "
             "which cannot represent splats that %s",
             x->clip.n_frames,
             s->plateaus ? "keep their full opacity for some time" : "do not fade to 0");
    x->splats_4d = NULL;
}

/* Sets x->splats_4d to the 4D splats of the clip if it has any and the exporter accepts them. */
static spin_status find_4d(struct export *x)
{
    struct spin_bundle *bundle = &x->clip.bundle;

    if (!x->exporter->splats_4d)
        return SPIN_OK;
    if (x->from == SPIN_FROM_SOURCE)
        SPIN_TRY(spin_bundle_splats_4d(bundle, &x->splats_4d));
    write_as_frames(x);
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

/* Applies the row filter to the 4D splats, scales and translates the 4D splats that remain, and
 * counts how many of them each frame shows. */
static spin_status make_final_4d(struct export *x)
{
    x->final_4d = x->splats_4d;
    if (!x->splats_4d)
        return SPIN_OK;
    SPIN_TRY(spin_row_filter_4d(&x->filter, &x->final_4d));
    SPIN_TRY(spin_scene_move_4d(&x->move, &x->final_4d));
    report_rows(x);
    spin_row_filter_log(&x->filter);
    if (x->final_4d == x->splats_4d)
        return SPIN_OK;
    return spin_splats_4d_counts(x->final_4d, x->times, (size_t)x->clip.n_frames, x->counts);
}

/* Sets *psnr to the PSNR of the middle frame in programs that draw it without antialiasing
 * (spin_antialias_cost()), or to 0 if the cameras of the data set are not known. */
static spin_status find_antialias_cost(struct export *x, double *psnr)
{
    SPIN_LEAVES(spin_clip_close) struct spin_clip clip = {0};
    struct spin_clip_options options = x->opened;
    const unsigned columns = SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES;
    int f = x->clip.n_frames / 2;

    *psnr = 0;
    options.wants_views = options.quiet = true;
    SPIN_TRY(spin_clip_open(&options, &clip));
    if (!clip.has_views && !clip.has_kept)
        return SPIN_OK;
    if (x->splats_4d)
        SPIN_TRY(spin_splats_4d_slice(x->splats_4d, x->times[f], columns, &x->splats));
    else
        SPIN_TRY(spin_player_splats(&x->player, x->clip.frame[f], columns, &x->splats));
    return spin_antialias_cost(x->o, &clip, x->from, &x->device, f, &x->splats, psnr);
}

/* Warns that viewers will draw splats without antialiasing, and how much that changes the image. */
static spin_status warn_of_antialias(struct export *x)
{
    char cost[120] = "";
    double psnr;

    SPIN_TRY(find_antialias_cost(x, &psnr));
    if (psnr > 0 && isfinite(psnr))
        snprintf(cost, sizeof cost,
                 "; without antialiasing, images of the training's size have a PSNR of %.2f dB "
                 "against antialiased ones",
                 psnr);
    spin_warn(
        "these splats were trained with antialiasing, but '%s' files do not tell viewers to use "
        "it%s: enable it in the viewer, or %s --bake-antialias",
        x->o->to, cost,
        x->splats_4d ? "write frames (--to ply, for example) with" : "bake it with");
    return SPIN_OK;
}

static spin_status begin_export(struct export *x)
{
    static const float black[3] = {0};
    const struct spin_export_options *o = x->o;
    bool decimates = x->filter.drop != NULL;
    struct spin_plugin_values values = {.pairs = o->plugin_pairs};
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
        .identity = x->identity,
        .source = x->clip.bundle.meta.from,
        .sh_degree = x->clip.bundle.meta.sh_degree,
        .antialias = is_antialiased(x) && !x->bake.bakes,
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
    double sum = 0;
    spin_status status;

    if (x->clip.bundle.meta.up[0] != 0 || x->clip.bundle.meta.up[1] != 0 ||
        x->clip.bundle.meta.up[2] != 0)
        job.up = x->clip.bundle.meta.up;
    if (x->sound.sound.data) {
        job.sound = &x->sound.sound;
        job.fps = x->sound.fps;
    }
    if (x->from == SPIN_FROM_TRAINED)
        job.sh_degree = x->player.field.sh_degree;
    else if (x->from == SPIN_FROM_REFINED)
        job.sh_degree = x->clip.bundle.refined.sh_degree;
    if (x->from != SPIN_FROM_SOURCE && !(SPIN_COL_ATTRIBUTES & ~x->clip.bundle.meta.columns))
        job.source_frame = source_frame;
    for (int f = 0; f < x->clip.n_frames; f++) {
        x->counts[f] = decimates ? spin_decimation_count(&x->decimation, f)
                                 : spin_bundle_count(&x->clip.bundle, x->clip.frame[f], x->from);
        x->source_index[f] = x->clip.bundle.meta.source_index[x->clip.frame[f]];
        x->numbers[f] = x->clip.bundle.meta.frame[x->clip.frame[f]].number;
        x->times[f] = x->clip.bundle.meta.frame[x->clip.frame[f]].time;
    }
    spin_row_filter_restart(&x->filter);
    SPIN_TRY(make_final_4d(x));
    for (int f = 0; f < x->clip.n_frames; f++)
        sum += (double)x->counts[f];
    job.data = x->data && spin_path_exists(x->data) && !x->move.moves ? x->data : NULL;
    job.source_index = x->source_index;
    job.numbers = x->numbers;
    job.times = x->times;
    job.splats_4d = x->final_4d;
    x->report->frames = x->clip.n_frames;
    x->report->splats_mean = sum / x->clip.n_frames;
    SPIN_TRY(spin_scene_move_views(&x->move, &x->clip, &job.views));
    job.counts = x->counts;
    job.counts_are_bounds = x->filter.varies && !x->splats_4d;
    if (job.antialias && !x->exporter->antialias && spin_rank() == 0 && x->output == o->output)
        SPIN_TRY(warn_of_antialias(x));
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

/* Fails before any frame is read if the output exists and may not be overwritten. */
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
    d->filter = &x->filter;
    SPIN_TRY(spin_decimation_open(d));
    spin_decimation_attach(d);
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

/* Logs that the export omits the learned exposures and the lens falloff: colours are those of the
 * mean camera, without falloff. Exposure and falloff belong to the cameras and not to the scene. */
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

/* Returns whether the output shows the splats: as images, or in the player of a web page. */
static bool draws(const struct export *x)
{
    return x->exporter->needs_renderer || strcmp(x->exporter->name, "html") == 0;
}

static void warn_of_background(const struct export *x)
{
    const struct spin_export_options *o = x->o;
    const float *rgb = o->background;

    if (draws(x) && !o->transparent)
        spin_training_warn_background(&x->clip.bundle, x->from, rgb, "draws");
    else if (!o->transparent && !o->check && !o->decimate &&
             (rgb[0] != 0 || rgb[1] != 0 || rgb[2] != 0))
        spin_warn("--background has no effect: this export renders no images");
}

/* Returns whether the output has the coordinates of the bundle, not those of the run. */
static bool is_relative(const struct export *x) { return x->o->relative || draws(x); }

/* Converts --crop from the coordinates of the run to those of the bundle. */
static void shift_crop(struct export *x)
{
    const double *shift = x->clip.bundle.meta.shift;

    if (x->o->relative || x->o->n_crop == 0)
        return;
    x->moved = *x->o;
    for (int c = 0; c < 3; c++) {
        x->moved.crop[c] -= shift[c];
        if (x->o->n_crop == 6)
            x->moved.crop[3 + c] -= shift[c];
    }
    x->o = &x->moved;
}

/* Warns if the program of --for requires the same splats in the same order in all frames, but the
 * frames differ. */
static void warn_of_rows(const struct export *x)
{
    bool equal = !x->report->rows_differ;

    for (int f = 1; f < x->clip.n_frames; f++)
        equal = equal && x->counts[f] == x->counts[0];
    if (x->o->equal_rows && !x->splats_4d &&
        (!equal || (!x->identity && !x->clip.bundle.meta.identity)))
        spin_warn(
            "row i is not the same splat in all frames, but this program needs that for "
            "motion between frames: retrain with --method tracks, or write 4D splats as .stg.ply");
}

static spin_status open_bake(struct export *x)
{
    if (x->o->bake_antialias && draws(x))
        return spin_misuse("--bake-antialias: '%s' draws with antialiasing: omit the option",
                           x->o->to);
    if (x->o->bake_antialias && x->splats_4d)
        return spin_unsupported(
            "--bake-antialias applies to frames, but '%s' stores 4D splats, "
            "whose opacities do not depend on the camera: choose a format that stores frames",
            x->o->to);
    return spin_antialias_bake_open(&x->bake, x->o, &x->clip, x->from, is_antialiased(x),
                                    &x->device);
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
    static const double none[3] = {0};

    if (o->decimate)
        SPIN_TRY(spin_decimate_parse(o->decimate, &goal));
    SPIN_TRY(find_exporter(o->to, &x->exporter));
    SPIN_TRY(spin_exporter_check_name(x->exporter, o->output));
    SPIN_TRY(spin_plugin_check(o->to, x->exporter->options, o->plugin_pairs));
    if (o->check && !x->exporter->checks)
        return spin_misuse(
            "--check: exporter '%s' does not support reading its output back: omit the option",
            o->to);
    if (o->transparent && !x->exporter->alpha)
        return spin_misuse(
            "--background none: the output of '%s' has no alpha channel; use --to images", o->to);
    c.wants_views = x->exporter->looks_at_views || o->check || o->decimate || o->min_views > 0 ||
                    o->bake_antialias;
    x->opened = c;
    SPIN_TRY(spin_clip_open(&c, &x->clip));
    shift_crop(x);
    SPIN_TRY(spin_row_filter_open(&x->filter, x->o, &x->clip, x->exporter->needs_renderer));
    spin_scene_move_open(&x->move, o, is_relative(x) ? none : x->clip.bundle.meta.shift);
    x->clip.bundle.nonfinite_reported = true; /* the row filter reports non-finite rows */
    SPIN_TRY(spin_player_choose(&x->clip.bundle, o->source, &x->from));
    SPIN_TRY(spin_device_open(o->device, o->n_threads, &x->device));
    SPIN_TRY(spin_player_open(&x->player, &x->device, &x->clip.bundle, x->from));
    if (draws(x) || o->check) {
        SPIN_TRY(spin_alloc(1, sizeof *x->renderer, (void **)&x->renderer));
        SPIN_TRY(spin_player_open(&x->renderer->player, &x->device, NULL, SPIN_FROM_SOURCE));
    }
    if (spin_rank() == 0)
        warn_of_background(x);
    SPIN_TRY(say_lens(x));
    SPIN_TRY(find_4d(x));
    SPIN_TRY(find_identity(x));
    SPIN_TRY(spin_export_sound_open(o, x->exporter, &x->clip, clip_fps(&x->clip),
                                    clip_stride(&x->clip), &x->sound));
    SPIN_TRY(open_bake(x));
    SPIN_TRY(spin_bundle_data_path(&x->clip.bundle, &x->data));
    SPIN_TRY(spin_alloc((size_t)x->clip.n_frames, sizeof *x->counts, (void **)&x->counts));
    SPIN_TRY(spin_alloc((size_t)x->clip.n_frames, sizeof(int), (void **)&x->source_index));
    SPIN_TRY(spin_alloc((size_t)x->clip.n_frames, sizeof(int), (void **)&x->numbers));
    SPIN_TRY(spin_alloc((size_t)x->clip.n_frames, sizeof *x->times, (void **)&x->times));
    if (o->decimate)
        SPIN_TRY(decimate(x, &goal));
    SPIN_TRY(begin_export(x));
    warn_of_rows(x);
    /* The final output may differ in size from the trial outputs if a file contains its own path.
     */
    if (x->report->decimated.n_tries > 0 && x->report->bytes > 0)
        x->report->decimated.reached = x->report->bytes;
    return SPIN_OK;
}

spin_status spin_export_clip(const struct spin_export_options *o, struct spin_export_report *report)
{
    SPIN_LEAVES(spin_inputs_end) int inputs = spin_inputs_begin();
    SPIN_LEAVES(spin_renders_end) int renders = spin_renders_begin(o->n_threads);
    struct export x = {.o = o, .report = report, .output = o->output, .checks = o->check};
    spin_status status;

    (void)inputs;
    (void)renders;
    memset(report, 0, sizeof *report);
    status = run_export(&x);
    if (x.renderer)
        spin_player_close(&x.renderer->player);
    free(x.renderer);
    spin_decimation_close(&x.decimation);
    spin_antialias_bake_close(&x.bake);
    spin_player_close(&x.player);
    spin_device_close(&x.device);
    spin_splats_free(&x.splats);
    spin_splats_free(&x.received);
    spin_row_filter_close(&x.filter);
    spin_scene_move_close(&x.move);
    spin_export_sound_close(&x.sound);
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
    spin_json_set_number(j, "psnr", c->psnr); /* null if the PSNR is infinite or was not measured */
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
    spin_json_set(j, "merged", json_integer((json_int_t)d->merged));
    spin_json_set_number(j, "psnr", d->n_pictures > 0 ? d->psnr : (double)NAN);
    spin_json_set(j, "tries", json_integer(d->n_tries));
    spin_json_set(j, "reached",
                  d->n_tries > 0 ? json_integer((json_int_t)d->reached) : json_null());
    return j;
}

/* Returns an object with the number of dropped splats for each reason, without reasons that dropped
 * none. */
static spin_json *dropped_json(const struct spin_export_report *r)
{
    static const char *const keys[SPIN_ROW_REASONS] = {
        [SPIN_ROW_CROP] = "crop",
        [SPIN_ROW_MIN_VIEWS] = "min_views",
        [SPIN_ROW_FLOATERS] = "floaters",
        [SPIN_ROW_BACKDROP] = "backdrop",
        [SPIN_ROW_NOT_FINITE] = "not_finite",
        [SPIN_ROW_NO_ROTATION] = "no_rotation",
        [SPIN_ROW_TOO_LARGE] = "too_large",
        [SPIN_ROW_MIN_OPACITY] = "min_opacity",
        [SPIN_ROW_DECIMATE] = "decimate",
    };
    spin_json *j = spin_json_object();

    for (int k = SPIN_ROW_KEPT + 1; k < SPIN_ROW_REASONS; k++)
        if (r->dropped[k] > 0)
            spin_json_set_integer(j, keys[k], (int64_t)r->dropped[k]);
    return j;
}

spin_status spin_export(const struct spin_export_options *o, char **report)
{
    SPIN_LEAVES(spin_target_free) struct spin_targeted targeted = {.output = NULL};
    const struct spin_exporter *exporter;
    struct spin_export_options as_spelled = *o;
    struct spin_export_report r;

    *report = NULL;
    if (o->target)
        SPIN_TRY(spin_target_apply(o->target, &as_spelled, &targeted));
    exporter = spin_exporter_named(as_spelled.to);
    as_spelled.to = exporter ? exporter->name : as_spelled.to;
    o = &as_spelled;
    SPIN_TRY(spin_export_clip(o, &r));
    return spin_json_finish(
        json_pack("{s:o, s:o, s:i, s:o, s:f, s:o, s:I, s:I, s:o, s:o, s:o}", "to",
                  spin_json_text_value(o->to), "output", spin_json_text_value(o->output), "frames",
                  r.frames, "images", r.images ? json_integer((json_int_t)r.images) : json_null(),
                  "splats_mean", r.splats_mean, "bytes",
                  r.bytes ? json_integer((json_int_t)r.bytes) : json_null(), "left_out",
                  (json_int_t)r.left_out, "filtered", (json_int_t)r.filtered, "dropped",
                  dropped_json(&r), "check", check_json(&r.check), "decimated",
                  decimated_json(&r.decimated)),
        report);
}
