/* The calls of spin.h that wire the rooms together: import, open, read, export, evaluate, render. */
#include <float.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "base/err.h"
#include "base/log.h"
#include "base/mem.h"
#include "core/measure.h"
#include "scene/detect.h"

void spin_set_verbosity(int level) { spin_log_set_level(level); }

/* ---- Import ----------------------------------------------------------------------------------- */

struct import {
    const struct spin_import_options *o;
    struct spin_import_report *report;
    const struct spin_importer *importer;
    struct spin_plugin_values values;
    void *self;
    struct spin_track track;
    struct spin_bundle_meta meta;
    struct spin_bundle_writer writer;
    bool writing;
    struct spin_splats splats;
    struct spin_views views; /* of the data set, when one is given */
    char *data;              /* its absolute path */
};

/* Read the data set first: its frames may be where a continuous method is sampled. */
static spin_status open_data(struct import *im)
{
    const struct spin_import_options *o = im->o;

    if (!o->data)
        return SPIN_OK;
    SPIN_TRY(spin_path_absolute(o->data, &im->data));
    return spin_views_open(im->data, o->data_from, &im->views, im->meta.data_from,
                           sizeof im->meta.data_from);
}

/* See that the data set's frames can be paired with ours, and remember where it is. */
static spin_status attach_data(struct import *im)
{
    const struct spin_import_options *o = im->o;
    char *folder = NULL;
    void *rows = NULL;
    spin_status status;

    if (!o->data)
        return SPIN_OK;
    SPIN_TRY_OUT(spin_alloc((size_t)im->meta.n_frames, sizeof(int), &rows));
    SPIN_TRY_OUT(spin_views_pair(&im->views, &im->meta, o->pair ? o->pair : "auto", rows));
    if (o->output) {
        SPIN_TRY_OUT(spin_path_folder(o->output, &folder));
        SPIN_TRY_OUT(spin_path_relative(folder, im->data, &im->meta.data_path));
    }
out:
    free(rows);
    free(folder);
    return status;
}

/* A data set without times of its own counts its frames: 0, 1, 2, ..., which leaves the range of a
 * continuous method. */
static bool rows_are_counted(const struct spin_track *t, const struct spin_frame_info *all, int n)
{
    for (int i = 0; i < n; i++) {
        if (all[i].time != i)
            return false;
    }
    return n > 1 && n - 1 > t->time_last + 0.1 * (t->time_last - t->time_first);
}

/* Times of the data set's frames by the rule asked for. Methods do not say at which times their frames
 * were, and their readers of one and the same data set differ: i/(n-1) with most, i/n with some. */
static void rule_rows(struct import *im, struct spin_frame_info *all, int n)
{
    const char *rule = im->o->frame_times ? im->o->frame_times : "auto";
    struct spin_track *t = &im->track;
    bool automatic = strcmp(rule, "auto") == 0;
    bool half_open = automatic ? t->half_open : strcmp(rule, "count") == 0;
    double span = t->time_last - t->time_first, steps = half_open ? n : n > 1 ? n - 1 : 1;
    size_t used = strlen(t->notes);

    if (strcmp(rule, "data") == 0 || (automatic && !rows_are_counted(t, all, n)))
        return;
    for (int i = 0; i < n; i++)
        all[i].time = t->time_first + span * i / steps;
    snprintf(t->notes + used, sizeof t->notes - used,
             "%sthey are spread over the times %g to %g, frame i of n at i/%s (--frame-times)\n",
             automatic ? "the data set only counts its frames: " : "the data set's frames: ",
             all[0].time, all[n - 1].time, half_open ? "n" : "(n-1)");
}

/* Where a continuous method is sampled: at the times asked for, evenly, or as the data set is. */
static spin_status sample_times(struct import *im, struct spin_frame_info **out, int *n)
{
    const struct spin_import_options *o = im->o;
    const struct spin_track *t = &im->track;
    bool rows = o->n_times <= 0 && o->n_frames <= 0 && o->data;
    struct spin_frame_info *all;

    *n = o->n_times > 0 ? o->n_times : o->n_frames > 0 ? o->n_frames : im->views.n_rows;
    if (*n <= 0 && o->output)
        return spin_fail(SPIN_E_USAGE,
                         "'%s' is defined at any time: say where to sample it with "
                         "--frames, --times or --data",
                         o->input);
    if (*n <= 0) /* a look at both ends is enough to describe it */
        *n = 2;
    SPIN_TRY(spin_alloc((size_t)*n, sizeof **out, (void **)out));
    all = *out;
    for (int i = 0; i < *n && !rows; i++) {
        double u = *n > 1 ? (double)i / (*n - 1) : 0;

        all[i].number = i;
        all[i].time =
            o->n_times > 0 ? o->times[i] : t->time_first + u * (t->time_last - t->time_first);
    }
    for (size_t v = 0; v < im->views.n && rows; v++) {
        const struct spin_view *view = &im->views.view[v];

        all[view->row].number = im->views.numbered ? view->number : view->row;
        all[view->row].time = view->time;
    }
    if (rows)
        rule_rows(im, all, *n);
    im->meta.numbered = rows && im->views.numbered;
    return SPIN_OK;
}

/* The frames that a stored clip has. */
static spin_status stored_frames(struct import *im, struct spin_frame_info **out, int *n)
{
    const struct spin_import_options *o = im->o;
    const struct spin_track *t = &im->track;

    if (o->frame_times && strcmp(o->frame_times, "auto") != 0)
        return spin_fail(SPIN_E_USAGE,
                         "'%s' has %d frames as they are: --frame-times is for methods defined at "
                         "any time",
                         o->input, t->n_frames);
    if (o->n_frames > 0 || o->n_times > 0)
        return spin_fail(SPIN_E_USAGE,
                         "'%s' has %d frames as they are: --frames and --times are "
                         "for methods defined at any time; use --range",
                         o->input, t->n_frames);
    *n = t->n_frames;
    SPIN_TRY(spin_alloc((size_t)*n, sizeof **out, (void **)out));
    for (int i = 0; i < *n; i++) {
        (*out)[i].number = t->numbers ? t->numbers[i] : i;
        (*out)[i].time = t->times ? t->times[i] : i;
    }
    im->meta.numbered = t->numbers != NULL;
    return SPIN_OK;
}

/* All frames, less those outside the range. */
static spin_status choose_frames(struct import *im)
{
    struct spin_frame_info *all = NULL;
    int *index = NULL, n_all = 0, n = 0;
    spin_status status;

    SPIN_TRY_OUT(im->track.continuous ? sample_times(im, &all, &n_all)
                                      : stored_frames(im, &all, &n_all));
    SPIN_TRY_OUT(spin_range_select(&im->o->range, all, n_all, &index, &n));
    SPIN_TRY_OUT(spin_bundle_meta_reserve(&im->meta, n));
    for (int i = 0; i < n; i++) {
        im->meta.frame[i] = all[index[i]];
        im->meta.source_index[i] = index[i];
    }
    im->meta.n_source_frames = n_all;
out:
    free(index);
    free(all);
    return status;
}

static void widen_bounds(struct spin_import_report *report, const struct spin_splats *s)
{
    for (size_t i = 0; i < s->n * 3; i++) {
        float *low = &report->bounds_min[i % 3], *high = &report->bounds_max[i % 3];

        *low = s->means[i] < *low ? s->means[i] : *low;
        *high = s->means[i] > *high ? s->means[i] : *high;
    }
}

static spin_status read_frames(struct import *im)
{
    struct spin_import_report *report = im->report;
    struct spin_bundle_meta *meta = &im->meta;
    struct spin_progress progress;
    double sum = 0;
    spin_status status = SPIN_OK;

    report->splats_min = SIZE_MAX;
    for (int c = 0; c < 3; c++) {
        report->bounds_min[c] = FLT_MAX;
        report->bounds_max[c] = -FLT_MAX;
    }
    spin_progress_begin(&progress, "importing", "frames", 0, meta->n_frames);
    for (int i = 0; i < meta->n_frames; i++) {
        size_t n;

        if (spin_cancelled()) {
            status = spin_fail_cancelled();
            goto out;
        }
        SPIN_TRY_OUT(im->importer->frame(im->self, meta->source_index[i], meta->frame[i].time,
                                         im->writing ? meta->columns : SPIN_COL_MEANS,
                                         &im->splats));
        n = im->splats.n;
        meta->frame[i].n = n;
        report->splats_min = n < report->splats_min ? n : report->splats_min;
        report->splats_max = n > report->splats_max ? n : report->splats_max;
        sum += (double)n;
        widen_bounds(report, &im->splats);
        if (im->writing)
            SPIN_TRY_OUT(spin_bundle_write_frame(&im->writer, i, meta->columns, meta->still_columns,
                                                 &im->splats));
        spin_progress_set(&progress, i + 1, "%zu splats", n);
    }
    report->splats_mean = sum / meta->n_frames;
out:
    spin_progress_end(&progress);
    return status;
}

static void fill_report(struct import *im)
{
    struct spin_import_report *report = im->report;
    const struct spin_bundle_meta *meta = &im->meta;

    snprintf(report->from, sizeof report->from, "%s", im->importer->name);
    memcpy(report->variant, im->track.variant, sizeof report->variant);
    memcpy(report->notes, im->track.notes, sizeof report->notes);
    report->frames = meta->n_frames;
    report->time_first = meta->frame[0].time;
    report->time_last = meta->frame[meta->n_frames - 1].time;
    report->sh_degree = im->track.columns & SPIN_COL_SH ? im->track.sh_degree : -1;
    report->columns = im->track.columns;
    report->numbered = meta->numbered;
    report->number_first = meta->frame[0].number;
    report->number_last = meta->frame[meta->n_frames - 1].number;
}

/* Options the plug-in does not have are asked wrongly, not dropped. */
static spin_status check_values(const char *plugin, const struct spin_plugin_option *options,
                                const char *const *pairs)
{
    for (size_t i = 0; pairs && pairs[i]; i += 2) {
        const struct spin_plugin_option *o = options;

        while (o && o->key && strcmp(o->key, pairs[i]) != 0)
            o++;
        if (!o || !o->key)
            return spin_fail(SPIN_E_USAGE, "'%s' has no option --%s", plugin, pairs[i]);
    }
    return SPIN_OK;
}

static spin_status check_frame_times(const struct spin_import_options *o)
{
    static const char *const rules[] = {"auto", "data", "unit", "count"};

    if (!o->frame_times)
        return SPIN_OK;
    if (!o->data || o->n_frames > 0 || o->n_times > 0)
        return spin_fail(SPIN_E_USAGE,
                         "--frame-times says how --data gives the times: it goes with a data set, "
                         "and without --frames and --times");
    for (size_t i = 0; i < sizeof rules / sizeof *rules; i++) {
        if (strcmp(o->frame_times, rules[i]) == 0)
            return SPIN_OK;
    }
    return spin_fail(SPIN_E_USAGE, "--frame-times is '%s', expected auto, data, unit or count",
                     o->frame_times);
}

/* What open() promised, held to the rules: an importer may have been built elsewhere. */
static spin_status check_track(const struct import *im)
{
    const struct spin_track *t = &im->track;
    const char *name = im->importer->name;

    if (!t->continuous && t->n_frames < 1)
        return spin_fail(SPIN_E_MALFORMED, "the importer '%s' found no frames", name);
    if (!(t->columns & SPIN_COL_MEANS))
        return spin_fail(SPIN_E_UNSUPPORTED, "the importer '%s' gives no positions", name);
    if ((t->columns & SPIN_COL_SH) && (t->sh_degree < 0 || t->sh_degree > 3))
        return spin_fail(SPIN_E_UNSUPPORTED, "the importer '%s' gives SH of degree %d, not 0..3",
                         name, t->sh_degree);
    return SPIN_OK;
}

static spin_status run_import(struct import *im)
{
    const struct spin_import_options *o = im->o;
    struct spin_bundle_meta *meta = &im->meta;

    SPIN_TRY(check_frame_times(o));
    SPIN_TRY(spin_importer_find(o->input, o->from, false, &im->importer));
    SPIN_TRY(check_values(im->importer->name, im->importer->options, o->plugin_pairs));
    im->values.pairs = o->plugin_pairs;
    SPIN_TRY(im->importer->open(o->input, &im->values, &im->self, &im->track));
    SPIN_TRY(check_track(im));
    SPIN_TRY(open_data(im));
    SPIN_TRY(choose_frames(im));
    SPIN_TRY(attach_data(im));
    snprintf(meta->from, sizeof meta->from, "%s", im->importer->name);
    snprintf(meta->upstream, sizeof meta->upstream, "%s",
             im->importer->upstream ? im->importer->upstream : "");
    memcpy(meta->variant, im->track.variant, sizeof meta->variant);
    meta->columns = im->track.columns;
    if (o->positions_only)
        meta->columns &= SPIN_COL_MEANS | SPIN_COL_RGB;
    meta->still_columns = im->track.still_columns & meta->columns;
    meta->sh_degree = meta->columns & SPIN_COL_SH ? im->track.sh_degree : -1;
    if (o->output) {
        SPIN_TRY(spin_bundle_writer_open(o->output, o->force, &im->writer));
        im->writing = true;
    }
    SPIN_TRY(read_frames(im));
    fill_report(im);
    if (im->writing) {
        im->writing = false;
        SPIN_TRY(spin_bundle_writer_finish(&im->writer, meta, NULL));
    }
    return SPIN_OK;
}

spin_status spin_import(const struct spin_import_options *o, struct spin_import_report *report)
{
    struct import im = {.o = o, .report = report};
    spin_status status;

    memset(report, 0, sizeof *report);
    status = run_import(&im);
    if (im.writing)
        spin_bundle_writer_abandon(&im.writer);
    if (im.importer && im.importer->close && im.self)
        im.importer->close(im.self);
    spin_bundle_meta_free(&im.meta);
    spin_splats_free(&im.splats);
    spin_views_free(&im.views);
    free(im.data);
    if (status != SPIN_OK && status != SPIN_E_CANCELLED)
        return spin_more(status, "cannot import '%s'", o->input);
    return status;
}

/* ---- A clip, open for reading ------------------------------------------------------------------ */

struct spin_scene {
    struct spin_bundle bundle;
    struct spin_device device;
    struct spin_player player; /* of the network; opened when first needed */
    bool has_network, device_open, player_open;
};

spin_status spin_scene_open(const char *path, struct spin_scene **out)
{
    void *block = NULL;
    struct spin_scene *scene;
    spin_status status;

    SPIN_TRY(spin_alloc(1, sizeof *scene, &block));
    scene = block;
    status = spin_bundle_open(path, &scene->bundle);
    if (status != SPIN_OK) {
        free(scene);
        return status;
    }
    scene->has_network = spin_bundle_has_network(&scene->bundle);
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

bool spin_scene_has_network(const struct spin_scene *scene) { return scene->has_network; }

unsigned spin_scene_columns(const struct spin_scene *scene) { return scene->bundle.meta.columns; }

spin_status spin_scene_read(struct spin_scene *scene, int frame, enum spin_from from,
                            unsigned columns, struct spin_splats *out)
{
    if (from == SPIN_FROM_SOURCE || (from == SPIN_FROM_BEST && !scene->has_network))
        return spin_bundle_frame(&scene->bundle, frame, columns, out);
    if (!scene->has_network)
        return spin_fail(SPIN_E_NOT_FOUND, "'%s' has no network: run spin-retrain",
                         scene->bundle.path);
    if (!scene->device_open) {
        SPIN_TRY(spin_device_open("auto", 0, &scene->device));
        scene->device_open = true;
    }
    if (!scene->player_open) {
        SPIN_TRY(spin_player_open(&scene->player, &scene->device, &scene->bundle, true));
        scene->player_open = true;
    }
    return spin_player_splats(&scene->player, frame, columns, out);
}

/* ---- Drawing ----------------------------------------------------------------------------------- */

struct spin_renderer {
    struct spin_player player;
};

spin_status spin_render(struct spin_renderer *r, const struct spin_splats *splats,
                        const struct spin_camera *camera, const float background[3], float *image)
{
    SPIN_TRY(spin_player_show_splats(&r->player, splats));
    return spin_player_draw(&r->player, camera, background, image);
}

/* ---- Which attributes ---------------------------------------------------------------------------- */

static spin_status choose_network(const struct spin_bundle *bundle, bool source, bool *network)
{
    unsigned missing = SPIN_COL_ATTRIBUTES & ~bundle->meta.columns;

    *network = !source && spin_bundle_has_network(bundle);
    if (*network || !missing)
        return SPIN_OK;
    if (source)
        return spin_fail(SPIN_E_NOT_FOUND, "'%s' holds positions only, no source attributes",
                         bundle->path);
    return spin_fail(SPIN_E_NOT_FOUND, "'%s' holds positions only: run spin-retrain first",
                     bundle->path);
}

/* ---- Evaluation ---------------------------------------------------------------------------------- */

struct eval {
    const struct spin_eval_options *o;
    struct spin_eval_report *report;
    struct spin_clip clip;
    struct spin_pixels pixels;
    struct spin_device device;
    struct spin_player player, source;
    struct spin_pair *pairs;
    size_t n_pairs;
};

static spin_status run_eval(struct eval *e)
{
    const struct spin_eval_options *o = e->o;
    struct spin_clip_options c = {.input = o->input,
                                  .data = o->data,
                                  .data_from = o->data_from,
                                  .pair = o->pair,
                                  .range = o->range,
                                  .test_cameras = o->test_cameras,
                                  .n_test_cameras = o->n_test_cameras,
                                  .image_scale = o->image_scale,
                                  .needs_views = true};
    struct spin_measure m = {.player = &e->player,
                             .clip = &e->clip,
                             .pixels = &e->pixels,
                             .background = o->background,
                             .images = o->images,
                             .what = "evaluating"};
    void *block = NULL;

    SPIN_TRY(spin_clip_open(&c, &e->clip));
    SPIN_TRY(choose_network(&e->clip.bundle, o->source, &e->report->network));
    SPIN_TRY(spin_clip_pairs(&e->clip, o->split, &e->pairs, &e->n_pairs));
    if (e->n_pairs == 0)
        return spin_fail(SPIN_E_NOT_FOUND, "the data set has no view in this split");
    SPIN_TRY(spin_pixels_open(&e->clip.views, 0, o->background, &e->pixels));
    SPIN_TRY(spin_device_open(o->device, o->n_threads, &e->device));
    SPIN_TRY(spin_player_open(&e->player, &e->device, &e->clip.bundle, e->report->network));
    SPIN_TRY(spin_alloc(e->n_pairs, sizeof *e->report->view, &block));
    e->report->view = block;
    if (o->images)
        SPIN_TRY(spin_folder_make(o->images));
    if (o->images && e->report->network && !(SPIN_COL_ATTRIBUTES & ~e->clip.bundle.meta.columns)) {
        SPIN_TRY(spin_player_open(&e->source, &e->device, &e->clip.bundle, false));
        m.source = &e->source;
    }
    m.pairs = e->pairs;
    m.n_pairs = e->n_pairs;
    m.view = e->report->view;
    SPIN_TRY(spin_measure_run(&m, &e->report->mean));
    e->report->n_views = e->n_pairs;
    e->report->seconds_render = m.seconds / (double)e->n_pairs;
    return SPIN_OK;
}

spin_status spin_eval(const struct spin_eval_options *o, struct spin_eval_report *report)
{
    struct eval e = {.o = o, .report = report};
    spin_status status;

    memset(report, 0, sizeof *report);
    status = run_eval(&e);
    spin_player_close(&e.player);
    spin_player_close(&e.source);
    spin_device_close(&e.device);
    spin_pixels_close(&e.pixels);
    spin_clip_close(&e.clip);
    free(e.pairs);
    if (status != SPIN_OK)
        spin_eval_report_free(report);
    if (status != SPIN_OK && status != SPIN_E_CANCELLED)
        return spin_more(status, "cannot evaluate '%s'", o->input);
    return status;
}

void spin_eval_report_free(struct spin_eval_report *report)
{
    free(report->view);
    memset(report, 0, sizeof *report);
}

/* ---- Export ---------------------------------------------------------------------------------------- */

struct export
{
    const struct spin_export_options *o;
    struct spin_export_report *report;
    const struct spin_exporter *exporter;
    struct spin_clip clip;
    struct spin_device device;
    struct spin_player player;
    struct spin_renderer *renderer;
    struct spin_splats splats;
    void *self;
};

static spin_status find_exporter(const char *name, const struct spin_exporter **out)
{
    char known[256] = "";

    for (const struct spin_exporter *const *i = spin_exporter_list(); *i; i++) {
        size_t used = strlen(known);

        if (strcmp((*i)->name, name) == 0) {
            *out = *i;
            return SPIN_OK;
        }
        snprintf(known + used, sizeof known - used, "%s%s", used ? ", " : "", (*i)->name);
    }
    if (spin_plugin_fault(name))
        return spin_fail(SPIN_E_UNSUPPORTED, "%s", spin_plugin_fault(name));
    return spin_fail(SPIN_E_USAGE, "no exporter '%s': there is %s", name, known);
}

static double clip_fps(const struct spin_clip *clip)
{
    const struct spin_frame_info *info = clip->bundle.meta.frame;
    double span = info[clip->frame[clip->n_frames - 1]].time - info[clip->frame[0]].time;

    /* A unit of one per frame is a frame number, not seconds. */
    if (clip->n_frames < 2 || span <= 0 || span == clip->n_frames - 1)
        return 0;
    return (clip->n_frames - 1) / span;
}

static spin_status write_frames(struct export *x)
{
    struct spin_progress progress;
    unsigned columns = SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES;
    spin_status status = SPIN_OK;

    spin_progress_begin(&progress, "exporting", "frames", 0, x->clip.n_frames);
    for (int f = 0; f < x->clip.n_frames; f++) {
        int index = x->clip.frame[f];

        if (spin_cancelled()) {
            status = spin_fail_cancelled();
            break;
        }
        status = spin_player_splats(&x->player, index, columns, &x->splats);
        if (status == SPIN_OK)
            status = x->exporter->frame(x->self, f, &x->clip.bundle.meta.frame[index], &x->splats);
        if (status != SPIN_OK)
            break;
        spin_progress_set(&progress, f + 1, "%zu splats", x->splats.n);
    }
    spin_progress_end(&progress);
    return status;
}

static spin_status begin_export(struct export *x, bool network)
{
    const struct spin_export_options *o = x->o;
    struct spin_plugin_values values = {.pairs = o->plugin_pairs};
    struct spin_export_job job = {
        .output = o->output,
        .force = o->force,
        .n_frames = x->clip.n_frames,
        .fps = clip_fps(&x->clip),
        .source = x->clip.bundle.meta.from,
        .sh_degree = network ? x->player.model.sh_degree : x->clip.bundle.meta.sh_degree,
        .values = &values,
        .views = x->clip.has_views ? &x->clip.views : NULL,
        .row_of_frame = x->clip.row,
        .renderer = x->renderer,
        .background = o->background,
        .n_threads = o->n_threads,
    };
    spin_status status;

    SPIN_TRY(x->exporter->begin(&job, &x->self));
    status = write_frames(x);
    if (status != SPIN_OK) {
        x->exporter->abort(x->self);
        return status;
    }
    return x->exporter->end(x->self);
}

static spin_status run_export(struct export *x)
{
    const struct spin_export_options *o = x->o;
    struct spin_clip_options c = {.input = o->input,
                                  .data = o->data,
                                  .data_from = o->data_from,
                                  .pair = o->pair,
                                  .range = o->range};
    bool network;
    void *block = NULL;

    SPIN_TRY(find_exporter(o->to, &x->exporter));
    SPIN_TRY(check_values(o->to, x->exporter->options, o->plugin_pairs));
    c.needs_views = x->exporter->needs_renderer;
    SPIN_TRY(spin_clip_open(&c, &x->clip));
    SPIN_TRY(choose_network(&x->clip.bundle, o->source, &network));
    SPIN_TRY(spin_device_open(o->device, o->n_threads, &x->device));
    SPIN_TRY(spin_player_open(&x->player, &x->device, &x->clip.bundle, network));
    if (x->exporter->needs_renderer) {
        SPIN_TRY(spin_alloc(1, sizeof *x->renderer, &block));
        x->renderer = block;
        SPIN_TRY(spin_player_open(&x->renderer->player, &x->device, NULL, false));
    }
    x->report->frames = x->clip.n_frames;
    x->report->splats_mean = x->clip.n_mean;
    return begin_export(x, network);
}

spin_status spin_export(const struct spin_export_options *o, struct spin_export_report *report)
{
    struct export x = {.o = o, .report = report};
    spin_status status;

    memset(report, 0, sizeof *report);
    status = run_export(&x);
    if (x.renderer)
        spin_player_close(&x.renderer->player);
    free(x.renderer);
    spin_player_close(&x.player);
    spin_device_close(&x.device);
    spin_clip_close(&x.clip);
    spin_splats_free(&x.splats);
    if (status != SPIN_OK && status != SPIN_E_CANCELLED)
        return spin_more(status, "cannot export '%s'", o->input);
    return status;
}
