/* spin_import(): imports a run of another method as a bundle, or only describes the run. */
#include <float.h>

#include "base/base.h"
#include "math/drawable.h"
#include "math/scene_rotation.h"
#include "spin_run.h"
#include "run/camera_check.h"
#include "scene/bundle.h"
#include "scene/clip.h"
#include "run/column_stats.h"
#include "run/data_hint.h"
#include "run/import_frames.h"
#include "run/nerfstudio_world.h"
#include "io/archive.h"
#include "io/output.h"
#include "io/image.h"
#include "io/numbered.h"
#include "io/ranks.h"
#include "scene/columns.h"
#include "scene/dataset.h"
#include "scene/kept_cameras.h"
#include "scene/probe.h"
#include "scene/splats_4d.h"

/* A description, which is an import without output, reads this many frames, evenly spaced, unless
 * the user requests all. */
#define DESCRIBED_FRAMES 16
/* If a file states its number of frames, at most this many are sampled by default, since the number
 * in the file may be wrong. The limit is 36 minutes at 30 frames per second. */
#define MOST_OWN 65536
/* --check-cameras draws CHECKED_VIEWS views of each of CHECKED_FRAMES frames. */
#define CHECKED_FRAMES 3
#define CHECKED_VIEWS 4
/* --check-cameras also draws one view each of at most this many outliers, which are cameras with
 * far fewer points in their images than other cameras have. */
#define CHECKED_APART 4
struct import {
    const struct spin_import_options *o;
    spin_json *report; /* printed by --json, see spin-import(1) */
    const struct spin_importer *importer;
    /* Path of the run: o->input, a folder inside o->input, the folder of a pattern, or a path in
     * the temporary folder of an archive. */
    const char *input;
    char *below; /* `input` if it was allocated; NULL if it is o->input */
    struct spin_plugin_values values;
    const char **pairs;            /* the pairs of `values` if o->input is a pattern; else NULL */
    struct spin_unpacked unpacked; /* the contents of o->input if that is an archive */
    void *self;
    struct spin_sequence_info sequence;
    struct spin_bundle_meta meta;
    struct spin_bundle_writer writer;
    /* `stores`: a bundle is written, not only a description; `writing`: this rank writes it. */
    bool stores, writing;
    struct spin_splats splats;
    const struct spin_splats_4d *four_d; /* 4D splats of the source, or NULL */
    bool keeps_4d;                       /* true: the bundle stores four_d instead of frames */
    struct spin_views views;             /* views of the data set, if there is one */
    char *data;                          /* absolute path of the data set, or NULL */
    /* If `is_placed` is true, `placement` moves all splats from nerfstudio's world to that of the
     * data set. `unplaced` is a frame before this move, `placed_4d` are the 4D splats after it. */
    bool is_placed;
    struct spin_placement placement;
    struct spin_splats unplaced;
    struct spin_splats_4d placed_4d;
    /* Number of frames that are sampled from a continuous run if the user does not choose them; 0
     * if the number is unknown or not needed. */
    int n_own;
    int *rows;  /* [n_frames] index of the data set frame that belongs to each frame */
    int *index; /* [n_frames] index of each frame, as argument of the importer's frame() */
    struct spin_column_stats describe;
    float low[3], high[3]; /* bounding box of the positions */

    /* Frame i is read while frame i - 1 is written, so that an import takes only as long as reading
     * or writing, whichever is slower. */
    struct spin_pool *pool;
    int step;                   /* index of the frame being read */
    struct spin_splats slot[2]; /* frame i is in slot i % 2 */
    struct {
        spin_status status;
        char why[1024]; /* copy of spin_last_error(), which is thread-local */
    } done[2];          /* results of task 0, which reads, and of task 1, which writes */
};

/* Returns the path beside which data sets are searched for: the path that the user gave, even if
 * the input was unpacked to another folder. */
static const char *own_place(const struct import *im)
{
    return im->unpacked.folder ? im->o->input : im->input;
}

/* Reads frame i of the import, in the order of im->index, from the importer. */
static spin_status source_frame(struct import *im, int i, unsigned columns, struct spin_splats *out)
{
    struct spin_splats *raw = im->is_placed ? &im->unplaced : out;

    SPIN_TRY(im->importer->frame(im->self, im->index[i], im->meta.frame[i].time, columns, raw));
    if (!im->is_placed)
        return SPIN_OK;
    SPIN_TRY(spin_splats_reserve(out, raw->n, columns, raw->sh_degree));
    out->antialias = raw->antialias;
    spin_splats_place(raw, columns, &im->placement, 0, out);
    if ((columns & SPIN_COL_RGB) && raw->n > 0)
        memcpy(out->rgb, raw->rgb, 3 * raw->n * sizeof *raw->rgb);
    return SPIN_OK;
}

/* ---- The data set ---------------------------------------------------------------------------- */

/* Closes the data set that spin-export recorded beside an exported clip, with a warning. The user
 * did not request this data set, so the import continues without it. */
static void drop_data(struct import *im)
{
    spin_warn("not using the data set of the exported clip: %s", spin_last_error());
    spin_views_free(&im->views);
    free(im->data);
    im->data = NULL;
    im->meta.data_from[0] = '\0';
}

/* The placement maps positions that include the shift of the sequence, but is applied to the
 * importer's positions, which lack it. Adds the mapped shift to the placement, and clears the shift
 * of the sequence. */
static void place_shift(struct import *im)
{
    struct spin_placement *p = &im->placement;
    struct spin_scene_rotation turn;
    double *shift = im->sequence.shift;
    spin_vec3 v;

    spin_scene_rotation_from(p->q, &turn);
    v = spin_scene_rotation_place(&turn,
                                  spin_v3((float)shift[0], (float)shift[1], (float)shift[2]));
    p->shift[0] += p->scale * v.x;
    p->shift[1] += p->scale * v.y;
    p->shift[2] += p->scale * v.z;
    memset(shift, 0, sizeof im->sequence.shift);
}

/* Undoes the centring and scaling of nerfstudio, so that the splats fit the cameras of the data
 * set. Without a data set, only a note mentions the transform. */
static spin_status undo_centring(struct import *im)
{
    SPIN_FREED char *path = NULL;
    spin_status status = spin_parser_find(im->input, im->data, im->meta.data_from, &im->placement,
                                          &path, &im->is_placed);

    if (!im->data && (status != SPIN_OK || im->is_placed)) {
        im->is_placed = false;
        if (status == SPIN_OK)
            spin_note(&im->sequence,
                      "nerfstudio centred and scaled the scene ('%s'): give the data set with "
                      "--data to undo this",
                      path);
        return status == SPIN_E_MEMORY ? status : SPIN_OK;
    }
    if (status != SPIN_OK || !im->is_placed)
        return status;
    spin_note(&im->sequence,
              "the splats were moved to the world of the data set: nerfstudio's centring and scale "
              "of %g ('%s') are undone",
              1 / im->placement.scale, path);
    place_shift(im);
    if (!im->four_d)
        return SPIN_OK;
    SPIN_TRY(spin_splats_4d_place(im->four_d, &im->placement, &im->placed_4d));
    im->four_d = &im->placed_4d;
    return SPIN_OK;
}

/* Opens the data set. This comes before the choice of frames, since a continuous method may be
 * sampled at the times of the data set's frames. */
static spin_status open_data(struct import *im)
{
    const struct spin_import_options *o = im->o;
    SPIN_FREED char *from = NULL, *path = NULL;
    spin_status status = SPIN_OK;

    if (!o->data && !im->sequence.continuous) /* the data set that spin-export recorded */
        SPIN_TRY(spin_exported_data(im->input, &path, &from));
    if (o->data)
        SPIN_TRY(spin_foreign_missing(o->data));
    if (o->data || path)
        SPIN_TRY(spin_path_absolute(o->data ? o->data : path, &im->data));
    if (im->data)
        status = spin_views_open(im->data, o->data ? o->data_from : from, &im->views,
                                 im->meta.data_from, sizeof im->meta.data_from);
    if (im->data && status == SPIN_OK)
        status = spin_views_check_cameras(&im->views, false);
    if (status != SPIN_OK && !o->data && status != SPIN_E_MEMORY) {
        drop_data(im);
        status = SPIN_OK;
    }
    if (status == SPIN_OK)
        status = undo_centring(im);
    if (im->data && status == SPIN_OK)
        spin_views_shift(&im->views, im->sequence.shift);
    if (im->data && *im->views.notes)
        spin_note(&im->sequence, "%s", im->views.notes);
    if (im->data && !o->data)
        spin_note(&im->sequence, "using the data set of the exported clip: '%s'", im->data);
    return status;
}

/* Chooses the frames of a continuous run if the user did not choose any. If the run states its
 * number of frames, this number of frames is sampled. Otherwise, if the run's times are frame
 * numbers, one frame is sampled for each number. Otherwise, if exactly one data set is beside the
 * run, the times of its frames are used, but not its images. Otherwise, 4D splats get 30 frames per
 * unit of time, as if the unit were a second, but 61 frames if the time range is at most 2 or at
 * least 10,000 units long. Other runs get the default of the caller, if the caller has one. */
static void choose_default_frames(struct import *im)
{
    const struct spin_import_options *o = im->o;
    struct spin_sequence_info *t = &im->sequence;
    char from[sizeof im->meta.data_from], frames[48];
    SPIN_FREED char *beside = NULL;

    if (!t->continuous || o->data || o->n_frames > 0 || o->n_times > 0)
        return;
    im->n_own = t->n_clip_frames;
    if (im->n_own > MOST_OWN) {
        im->n_own = MOST_OWN;
        spin_note(t,
                  "the clip has %d frames, of which %d are sampled, evenly spaced in time (to "
                  "sample another number, give --frames)",
                  t->n_clip_frames, MOST_OWN);
    }
    if (!o->output || im->n_own > 0)
        return;
    if (t->counts_frames && t->time_last - t->time_first < INT_MAX) {
        im->n_own = (int)(t->time_last - t->time_first) + 1;
        spin_note(t, "sampled at the times of the %s that the run contains",
                  spin_text_count(im->n_own, "frame", frames));
        return;
    }
    beside = spin_data_beside(own_place(im));
    if (beside && spin_views_open(beside, NULL, &im->views, from, sizeof from) == SPIN_OK)
        spin_note(t, "sampled at the times of the %s of the data set '%s'",
                  spin_text_count(im->views.n_dataset_frames, "frame", frames), beside);
    if (im->four_d && im->views.n == 0) {
        double span = t->time_last - t->time_first;

        im->n_own = span > 2 && span < 1e4 ? (int)(30 * span + 0.5) + 1 : 61;
        spin_note(t,
                  "the run does not store its number of frames, so %d frames are sampled from time "
                  "%g to %g%s (to use the frame times of a data set, give --data)",
                  im->n_own, t->time_first, t->time_last,
                  im->keeps_4d ? "; the 4D splats cover all times in between" : "");
    } else if (im->views.n == 0 && o->default_frames > 0) {
        im->n_own = o->default_frames;
        spin_log(0,
                 "the run does not store its number of frames, so %d frames are sampled from time "
                 "%g to %g; --frames samples another number",
                 im->n_own, t->time_first, t->time_last);
    }
}

/* Adds a note to imports from Realtime-4DGS if the data set stores focal lengths as "fl_x". That
 * method then assumes a field of view of -1, so it rasterises with wrong footprints, and the splats
 * grow too large in training. */
static void note_focal(struct import *im)
{
    SPIN_FREED char *beside = im->data ? NULL : spin_data_beside(own_place(im));
    const char *data = im->data ? im->data : beside;

    if (data && strcmp(im->importer->name, "realtime4dgs") == 0 && spin_data_has_focal(data))
        spin_note(&im->sequence,
                  "'%s' stores focal lengths as fl_x, which Realtime-4DGS reads as a field of view "
                  "of -1: the splats of the run are too large and look blurred; spin-retrain "
                  "corrects this",
                  data);
}

/* Keeps cameras in the bundle: those of the data set in the first paired frame or, without a data
 * set, those of the run's cameras.json. Exports use the kept cameras if the data set does not
 * exist. */
static spin_status keep_cameras(struct import *im)
{
    SPIN_FREED char *path = NULL;
    int f = 0;

    if (!im->data) {
        SPIN_TRY(spin_kept_cameras_find(im->input, &im->meta.cameras, &path));
        spin_views_shift(&im->meta.cameras, im->sequence.shift);
        if (path)
            spin_log(1, "keeping the %zu different cameras of '%s'", im->meta.cameras.n, path);
        return SPIN_OK;
    }
    while (f < im->meta.n_frames - 1 && im->rows[f] < 0)
        f++;
    return spin_kept_cameras_choose(&im->views, im->rows[f], &im->meta.cameras);
}

/* Returns whether the run is a static scene that can be sampled at any time, such as the initial
 * points of a data set. */
static bool is_static(const struct spin_sequence_info *t)
{
    return t->continuous && t->n_clip_frames == 1 && t->static_columns == t->columns;
}

/* Checks that the data set's frames can be paired with those of the clip, and records its path. */
static spin_status attach_data(struct import *im)
{
    const struct spin_import_options *o = im->o;
    SPIN_FREED char *folder = NULL;
    spin_status status;

    if (!im->data)
        return SPIN_OK;
    SPIN_TRY(spin_alloc((size_t)im->meta.n_frames, sizeof(int), (void **)&im->rows));
    if (!o->pair && is_static(&im->sequence) && im->meta.n_source_frames == 1)
        strcpy(im->meta.pair, "order"); /* a still is paired with the first frame of the data set */
    if (o->pair)
        snprintf(im->meta.pair, sizeof im->meta.pair, "%s", o->pair);
    status = spin_views_pair(&im->views, &im->meta, im->meta.pair, im->rows);
    if (status != SPIN_OK && !o->data && status != SPIN_E_MEMORY) {
        drop_data(im);
        return SPIN_OK;
    }
    SPIN_TRY(status);
    SPIN_TRY(spin_views_warn_single(&im->views));
    if (!o->output)
        return SPIN_OK;
    SPIN_TRY(spin_path_folder(o->output, &folder));
    return spin_bundle_set_data_path(&im->meta, folder, im->data);
}

/* ---- Which frames ---------------------------------------------------------------------------- */

/* Warns if the sample times lie outside the time range of the training by more than a tenth of this
 * range. A continuous method extrapolates beyond its time range without an error. The margin allows
 * for one or two frames after the last frame of the training. */
static void warn_outside(const struct spin_sequence_info *t, const struct spin_frame_info *frame,
                         int n)
{
    double room = 0.1 * (t->time_last - t->time_first), odd = 0;
    int n_outside = 0;

    for (int i = 0; i < n; i++)
        if (frame[i].time < t->time_first - room || frame[i].time > t->time_last + room)
            odd = n_outside++ ? odd : frame[i].time;
    if (n_outside > 0)
        spin_warn("%s outside the time range of the run, %g to %g, such as %g",
                  spin_text_share((size_t)n_outside, (size_t)n, "time", "is", "are", (char[96]){0}),
                  t->time_first, t->time_last, odd);
}

/* Lists the frames of a continuous method. Their times come from --times, if this option is given.
 * Otherwise they are evenly spaced if the number of frames is known, and those of the data set if
 * this number is unknown. */
static spin_status sample_times(struct import *im, struct spin_frame_info **out, int *n)
{
    const struct spin_import_options *o = im->o;
    const struct spin_sequence_info *t = &im->sequence;
    int n_evenly = o->n_frames > 0 ? o->n_frames : im->n_own;
    bool rows = o->n_times <= 0 && n_evenly <= 0 && im->views.n > 0;
    struct spin_frame_info *all;

    *n = o->n_times > 0 ? o->n_times : n_evenly > 0 ? n_evenly : im->views.n_dataset_frames;
    spin_json_set_string(im->report, "sampled",
                         o->n_times > 0 ? "times"
                         : n_evenly > 0 ? "evenly"
                         : *n > 0       ? "data"
                                        : "ends");
    if (*n <= 0 && o->output)
        return spin_misuse("'%s' is continuous in time, from %g to %g, and does not store its "
                           "number of frames: choose the frames with --frames, --times or --data",
                           o->input, t->time_first, t->time_last);
    if (*n <= 0) /* a description samples only the two ends of the time range */
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
    if (rows && (o->frame_times || !is_static(t)))
        spin_frame_times(o->frame_times, im->views.numbered, &im->sequence, all, *n);
    if (!is_static(t))
        warn_outside(t, all, *n);
    im->meta.numbered = rows && im->views.numbered;
    return SPIN_OK;
}

/* Lists the frames of a run that stores frames. */
static spin_status stored_frames(struct import *im, struct spin_frame_info **out, int *n)
{
    const struct spin_import_options *o = im->o;
    const struct spin_sequence_info *t = &im->sequence;
    char frames[48];

    if (o->frame_times && strcmp(o->frame_times, "auto") != 0)
        return spin_misuse(
            "'%s' stores %s: --frame-times is only for methods that are continuous in time",
            o->input, spin_text_count(t->n_frames, "separate frame", frames));
    if (o->n_frames > 0 || o->n_times > 0)
        return spin_misuse("'%s' stores %s: --frames and --times are only for methods that are "
                           "continuous in time; use --range",
                           o->input, spin_text_count(t->n_frames, "separate frame", frames));
    *n = t->n_frames;
    SPIN_TRY(spin_alloc((size_t)*n, sizeof **out, (void **)out));
    for (int i = 0; i < *n; i++) {
        (*out)[i].number = t->numbers ? t->numbers[i] : i;
        (*out)[i].time = t->times ? t->times[i] : i;
    }
    im->meta.numbered = t->numbers != NULL;
    return SPIN_OK;
}

/* Lists all frames and keeps those in the range of --range. */
static spin_status choose_frames(struct import *im)
{
    SPIN_FREED struct spin_frame_info *all = NULL;
    int n_all = 0, n = 0;
    SPIN_FREED int *place = NULL;

    SPIN_TRY(im->sequence.continuous ? sample_times(im, &all, &n_all)
                                     : stored_frames(im, &all, &n_all));
    im->meta.n_source_frames = n_all;
    SPIN_TRY(spin_alloc((size_t)n_all, sizeof *place, (void **)&place));
    for (int i = 0; i < n_all; i++)
        place[i] = i;
    if (!im->sequence.continuous)
        SPIN_TRY(spin_exported_frames(im->input, all, n_all, place, &im->meta));
    SPIN_TRY(spin_range_select(&im->o->range, all, n_all, &im->index, &n));
    SPIN_TRY(spin_bundle_meta_reserve(&im->meta, n));
    for (int i = 0; i < n; i++) {
        im->meta.frame[i] = all[im->index[i]];
        im->meta.source_index[i] = place[im->index[i]];
    }
    return SPIN_OK;
}

/* Checks that the frames have different times, which a bundle requires. A description may have two
 * frames at the same time: the two ends of the time range of a static scene. */
static spin_status check_times(const struct import *im)
{
    spin_status status = SPIN_OK;

    SPIN_TRY(spin_frame_numbers_check(im->meta.frame, im->meta.n_frames));
    if (im->o->output)
        status = spin_times_check(im->meta.frame, NULL, im->meta.n_frames);
    return status != SPIN_OK && im->o->n_times > 0 ? spin_fail_context(SPIN_E_USAGE, "--times")
                                                   : status;
}

/* ---- Points over images ---------------------------------------------------------------------- */

/* Returns the kth of `most` indices that are evenly spaced from 0 to n - 1 inclusive. */
static int spread_index(int k, int most, int n)
{
    return most > 1 ? (int)((int64_t)k * (n - 1) / (most - 1)) : 0;
}

/* Draws the points of a frame over one view and adds the camera to the report. */
static spin_status check_view(struct import *im, int frame, size_t view)
{
    const struct spin_view *v = &im->views.view[view];
    int number = im->meta.frame[frame].number;
    struct spin_camera_overlay_share share = {0};
    char file[128];
    SPIN_FREED char *path = NULL;

    spin_image_name(&im->views, view, number, NULL, file);
    SPIN_TRY(spin_path_join(im->o->check_cameras, file, &path));
    if (!im->o->force && spin_path_is_taken(path))
        return spin_fail(SPIN_E_IO, "'%s' exists; use --force to overwrite", path);
    SPIN_TRY(spin_camera_overlay_draw(v, &im->splats, path, &share));
    spin_json_push(spin_json_get(im->report, "cameras"),
                   json_pack("{s:i, s:i, s:f, s:f, s:o}", "frame", number, "camera", v->camera_id,
                             "in_front", share.in_front, "inside", share.inside, "file",
                             spin_json_text_value(file)));
    return SPIN_OK;
}

/* Returns the number that the report states under `key` for the ith camera that was drawn. */
static double camera_value(const spin_json *cameras, size_t i, const char *key)
{
    return json_number_value(spin_json_get(spin_json_at(cameras, i), key));
}

/* Warns if few points project into the images, since the axes or the data set are then probably
 * wrong. */
static void warn_few_points(const spin_json *cameras)
{
    size_t n = spin_json_length(cameras);
    double in_front = 0, inside = 0;

    for (size_t i = 0; i < n; i++) {
        in_front += camera_value(cameras, i, "in_front") / (double)n;
        inside += camera_value(cameras, i, "inside") / (double)n;
    }
    if (in_front < 0.5)
        spin_warn("only %.0f %% of the points are in front of the cameras: check the axes, and "
                  "that --data is the data set of this run",
                  100 * in_front);
    else if (inside < 0.1)
        spin_warn("only %.0f %% of the points are inside the images: check the axes, and that "
                  "--data is the data set of this run",
                  100 * inside);
}

static spin_status read_points(struct import *im, int frame)
{
    unsigned columns = im->sequence.columns & (SPIN_COL_MEANS | SPIN_COL_SH | SPIN_COL_RGB);

    return source_frame(im, frame, columns, &im->splats);
}

static bool is_drawn(const spin_json *cameras, int number, int camera)
{
    for (size_t i = 0; i < spin_json_length(cameras); i++)
        if (camera_value(cameras, i, "frame") == number &&
            camera_value(cameras, i, "camera") == camera)
            return true;
    return false;
}

/* Adds every camera to the report, warns of outliers and draws a view of each of the first few
 * outliers. */
static spin_status report_shares(struct import *im, const struct spin_camera_shares *shares)
{
    spin_json *list = spin_json_array();
    int n_apart = 0;

    spin_json_set(im->report, "shares",
                  json_pack("{s:f, s:f, s:o}", "in_front", shares->in_front, "inside",
                            shares->inside, "cameras", list));
    for (size_t k = 0; k < shares->n; k++) {
        const struct spin_camera_share *c = &shares->camera[k];
        const struct spin_view *v = &im->views.view[c->view];
        int frame = 0, number;

        while (im->rows[frame] != v->dataset_frame)
            frame++;
        number = im->meta.frame[frame].number;
        spin_json_push(list, json_pack("{s:i, s:i, s:f, s:f, s:b}", "camera", v->camera_id, "frame",
                                       number, "least_in_front", c->in_front, "least_inside",
                                       c->inside, "apart", c->apart));
        if (!c->apart)
            continue;
        spin_warn("camera %d has %.0f %% of the points in front and %.0f %% inside its image in "
                  "frame %d, but the median of all views is %.0f %% and %.0f %%: check the pose of "
                  "this camera",
                  v->camera_id, 100 * c->in_front, 100 * c->inside, number, 100 * shares->in_front,
                  100 * shares->inside);
        if (n_apart++ >= CHECKED_APART ||
            is_drawn(spin_json_get(im->report, "cameras"), number, v->camera_id))
            continue;
        SPIN_TRY(read_points(im, frame));
        SPIN_TRY(check_view(im, frame, c->view));
    }
    return SPIN_OK;
}

/* Adds the conclusion of the check to the report. The limits are those of warn_few_points(). */
static void report_verdict(struct import *im, const struct spin_camera_shares *s)
{
    size_t n_apart = 0;
    char text[200], share[96];

    for (size_t k = 0; k < s->n; k++)
        n_apart += s->camera[k].apart;
    if (s->in_front < 0.5 || s->inside < 0.1)
        snprintf(text, sizeof text,
                 "cameras do not fit: %.0f %% of the splats are in front of the median camera, and "
                 "%.0f %% inside its image",
                 100 * s->in_front, 100 * s->inside);
    else if (n_apart > 0)
        snprintf(text, sizeof text, "%s not fit: the others see %.0f %% of the splats",
                 spin_text_share(n_apart, s->n, "camera", "does", "do", share), 100 * s->seen);
    else
        snprintf(text, sizeof text, "cameras fit: %.0f %% of the splats are seen", 100 * s->seen);
    spin_json_set_string(im->report, "verdict", text);
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
    spin_json_set_string(im->report, "folder", o->check_cameras);
    spin_json_set(im->report, "cameras", spin_json_array());
    for (int k = 0; k < n; k++) {
        int frame = spread_index(k, n, im->meta.n_frames);
        size_t view[CHECKED_VIEWS];
        size_t n_views =
            spin_camera_overlay_choose(&im->views, im->rows[frame], CHECKED_VIEWS, view);

        SPIN_TRY(read_points(im, frame));
        for (size_t i = 0; i < n_views; i++)
            SPIN_TRY(check_view(im, frame, view[i]));
    }
    warn_few_points(spin_json_get(im->report, "cameras"));
    status = spin_camera_shares(&im->views, im->rows, im->meta.n_frames, &im->splats, &shares);
    if (status == SPIN_OK) {
        report_verdict(im, &shares);
        status = report_shares(im, &shares);
    }
    free(shares.camera);
    return status;
}

/* ---- Reading --------------------------------------------------------------------------------- */

static void widen_bounds(struct import *im, const struct spin_splats *s)
{
    for (size_t i = 0; i < s->n; i++) {
        for (size_t c = 0; c < 3; c++) {
            float value = s->means[3 * i + c];

            im->low[c] = value < im->low[c] ? value : im->low[c];
            im->high[c] = value > im->high[c] ? value : im->high[c];
        }
    }
}

/* Checks that the importer's frame() has set all requested columns and that each has the capacity
 * for n rows. An importer may be a plug-in that violates the interface. */
static spin_status check_frame(const struct import *im, int i, unsigned wanted,
                               const struct spin_splats *s)
{
    struct spin_splats splats = *s;

    for (unsigned column = 1; column < SPIN_COLUMNS_END; column <<= 1) {
        if ((wanted & column) && (!*spin_column_of(&splats, column) || s->n > s->capacity))
            return spin_unsupported("the importer '%s' provides no %s in frame %d",
                                    im->importer->name, spin_column_name(column), i);
    }
    if ((wanted & SPIN_COL_SH) && s->sh_degree != im->sequence.sh_degree)
        return spin_unsupported(
            "the importer '%s' provides SH of degree %d in frame %d, but declared degree %d",
            im->importer->name, s->sh_degree, i, im->sequence.sh_degree);
    return SPIN_OK;
}

/* Fails if a scale overflows a float. Files store its logarithm, which need not overflow. */
static spin_status check_scales(const struct import *im, int i, const struct spin_splats *s)
{
    size_t n = 0, first = 0;

    for (size_t k = 3 * s->n; k-- > 0;)
        if (isfinite(s->log_scales[k]) && s->log_scales[k] > SPIN_LOG_SCALE_MOST) {
            n++;
            first = k;
        }
    if (n == 0)
        return SPIN_OK;
    return spin_malformed("cannot read '%s': frame %d: the scale of row %zu, exp(%g), overflows "
                          "a float (number of such scales: %zu): remove these splats from the file",
                          im->input, im->meta.frame[i].number, first / 3,
                          (double)s->log_scales[first], n);
}

/* Reads `columns` of frame i from the importer, on rank `rank`, which sends them to rank 0. If
 * `columns` is empty, all columns are static and frame i has the splats of frame 0. */
static spin_status read_frame(struct import *im, int i, int rank, unsigned columns,
                              struct spin_splats *out)
{
    struct spin_bundle_meta *meta = &im->meta;

    if (!columns) {
        meta->frame[i].n = meta->frame[0].n;
        return SPIN_OK;
    }
    if (rank == spin_rank()) {
        SPIN_TRY(source_frame(im, i, columns, out));
        SPIN_TRY(check_frame(im, i, columns, out));
        if (columns & SPIN_COL_LOG_SCALES)
            SPIN_TRY(check_scales(im, i, out));
    }
    SPIN_TRY(spin_share_splats(out, columns, rank));
    meta->frame[i].n = out->n;
    if (im->writing && meta->static_columns && out->n != meta->frame[0].n)
        return spin_malformed("the importer '%s' provides %zu splats in frame %d but %zu in frame "
                              "0, although it declares static columns",
                              im->importer->name, out->n, i, meta->frame[0].n);
    if (columns & SPIN_COL_MEANS)
        widen_bounds(im, out);
    return SPIN_OK;
}

/* Task 0 reads frame im->step, task 1 writes the frame before it. Static columns are read and
 * written with the first frame only. */
static void store_task(void *context, int task)
{
    struct import *im = context;
    const struct spin_bundle_meta *meta = &im->meta;
    int i = im->step - task, rank = i % spin_n_ranks();
    spin_status status = SPIN_OK;

    if (i < 0 || i == meta->n_frames)
        return;
    if (task == 1 && im->writing)
        status = spin_bundle_write_frame(&im->writer, i, meta->columns, meta->static_columns,
                                         &im->slot[i % 2]);
    else if (task == 0 && (spin_rank() == 0 || spin_rank() == rank))
        status = read_frame(im, i, rank, meta->columns & ~(i > 0 ? meta->static_columns : 0),
                            &im->slot[i % 2]);
    im->done[task].status = status;
    if (status != SPIN_OK)
        snprintf(im->done[task].why, sizeof im->done[task].why, "%s", spin_last_error());
}

static spin_status store_steps(struct import *im, struct spin_progress *progress)
{
    int n = im->meta.n_frames;

    for (im->step = 0; im->step <= n; im->step++) {
        if (im->step < n && spin_cancelled())
            return spin_fail_cancelled();
        spin_pool_run(im->pool, 2, store_task, im);
        for (int task = 0; task < 2; task++)
            if (im->done[task].status != SPIN_OK)
                return spin_fail(im->done[task].status, "%s", im->done[task].why);
        if (im->step < n)
            spin_progress_set(progress, im->step + 1, "%zu splats", im->meta.frame[im->step].n);
    }
    return SPIN_OK;
}

static spin_status store_frames(struct import *im, struct spin_progress *progress)
{
    spin_status status;

    if (spin_n_ranks() == 1) /* MPI may only be called from the thread that initialised it */
        SPIN_TRY(spin_pool_create(2, &im->pool));
    status = store_steps(im, progress);
    spin_pool_free(im->pool);
    return status;
}

/* Stores the 4D splats rounded to --precision, and sets *s to the rounded copy, from which the
 * caller counts the splats per frame. */
static spin_status store_rounded(struct import *im, struct spin_splats_4d *s)
{
    enum spin_round_4d round = (enum spin_round_4d)im->o->precision;
    SPIN_FREED unsigned char *all = NULL;
    size_t n_dropped;

    SPIN_TRY(spin_alloc(im->four_d->n + 1, 1, (void **)&all));
    memset(all, 1, im->four_d->n);
    SPIN_TRY(spin_splats_4d_select(im->four_d, all, s));
    spin_splats_4d_round(s, round);
    if (im->writing)
        SPIN_TRY(spin_bundle_write_4d(&im->writer, s, round, &im->meta));
    return spin_splats_4d_finish(s, &n_dropped, NULL);
}

/* Stores the 4D splats instead of frames, and counts the splats of each frame, which is a slice of
 * the 4D splats. */
static spin_status store_4d(struct import *im)
{
    struct spin_bundle_meta *meta = &im->meta;
    const struct spin_splats_4d *s = im->four_d;
    SPIN_LEAVES(spin_splats_4d_free) struct spin_splats_4d rounded = {0};
    size_t n = (size_t)meta->n_frames;
    SPIN_FREED size_t *counts = NULL;
    SPIN_FREED double *times = NULL;

    if (im->o->precision) {
        SPIN_TRY(store_rounded(im, &rounded));
        s = &rounded;
    } else if (im->writing) {
        SPIN_TRY(spin_bundle_write_4d(&im->writer, s, SPIN_ROUND_NOTHING, meta));
    }
    SPIN_TRY(spin_alloc(n, sizeof *times, (void **)&times));
    SPIN_TRY(spin_alloc(n, sizeof *counts, (void **)&counts));
    for (size_t i = 0; i < n; i++)
        times[i] = meta->frame[i].time;
    SPIN_TRY(spin_splats_4d_counts(s, times, n, counts));
    for (size_t i = 0; i < n; i++)
        meta->frame[i].n = counts[i];
    /* The bounding box contains the position of each splat at the centre of its Gaussian window. */
    for (size_t i = 0; i < s->n; i++)
        for (size_t c = 0; c < 3; c++) {
            im->low[c] = fminf(im->low[c], s->centres[3 * i + c]);
            im->high[c] = fmaxf(im->high[c], s->centres[3 * i + c]);
        }
    return SPIN_OK;
}

/* Reports minimum, maximum and mean of the number of splats per frame: over all frames if the
 * importer has counted the splats of each, otherwise over the frames that were read. */
static void count_splats(struct import *im, const int *read, int n_read)
{
    const struct spin_sequence_info *t = &im->sequence;
    size_t least = SIZE_MAX, most = 0;
    double sum = 0;
    /* The counts of the importer do not apply to a bundle: splats with non-finite values were
     * dropped, and the rounding of 4D splats may drop more. */
    bool known = t->counts && !im->stores && (!t->continuous || t->n_frames == 1);
    int n = known ? im->meta.n_frames : n_read;

    for (int k = 0; k < n; k++) {
        int i = known ? k : read[k];
        size_t count = !known          ? im->meta.frame[i].n
                       : t->continuous ? t->counts[0]
                                       : t->counts[im->index[i]];

        least = count < least ? count : least;
        most = count > most ? count : most;
        sum += (double)count;
    }
    spin_json_set(im->report, "splats",
                  json_pack("{s:I, s:f, s:I}", "min", (json_int_t)least, "mean", sum / n, "max",
                            (json_int_t)most));
}

/* An import reads every frame. A description reads some frames only, since a clip may have many
 * gigabytes. */
static spin_status read_frames(struct import *im)
{
    int n_all = im->meta.n_frames, n = n_all;
    SPIN_FREED int *read = NULL;
    struct spin_progress progress;
    spin_status status = SPIN_OK;

    if (!im->stores && !im->o->full && n > DESCRIBED_FRAMES)
        n = DESCRIBED_FRAMES;
    for (int c = 0; c < 3; c++) {
        im->low[c] = FLT_MAX;
        im->high[c] = -FLT_MAX;
    }
    SPIN_TRY(spin_alloc((size_t)n, sizeof *read, (void **)&read));
    spin_progress_begin(&progress, im->stores ? "importing" : "reading", "frames", 0, n);
    for (int k = 0; k < n; k++)
        read[k] = n < n_all ? spread_index(k, n, n_all) : k;
    if (im->keeps_4d && im->stores)
        SPIN_TRY_OUT(store_4d(im));
    else if (im->stores)
        SPIN_TRY_OUT(store_frames(im, &progress));
    else
        SPIN_TRY_OUT(spin_column_stats_open(&im->describe, n));
    for (int k = 0; k < n && !im->stores; k++) {
        if (spin_cancelled())
            SPIN_TRY_OUT(spin_fail_cancelled());
        SPIN_TRY_OUT(read_frame(im, read[k], spin_rank(), im->sequence.columns, &im->splats));
        spin_column_stats_frame(&im->describe, im->sequence.columns, &im->splats);
        spin_progress_set(&progress, k + 1, "%zu splats", im->meta.frame[read[k]].n);
    }
    spin_json_set_integer(im->report, "frames_read", n);
    count_splats(im, read, n);
    if (!im->stores)
        spin_column_stats_ranges(&im->describe, im->report);
out:
    spin_progress_end(&progress);
    return status;
}

/* ---- From start to end ----------------------------------------------------------------------- */

/* Reports how the importer was chosen. */
static void report_recognition(struct import *im)
{
    char text[160] = "";
    struct spin_peek peek;

    if (im->o->from) {
        snprintf(text, sizeof text, "named by --from");
    } else if (im->importer->probe && spin_peek_open(im->input, &peek) == SPIN_OK) {
        snprintf(text, sizeof text, "by %s, with a confidence of %d %%",
                 peek.is_folder     ? "the names in the folder and the first bytes of its files"
                 : *peek.tail_names ? "the names in the archive"
                                    : "its first bytes",
                 im->importer->probe(&peek));
        spin_peek_free(&peek);
    }
    spin_json_set_string(im->report, "recognised", text);
}

/* Returns a JSON list of the importer's notes, and of a hint if there is a data set beside the
 * run. */
static spin_json *notes_json(struct import *im)
{
    char hint[600] = "", *text[] = {im->sequence.notes, hint};
    spin_json *notes = spin_json_array();

    if (!im->data)
        spin_data_hint(own_place(im), hint, sizeof hint);
    for (int i = 0; i < 2; i++)
        for (char *line; (line = strsep(&text[i], "\n"));) {
            if (*line)
                spin_json_push_string(notes, line);
        }
    return notes;
}

static void fill_report(struct import *im)
{
    spin_json *report = im->report;
    const struct spin_bundle_meta *meta = &im->meta;
    const struct spin_frame_info *first = meta->frame, *last = first + meta->n_frames - 1;
    struct spin_sequence_info *t = &im->sequence;
    double low[3], high[3];

    for (int c = 0; c < 3; c++) {
        low[c] = (double)im->low[c] + t->shift[c];
        high[c] = (double)im->high[c] + t->shift[c];
    }
    spin_json_set_string(report, "variant", t->variant);
    spin_json_set_string(report, "upstream", im->importer->upstream ? im->importer->upstream : "");
    report_recognition(im);
    spin_json_set_integer(report, "frames", meta->n_frames);
    spin_json_set(report, "times", spin_json_numbers((double[]){first->time, last->time}, 2));
    spin_json_set_bool(report, "continuous", t->continuous);
    if (t->continuous)
        spin_json_set(report, "time_range",
                      spin_json_numbers((double[]){t->time_first, t->time_last}, 2));
    spin_json_set_bool(report, "numbered", meta->numbered);
    spin_json_set(report, "numbers", json_pack("[i, i]", first->number, last->number));
    spin_json_set(report, "sh_degree",
                  t->columns & SPIN_COL_SH ? json_integer(t->sh_degree) : json_null());
    spin_json_set(report, "attributes", spin_column_names(t->columns));
    spin_json_set(report, "static", spin_column_names(t->static_columns));
    spin_json_set(report, "splats_4d",
                  im->keeps_4d ? spin_bundle_4d_json(im->four_d, spin_splats_4d_parts(im->four_d))
                               : json_null());
    spin_json_set(report, "bounds",
                  json_pack("{s:o, s:o}", "min", spin_json_numbers(low, 3), "max",
                            spin_json_numbers(high, 3)));
    spin_json_set(report, "sound", spin_sound_json(&meta->sound));
    spin_json_set(report, "notes", notes_json(im));
    if (im->o->output)
        spin_json_set_string(report, "output", im->o->output);
}

static spin_status check_frame_times(const struct spin_import_options *o)
{
    static const char *const rules[] = {"auto", "data", "unit", "count"};

    if (!o->frame_times)
        return SPIN_OK;
    if (!o->data || o->n_frames > 0 || o->n_times > 0)
        return spin_misuse("--frame-times sets the times of a data set's frames: it requires "
                           "--data, and excludes --frames and --times");
    for (size_t i = 0; i < sizeof rules / sizeof *rules; i++) {
        if (strcmp(o->frame_times, rules[i]) == 0)
            return SPIN_OK;
    }
    return spin_misuse("--frame-times is '%s', expected auto, data, unit or count", o->frame_times);
}

/* Checks what the importer's open() has returned, since an importer may be a plug-in that violates
 * the interface. */
static spin_status check_sequence(const struct import *im)
{
    const struct spin_sequence_info *t = &im->sequence;
    const char *name = im->importer->name;

    if (!t->continuous && t->n_frames < 1)
        return spin_malformed("the importer '%s' found no frames", name);
    if (!(t->columns & SPIN_COL_MEANS))
        return spin_unsupported("the importer '%s' provides no positions", name);
    if ((t->columns & SPIN_COL_SH) && (t->sh_degree < 0 || t->sh_degree > 3))
        return spin_unsupported("the importer '%s' provides SH of degree %d, not 0..3", name,
                                t->sh_degree);
    return SPIN_OK;
}

/* Gets the 4D splats of the source, if any, and decides whether the bundle stores them. The bundle
 * stores them unless the user requests positions only, or frames with --frames or --times. */
static spin_status find_4d(struct import *im)
{
    const struct spin_import_options *o = im->o;
    bool sampled = o->n_frames > 0 || o->n_times > 0;

    if (im->importer->splats_4d)
        SPIN_TRY(im->importer->splats_4d(im->self, &im->four_d));
    if (im->four_d && !spin_splats_4d_is_finished(im->four_d))
        return spin_malformed("the importer '%s' provides 4D splats without calling "
                              "spin_splats_4d_finish()",
                              im->importer->name);
    im->keeps_4d = im->four_d && im->sequence.continuous && !sampled && !o->positions_only &&
                   (im->sequence.columns & SPIN_COL_ATTRIBUTES) == SPIN_COL_ATTRIBUTES;
    if (o->precision && !(im->keeps_4d && o->output))
        return spin_misuse("--precision requires a source of 4D splats, imported without --frames, "
                           "--times or --positions-only");
    if (im->four_d && sampled && o->output)
        spin_note(&im->sequence,
                  "--frames and --times sample the 4D splats: the bundle stores the sampled frames "
                  "instead of the 4D splats");
    if (sampled && im->sequence.sound && o->n_frames != im->sequence.n_clip_frames)
        spin_note(&im->sequence, "--frames and --times change the speed of the clip, but not "
                                 "that of its sound");
    return SPIN_OK;
}

/* Sets *out to the path of a file below `folder` that matches the pattern `rest`, such as
 * "frame_%d/a.ply". The caller frees *out. */
static spin_status find_match(const char *folder, const char *rest, char **out)
{
    size_t n = strcspn(rest, "/"), n_names = 0;
    SPIN_FREED char *component = NULL, *match = NULL;
    SPIN_LEAVES(spin_numbers_free) struct spin_numbers numbers = {0};
    char **names = NULL;
    spin_status status;

    *out = NULL;
    SPIN_TRY(spin_strdup(rest, &component));
    component[n] = '\0';
    SPIN_TRY(spin_folder_list(folder, &names, &n_names));
    status = spin_numbered_read(&(struct spin_numbering){.name = (const char *const *)names,
                                                         .n = n_names,
                                                         .pattern = component},
                                &numbers);
    if (status == SPIN_OK && numbers.n_frames == 0)
        status = spin_not_found("folder '%s' is empty", folder);
    if (status == SPIN_OK)
        status = spin_path_join(folder, names[numbers.order[0]], &match);
    if (status == SPIN_OK)
        status = rest[n] ? spin_path_join(match, rest + n + 1, out) : spin_strdup(match, out);
    spin_folder_list_free(names);
    return status;
}

/* Finds the importer of a run that is given as a pattern of paths, such as "run/frame_%d.ply": it
 * is the importer that accepts the first matching file. The importer gets the folder as its path,
 * and the rest of the pattern as an option. */
static spin_status find_pattern_run(struct import *im, const char *pattern)
{
    const struct spin_import_options *o = im->o;
    SPIN_FREED char *match = NULL;
    size_t n = 0;

    SPIN_TRY(find_match(im->below, pattern, &match));
    SPIN_TRY(spin_importer_find(match, o->from, false, &im->importer));
    while (o->plugin_pairs && o->plugin_pairs[n])
        n++;
    SPIN_TRY(spin_alloc(n + 3, sizeof *im->pairs, (void **)&im->pairs));
    if (n > 0)
        memcpy(im->pairs, o->plugin_pairs, n * sizeof *im->pairs);
    im->pairs[n] = "pattern";
    im->pairs[n + 1] = pattern;
    return SPIN_OK;
}

/* Returns whether o->input is an archive to unpack. The files of some runs are themselves zip or
 * gzip, so an archive is unpacked only if no importer recognises it or, if the user named an
 * importer, if that importer does not. A plug-in that the user named gets the archive itself. */
static bool is_packed(const struct import *im, spin_status found)
{
    const struct spin_import_options *o = im->o;
    SPIN_LEAVES(spin_peek_free) struct spin_peek peek = {0};

    if (found != (o->from ? SPIN_OK : SPIN_E_NOT_RECOGNISED) || !spin_archive_detect(o->input) ||
        spin_bundle_detect(o->input))
        return false;
    return !o->from ||
           (!spin_plugin_origin(im->importer) && im->importer->probe &&
            spin_peek_open(o->input, &peek) == SPIN_OK && im->importer->probe(&peek) == 0);
}

static spin_status find_packed_run(struct import *im)
{
    spin_status status;

    SPIN_TRY(spin_archive_unpack(im->o->input, &im->unpacked));
    status = spin_importer_find_run(im->unpacked.path, im->o->from, &im->importer, &im->below);
    if (status == SPIN_E_NOT_RECOGNISED && spin_importer_guess(im->unpacked.path, true))
        return spin_fail(status,
                         "'%s' contains a data set, not a run: unpack it, and give its "
                         "folder with --data",
                         im->o->input);
    SPIN_TRY(status);
    if (!im->below)
        SPIN_TRY(spin_strdup(im->unpacked.path, &im->below));
    return SPIN_OK;
}

/* Returns whether the run that was found consists of the initial points of a data set. */
static bool is_points(const struct import *im)
{
    const char *input = im->o->input;

    return !im->o->from && !im->unpacked.folder && strcmp(im->importer->name, "ply") == 0 &&
           spin_path_is_folder(input) && spin_run_is_points(input, im->below ? im->below : input);
}

static spin_status find_run(struct import *im)
{
    const struct spin_import_options *o = im->o;
    const char *pattern;

    SPIN_TRY(spin_pattern_split(o->input, &im->below, &pattern));
    if (pattern) {
        SPIN_TRY(find_pattern_run(im, pattern));
    } else {
        spin_status status = spin_importer_find_run(o->input, o->from, &im->importer, &im->below);

        if (is_packed(im, status))
            status = find_packed_run(im);
        if (status == SPIN_OK && is_points(im))
            status = spin_fail(SPIN_E_NOT_RECOGNISED, "'%s' is a data set", o->input);
        if (status == SPIN_E_NOT_RECOGNISED && !o->from && spin_path_is_folder(o->input))
            return spin_explain_data_set(o->input, status);
        SPIN_TRY(status);
    }
    im->input = im->below ? im->below : o->input;
    im->values.pairs = im->pairs ? im->pairs : o->plugin_pairs;
    return spin_plugin_check(im->importer->name, im->importer->options, im->values.pairs);
}

static spin_status run_import(struct import *im)
{
    const struct spin_import_options *o = im->o;
    struct spin_bundle_meta *meta = &im->meta;

    SPIN_TRY(check_frame_times(o));
    if (o->check_cameras && !o->data)
        return spin_misuse("--check-cameras needs images: give a data set with --data");
    if (o->output)
        SPIN_TRY(spin_bundle_check_name(o->output));
    SPIN_TRY(spin_inputs_add_path(o->input));
    SPIN_TRY(spin_output_check_distinct((const char *[]){o->output, o->check_cameras}, 2));
    if (o->output && spin_rank() == 0)
        SPIN_TRY(spin_output_check_file(o->output, o->force));
    SPIN_TRY(find_run(im));
    spin_json_set_string(im->report, "from", im->importer->name);
    SPIN_TRY(im->importer->open(im->input, &im->values, &im->self, &im->sequence));
    SPIN_TRY(check_sequence(im));
    SPIN_TRY(find_4d(im));
    if (im->below && !im->pairs)
        spin_note(&im->sequence, "the run was found in '%s'", im->below);
    SPIN_TRY(open_data(im));
    choose_default_frames(im);
    note_focal(im);
    SPIN_TRY(choose_frames(im));
    SPIN_TRY(check_times(im));
    SPIN_TRY(attach_data(im));
    SPIN_TRY(keep_cameras(im));
    SPIN_TRY(check_cameras(im));
    memcpy(meta->shift, im->sequence.shift, sizeof meta->shift);
    if (!im->is_placed)
        memcpy(meta->up, im->sequence.up, sizeof meta->up);
    if (im->sequence.fps > 0)
        meta->fps = im->sequence.fps;
    if (im->sequence.sound)
        meta->sound = *im->sequence.sound;
    snprintf(meta->from, sizeof meta->from, "%s", im->importer->name);
    snprintf(meta->upstream, sizeof meta->upstream, "%s",
             im->importer->upstream ? im->importer->upstream : "");
    memcpy(meta->variant, im->sequence.variant, sizeof meta->variant);
    meta->columns = im->sequence.columns;
    if (o->positions_only)
        meta->columns &= SPIN_COL_MEANS | SPIN_COL_RGB;
    meta->static_columns = im->sequence.static_columns & meta->columns;
    meta->identity |= im->sequence.identity;
    meta->sh_degree = meta->columns & SPIN_COL_SH ? im->sequence.sh_degree : -1;
    meta->antialias = im->sequence.antialias && meta->columns & SPIN_COL_ATTRIBUTES;
    im->stores = o->output != NULL;
    if (o->output && spin_rank() == 0) {
        SPIN_TRY(spin_bundle_writer_open(o->output, o->force, o->sync, &im->writer));
        im->writer.packs = im->writer.packer.quick = im->keeps_4d;
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

spin_status spin_import(const struct spin_import_options *o, char **report)
{
    SPIN_LEAVES(spin_inputs_end) int inputs = spin_inputs_begin();
    struct import im = {.o = o, .report = spin_json_object()};
    spin_status status = run_import(&im);

    (void)inputs;
    if (im.writing)
        spin_bundle_writer_abandon(&im.writer);
    if (im.importer && im.importer->close && im.self)
        im.importer->close(im.self);
    spin_bundle_meta_free(&im.meta);
    spin_splats_free(&im.slot[0]);
    spin_splats_free(&im.slot[1]);
    spin_splats_free(&im.splats);
    spin_splats_free(&im.unplaced);
    spin_splats_4d_free(&im.placed_4d);
    spin_views_free(&im.views);
    spin_column_stats_close(&im.describe);
    free(im.rows);
    free(im.index);
    free(im.data);
    free(im.below);
    free(im.pairs);
    status = spin_fail_context(status, "cannot import '%s'", o->input);
    spin_unpacked_remove(&im.unpacked);
    if (report)
        *report = NULL;
    if (status == SPIN_OK && report)
        return spin_json_finish(im.report, report);
    spin_json_free(im.report);
    return status;
}
