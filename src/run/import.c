/* spin_import(): another method's run to a bundle, or a description of it. */
#include <float.h>
#include <limits.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "base/err.h"
#include "spin_run.h"
#include "base/log.h"
#include "base/mem.h"
#include "base/text.h"
#include "run/camera_check.h"
#include "scene/clip.h"
#include "run/column_stats.h"
#include "run/data_hint.h"
#include "run/camera_overlay.h"
#include "run/frame_queue.h"
#include "run/exported_frames.h"
#include "run/frame_times.h"
#include "run/share_splats.h"
#include "io/output.h"
#include "io/image.h"
#include "io/ranks.h"
#include "scene/probe.h"

/* A description reads this many frames, evenly from all of them, unless asked for every one. */
#define DESCRIBED_FRAMES 16
/* --check-cameras draws this many views of this many frames. */
#define CHECKED_FRAMES 3
#define CHECKED_VIEWS 4
/* And the worst of the cameras that see far less than the others. */
#define CHECKED_APART 4
_Static_assert(CHECKED_FRAMES *CHECKED_VIEWS + CHECKED_APART <= SPIN_IMPORT_MAX_CAMERAS,
               "the report has room");

struct import {
    const struct spin_import_options *o;
    struct spin_import_report *report;
    const struct spin_importer *importer;
    const char *input; /* where the run is: as it was given, or one level down */
    char *below;       /* NULL: as it was given */
    struct spin_plugin_values values;
    void *self;
    struct spin_sequence_info sequence;
    struct spin_bundle_meta meta;
    struct spin_bundle_writer writer;
    bool stores, writing; /* frames go into a bundle; this process writes it */
    struct spin_splats splats;
    struct spin_views views; /* of the data set, when one is given */
    char *data;              /* its absolute path */
    int n_own;               /* frames that a continuous run has by itself; 0: not asked for */
    int *rows;               /* [n_frames] row of the data set of each frame */
    int *index;              /* [n_frames] the importer's number of each frame */
    struct spin_column_stats describe;
    struct spin_frame_queue relay; /* to the thread that writes */
};

/* ---- The data set ------------------------------------------------------------------------------ */

/* Read the data set first: its frames may be where a continuous method is sampled. */
static spin_status open_data(struct import *im)
{
    const struct spin_import_options *o = im->o;

    if (!o->data)
        return SPIN_OK;
    SPIN_TRY(spin_path_absolute(o->data, &im->data));
    SPIN_TRY(spin_views_open(im->data, o->data_from, &im->views, im->meta.data_from,
                             sizeof im->meta.data_from));
    return spin_views_check_cameras(&im->views);
}

/* What a continuous run may be sampled at when nobody says where: its own frames, where its times count those,
 * else the frames of the only data set beside it, whose images are not taken. */
static void look_for_frames(struct import *im)
{
    const struct spin_import_options *o = im->o;
    struct spin_sequence_info *t = &im->sequence;
    char from[sizeof im->meta.data_from], *beside = NULL;

    if (!o->output || !t->continuous || o->data || o->n_frames > 0 || o->n_times > 0)
        return;
    if (t->counts_frames && t->time_last - t->time_first < INT_MAX) {
        im->n_own = (int)(t->time_last - t->time_first) + 1;
        spin_add_note(t, "sampled at the %d frames that the run says it has\n", im->n_own);
        return;
    }
    beside = spin_data_beside(im->input);
    if (beside && spin_views_open(beside, NULL, &im->views, from, sizeof from) == SPIN_OK)
        spin_add_note(t, "sampled at the times of the %d frames of the data set '%s'\n",
                      im->views.n_dataset_frames, beside);
    free(beside);
}

/* See that the data set's frames can be paired with ours, and remember where it is. */
static spin_status attach_data(struct import *im)
{
    const struct spin_import_options *o = im->o;
    char *folder = NULL;
    spin_status status;

    if (!o->data)
        return SPIN_OK;
    SPIN_TRY(spin_alloc((size_t)im->meta.n_frames, sizeof(int), (void **)&im->rows));
    if (o->pair)
        snprintf(im->meta.pair, sizeof im->meta.pair, "%s", o->pair);
    SPIN_TRY(spin_views_pair(&im->views, &im->meta, im->meta.pair, im->rows));
    if (!o->output)
        return SPIN_OK;
    SPIN_TRY_OUT(spin_path_folder(o->output, &folder));
    SPIN_TRY_OUT(spin_path_relative(folder, im->data, &im->meta.data_path));
out:
    free(folder);
    return status;
}

/* ---- Which frames ------------------------------------------------------------------------------ */

/* Where a continuous method is sampled: at the times asked for, evenly, or as the data set is. */
static spin_status sample_times(struct import *im, struct spin_frame_info **out, int *n)
{
    const struct spin_import_options *o = im->o;
    const struct spin_sequence_info *t = &im->sequence;
    int n_evenly = o->n_frames > 0 ? o->n_frames : im->n_own;
    bool rows = o->n_times <= 0 && n_evenly <= 0 && im->views.n > 0;
    struct spin_frame_info *all;

    *n = o->n_times > 0 ? o->n_times : n_evenly > 0 ? n_evenly : im->views.n_dataset_frames;
    im->report->sampling = o->n_times > 0 ? SPIN_SAMPLED_TIMES
                           : n_evenly > 0 ? SPIN_SAMPLED_EVENLY
                           : *n > 0       ? SPIN_SAMPLED_DATA
                                          : SPIN_SAMPLED_ENDS;
    if (*n <= 0 && o->output)
        return spin_fail(
            SPIN_E_USAGE,
            "'%s' is continuous in time, from %g to %g, and nothing here says how many frames "
            "it has: give them with --frames, --times or --data",
            o->input, t->time_first, t->time_last);
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

        all[view->dataset_frame].number = im->views.numbered ? view->number : view->dataset_frame;
        all[view->dataset_frame].time = view->time;
    }
    if (rows)
        spin_frame_times(o->frame_times, im->views.numbered, &im->sequence, all, *n);
    im->meta.numbered = rows && im->views.numbered;
    return SPIN_OK;
}

/* The frames that a stored clip has. */
static spin_status stored_frames(struct import *im, struct spin_frame_info **out, int *n)
{
    const struct spin_import_options *o = im->o;
    const struct spin_sequence_info *t = &im->sequence;

    if (o->frame_times && strcmp(o->frame_times, "auto") != 0)
        return spin_fail(
            SPIN_E_USAGE,
            "'%s' stores its %d frames: --frame-times is for methods that are continuous "
            "in time",
            o->input, t->n_frames);
    if (o->n_frames > 0 || o->n_times > 0)
        return spin_fail(SPIN_E_USAGE,
                         "'%s' stores its %d frames: --frames and --times are "
                         "for methods that are continuous in time; use --range",
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
    int *place = NULL, n_all = 0, n = 0;
    spin_status status;

    SPIN_TRY_OUT(im->sequence.continuous ? sample_times(im, &all, &n_all)
                                         : stored_frames(im, &all, &n_all));
    im->meta.n_source_frames = n_all;
    SPIN_TRY_OUT(spin_alloc((size_t)n_all, sizeof *place, (void **)&place));
    for (int i = 0; i < n_all; i++)
        place[i] = i;
    if (!im->sequence.continuous)
        SPIN_TRY_OUT(spin_exported_frames(im->o->input, all, n_all, place, &im->meta));
    SPIN_TRY_OUT(spin_range_select(&im->o->range, all, n_all, &im->index, &n));
    SPIN_TRY_OUT(spin_bundle_meta_reserve(&im->meta, n));
    for (int i = 0; i < n; i++) {
        im->meta.frame[i] = all[im->index[i]];
        im->meta.source_index[i] = place[im->index[i]];
    }
out:
    free(place);
    free(all);
    return status;
}

/* A description may have two frames of what does not move; a bundle may not. */
static spin_status check_times(const struct import *im)
{
    spin_status status = SPIN_OK;

    SPIN_TRY(spin_frame_numbers_check(im->meta.frame, im->meta.n_frames));
    if (im->o->output)
        status = spin_times_check(im->meta.frame, NULL, im->meta.n_frames);
    return status != SPIN_OK && im->o->n_times > 0 ? spin_fail_context(SPIN_E_USAGE, "--times")
                                                   : status;
}

/* ---- Points over images ------------------------------------------------------------------------ */

/* The kth of `most` things chosen evenly from n, both ends included. */
static int spread(int k, int most, int n)
{
    return most > 1 ? (int)((int64_t)k * (n - 1) / (most - 1)) : 0;
}

static spin_status check_view(struct import *im, int frame, size_t view)
{
    struct spin_import_report *report = im->report;
    struct spin_import_camera *out = &report->camera[report->n_cameras];
    const struct spin_view *v = &im->views.view[view];
    struct spin_camera_overlay_share share = {0};
    char *path = NULL;
    spin_status status;

    out->frame = im->meta.frame[frame].number;
    out->camera = v->camera_id;
    spin_picture_name(&im->views, view, out->frame, NULL, out->file);
    SPIN_TRY(spin_path_join(im->o->check_cameras, out->file, &path));
    if (!im->o->force && spin_path_is_taken(path))
        status = spin_fail(SPIN_E_IO, "'%s' exists; use --force to overwrite", path);
    else
        status = spin_camera_overlay_draw(v, &im->splats, path, &share);
    free(path);
    SPIN_TRY(status);
    out->in_front = share.in_front;
    out->inside = share.inside;
    report->n_cameras++;
    return SPIN_OK;
}

/* Where cameras and points do not belong together, few points are in the images. */
static void judge_cameras(const struct spin_import_report *report)
{
    double in_front = 0, inside = 0;

    for (int i = 0; i < report->n_cameras; i++) {
        in_front += report->camera[i].in_front / report->n_cameras;
        inside += report->camera[i].inside / report->n_cameras;
    }
    if (in_front < 0.5)
        spin_warn(
            "only %.0f %% of the points are in front of the cameras: are the axes right, and is "
            "this the data set of that run",
            100 * in_front);
    else if (inside < 0.1)
        spin_warn(
            "only %.0f %% of the points are inside the images: are the axes right, and is this "
            "the data set of that run",
            100 * inside);
}

static spin_status read_points(struct import *im, int frame)
{
    unsigned columns = im->sequence.columns & (SPIN_COL_MEANS | SPIN_COL_SH | SPIN_COL_RGB);

    return im->importer->frame(im->self, im->index[frame], im->meta.frame[frame].time, columns,
                               &im->splats);
}

/* The frame that a row of the data set shows. */
static int frame_of_row(const struct import *im, int row)
{
    int frame = 0;

    while (im->rows[frame] != row)
        frame++;
    return frame;
}

static bool is_drawn(const struct spin_import_report *report, int number, int camera)
{
    for (int i = 0; i < report->n_cameras; i++) {
        if (report->camera[i].frame == number && report->camera[i].camera == camera)
            return true;
    }
    return false;
}

/* Report every camera; name those that lie apart, and draw the first few of them. */
static spin_status report_shares(struct import *im, const struct spin_camera_shares *shares)
{
    struct spin_import_report *report = im->report;
    int n_apart = 0;

    report->median_in_front = shares->in_front;
    report->median_inside = shares->inside;
    for (size_t k = 0; k < shares->n; k++) {
        const struct spin_camera_share *c = &shares->camera[k];
        const struct spin_view *v = &im->views.view[c->view];
        int frame = frame_of_row(im, v->dataset_frame), number = im->meta.frame[frame].number;

        if (report->n_shares < SPIN_IMPORT_MAX_SHARES)
            report->share[report->n_shares++] =
                (struct spin_import_share){v->camera_id, number, c->in_front, c->inside, c->apart};
        if (!c->apart)
            continue;
        spin_warn("camera %d has %.0f %% of the points in front and %.0f %% inside its image in "
                  "frame %d, where half of the views have %.0f %% and %.0f %% or more: is its "
                  "pose right",
                  v->camera_id, 100 * c->in_front, 100 * c->inside, number, 100 * shares->in_front,
                  100 * shares->inside);
        if (n_apart++ >= CHECKED_APART || is_drawn(report, number, v->camera_id))
            continue;
        SPIN_TRY(read_points(im, frame));
        SPIN_TRY(check_view(im, frame, c->view));
    }
    return SPIN_OK;
}

static spin_status check_cameras(struct import *im)
{
    const struct spin_import_options *o = im->o;
    int n = im->meta.n_frames < CHECKED_FRAMES ? im->meta.n_frames : CHECKED_FRAMES;
    struct spin_camera_shares shares;
    spin_status status;

    if (!o->check_cameras || spin_rank() > 0)
        return SPIN_OK;
    SPIN_TRY(spin_output_check_folder(o->check_cameras));
    for (int k = 0; k < n; k++) {
        int frame = spread(k, n, im->meta.n_frames);
        size_t view[CHECKED_VIEWS];
        size_t n_views =
            spin_camera_overlay_choose(&im->views, im->rows[frame], CHECKED_VIEWS, view);

        SPIN_TRY(read_points(im, frame));
        for (size_t i = 0; i < n_views; i++)
            SPIN_TRY(check_view(im, frame, view[i]));
    }
    judge_cameras(im->report);
    status = spin_camera_shares(&im->views, im->rows, im->meta.n_frames, &im->splats, &shares);
    if (status == SPIN_OK)
        status = report_shares(im, &shares);
    free(shares.camera);
    return status;
}

/* ---- Reading ----------------------------------------------------------------------------------- */

static void widen_bounds(struct spin_import_report *report, const struct spin_splats *s)
{
    float low[3], high[3];

    memcpy(low, report->bounds_min, sizeof low);
    memcpy(high, report->bounds_max, sizeof high);
    for (size_t i = 0; i < s->n; i++) {
        for (size_t c = 0; c < 3; c++) {
            float value = s->means[3 * i + c];

            low[c] = value < low[c] ? value : low[c];
            high[c] = value > high[c] ? value : high[c];
        }
    }
    memcpy(report->bounds_min, low, sizeof low);
    memcpy(report->bounds_max, high, sizeof high);
}

/* What frame() promised: the columns that were asked for, with room for n rows. */
static spin_status check_frame(const struct import *im, int i, unsigned wanted,
                               const struct spin_splats *s)
{
    struct spin_splats splats = *s;

    for (unsigned column = 1; column < SPIN_COLUMNS_END; column <<= 1) {
        if ((wanted & column) && (!*spin_column_of(&splats, column) || s->n > s->capacity))
            return spin_fail(SPIN_E_UNSUPPORTED, "the importer '%s' gives no %s of frame %d",
                             im->importer->name, spin_column_name(column), i);
    }
    if ((wanted & SPIN_COL_SH) && s->sh_degree != im->sequence.sh_degree)
        return spin_fail(SPIN_E_UNSUPPORTED,
                         "the importer '%s' gives SH of degree %d in frame %d, %d before",
                         im->importer->name, s->sh_degree, i, im->sequence.sh_degree);
    return SPIN_OK;
}

/* One frame, in place i of the bundle: `columns` of it, the others are those of frame 0. Rank `rank` reads it, for
 * rank 0. */
static spin_status read_frame(struct import *im, int i, int rank, unsigned columns,
                              struct spin_splats *out)
{
    struct spin_bundle_meta *meta = &im->meta;

    if (!columns) {
        meta->frame[i].n = meta->frame[0].n;
        return SPIN_OK;
    }
    if (rank == spin_rank()) {
        SPIN_TRY(im->importer->frame(im->self, im->index[i], meta->frame[i].time, columns, out));
        SPIN_TRY(check_frame(im, i, columns, out));
    }
    SPIN_TRY(spin_share_splats(out, columns, rank));
    meta->frame[i].n = out->n;
    if (im->writing && meta->static_columns && out->n != meta->frame[0].n)
        return spin_fail(SPIN_E_MALFORMED,
                         "the importer '%s' gives %zu splats in frame %d and %zu in frame 0, but "
                         "says that columns are the same in both",
                         im->importer->name, out->n, i, meta->frame[0].n);
    if (columns & SPIN_COL_MEANS)
        widen_bounds(im->report, out);
    return SPIN_OK;
}

/* In the writing thread. */
static spin_status write_frame(void *context, int i, const struct spin_splats *splats)
{
    struct import *im = context;

    return spin_bundle_write_frame(&im->writer, i, im->meta.columns, im->meta.static_columns,
                                   splats);
}

/* What is the same in every frame is written with the first one, and not read again. */
static spin_status relay_frame(struct import *im, int i)
{
    unsigned again = i == 0 ? 0 : im->meta.static_columns;
    int rank = i % spin_n_ranks();
    struct spin_splats *slot;

    if (spin_rank() > 0)
        return rank == spin_rank() ? read_frame(im, i, rank, im->meta.columns & ~again, &im->splats)
                                   : SPIN_OK;
    SPIN_TRY(spin_frame_queue_slot(&im->relay, &slot));
    SPIN_TRY(read_frame(im, i, rank, im->meta.columns & ~again, slot));
    spin_frame_queue_send(&im->relay, i);
    return SPIN_OK;
}

static spin_status describe_frame(struct import *im, int i)
{
    SPIN_TRY(read_frame(im, i, spin_rank(), im->sequence.columns, &im->splats));
    spin_column_stats_frame(&im->describe, im->sequence.columns, &im->splats);
    return SPIN_OK;
}

/* Rows of every frame: as the importer knows them, else of the frames that were read. */
static void count_splats(struct import *im, const int *read, int n_read)
{
    struct spin_import_report *report = im->report;
    const struct spin_sequence_info *t = &im->sequence;
    bool known = t->counts && (!t->continuous || t->n_frames == 1);
    int n = known ? im->meta.n_frames : n_read;

    report->splats_min = SIZE_MAX;
    for (int k = 0; k < n; k++) {
        int i = known ? k : read[k];
        size_t count = !known          ? im->meta.frame[i].n
                       : t->continuous ? t->counts[0]
                                       : t->counts[im->index[i]];

        report->splats_min = count < report->splats_min ? count : report->splats_min;
        report->splats_max = count > report->splats_max ? count : report->splats_max;
        report->splats_mean += (double)count;
    }
    report->splats_mean /= n;
}

/* An import reads every frame; a description some, as a clip may be many gigabytes. */
static spin_status read_frames(struct import *im)
{
    struct spin_import_report *report = im->report;
    int n_all = im->meta.n_frames, n = n_all, *read = NULL;
    struct spin_progress progress;
    spin_status status = SPIN_OK;

    if (!im->stores && !im->o->full && n > DESCRIBED_FRAMES)
        n = DESCRIBED_FRAMES;
    for (int c = 0; c < 3; c++) {
        report->bounds_min[c] = FLT_MAX;
        report->bounds_max[c] = -FLT_MAX;
    }
    SPIN_TRY(spin_alloc((size_t)n, sizeof *read, (void **)&read));
    spin_progress_begin(&progress, im->stores ? "importing" : "reading", "frames", 0, n);
    if (im->writing)
        SPIN_TRY_OUT(spin_frame_queue_open(&im->relay, write_frame, im));
    else if (!im->stores)
        SPIN_TRY_OUT(spin_column_stats_open(&im->describe, n));
    for (int k = 0; k < n; k++) {
        if (spin_cancelled()) {
            status = spin_fail_cancelled();
            goto out;
        }
        read[k] = n < n_all ? spread(k, n, n_all) : k;
        SPIN_TRY_OUT(im->stores ? relay_frame(im, read[k]) : describe_frame(im, read[k]));
        spin_progress_set(&progress, k + 1, "%zu splats", im->meta.frame[read[k]].n);
    }
    if (im->writing)
        SPIN_TRY_OUT(spin_frame_queue_finish(&im->relay));
    report->frames_read = n;
    count_splats(im, read, n);
    if (!im->stores)
        spin_column_stats_ranges(&im->describe, report);
out:
    spin_frame_queue_close(&im->relay);
    spin_progress_end(&progress);
    free(read);
    return status;
}

/* ---- From start to end ------------------------------------------------------------------------- */

/* How the importer was chosen, in words. */
static void say_why(struct import *im)
{
    struct spin_import_report *report = im->report;
    struct spin_peek peek;

    if (im->o->from) {
        snprintf(report->recognised, sizeof report->recognised, "named by --from");
    } else if (im->importer->probe && spin_peek_open(im->input, &peek) == SPIN_OK) {
        snprintf(report->recognised, sizeof report->recognised,
                 "by %s, with a certainty of %d in 100",
                 peek.is_folder     ? "the names in the folder and what its files begin with"
                 : *peek.tail_names ? "the names in the archive"
                                    : "its first bytes",
                 im->importer->probe(&peek));
        spin_peek_free(&peek);
    }
}

/* A last note, where there is room. */
static void hint_at_data(struct import *im)
{
    size_t used = strlen(im->report->notes);
    char hint[600];

    spin_data_hint(im->input, hint, sizeof hint);
    if (used + strlen(hint) < sizeof im->report->notes)
        memcpy(im->report->notes + used, hint, strlen(hint) + 1);
}

static void fill_report(struct import *im)
{
    struct spin_import_report *report = im->report;
    const struct spin_bundle_meta *meta = &im->meta;

    snprintf(report->from, sizeof report->from, "%s", im->importer->name);
    snprintf(report->upstream, sizeof report->upstream, "%s",
             im->importer->upstream ? im->importer->upstream : "");
    memcpy(report->variant, im->sequence.variant, sizeof report->variant);
    memcpy(report->notes, im->sequence.notes, sizeof report->notes);
    if (!im->o->data)
        hint_at_data(im);
    spin_text_tidy(report->variant, false);
    spin_text_tidy(report->notes, true);
    report->frames = meta->n_frames;
    report->continuous = im->sequence.continuous;
    report->range_first = im->sequence.time_first;
    report->range_last = im->sequence.time_last;
    report->time_first = meta->frame[0].time;
    report->time_last = meta->frame[meta->n_frames - 1].time;
    report->sh_degree = im->sequence.columns & SPIN_COL_SH ? im->sequence.sh_degree : -1;
    report->columns = im->sequence.columns;
    report->static_columns = im->sequence.static_columns;
    report->numbered = meta->numbered;
    report->number_first = meta->frame[0].number;
    report->number_last = meta->frame[meta->n_frames - 1].number;
    say_why(im);
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
    const struct spin_sequence_info *t = &im->sequence;
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
    if (o->check_cameras && !o->data)
        return spin_fail(SPIN_E_USAGE, "--check-cameras draws over images: say where with --data");
    if (o->output && spin_rank() == 0)
        SPIN_TRY(spin_output_check_file(o->output, o->force));
    SPIN_TRY(spin_importer_find_run(o->input, o->from, &im->importer, &im->below));
    im->input = im->below ? im->below : o->input;
    SPIN_TRY(spin_plugin_check(im->importer->name, im->importer->options, o->plugin_pairs));
    im->values.pairs = o->plugin_pairs;
    SPIN_TRY(im->importer->open(im->input, &im->values, &im->self, &im->sequence));
    SPIN_TRY(check_track(im));
    if (im->below)
        spin_add_note(&im->sequence, "the run is in '%s'\n", im->below);
    SPIN_TRY(open_data(im));
    look_for_frames(im);
    SPIN_TRY(choose_frames(im));
    SPIN_TRY(check_times(im));
    SPIN_TRY(attach_data(im));
    SPIN_TRY(check_cameras(im));
    snprintf(meta->from, sizeof meta->from, "%s", im->importer->name);
    snprintf(meta->upstream, sizeof meta->upstream, "%s",
             im->importer->upstream ? im->importer->upstream : "");
    memcpy(meta->variant, im->sequence.variant, sizeof meta->variant);
    meta->columns = im->sequence.columns;
    if (o->positions_only)
        meta->columns &= SPIN_COL_MEANS | SPIN_COL_RGB;
    meta->static_columns = im->sequence.static_columns & meta->columns;
    meta->identity = im->sequence.identity;
    meta->sh_degree = meta->columns & SPIN_COL_SH ? im->sequence.sh_degree : -1;
    meta->antialias = im->sequence.antialias && meta->columns & SPIN_COL_ATTRIBUTES;
    im->stores = o->output != NULL;
    if (o->output && spin_rank() == 0) {
        SPIN_TRY(spin_bundle_writer_open(o->output, o->force, o->sync, &im->writer));
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
    spin_column_stats_close(&im.describe);
    free(im.rows);
    free(im.index);
    free(im.data);
    free(im.below);
    if (status != SPIN_OK && status != SPIN_E_CANCELLED)
        return spin_fail_context(status, "cannot import '%s'", o->input);
    return status;
}
