/* Opens a bundle together with its data set. */
#include "scene/clip.h"

#include "base/base.h"
#include "geometry/camera_rig.h"
#include "io/ranks.h"
#include "scene/kept_cameras.h"
#include "scene/probe.h"
#include "scene/renders.h"

spin_status spin_range_select(const struct spin_range *range, const struct spin_frame_info *info,
                              int n, int **index, int *n_index)
{
    int *list, count = 0;

    SPIN_TRY(spin_alloc((size_t)n + 1, sizeof(int), (void **)&list));
    for (int i = 0; i < n; i++) {
        int number = info[i].number, step = range->step > 0 ? range->step : 1;

        if (!range->given ||
            (number >= range->first && number < range->last && (number - range->first) % step == 0))
            list[count++] = i;
    }
    if (count == 0) {
        free(list);
        return spin_not_found("no frame has a number in %d:%d (frames of the clip: %d to %d)",
                              range->first, range->last, n ? info[0].number : 0,
                              n ? info[n - 1].number : 0);
    }
    *index = list;
    *n_index = count;
    return SPIN_OK;
}

static int by_time(const void *a, const void *b)
{
    const struct spin_frame_info *x = a, *y = b;

    if (x->time != y->time)
        return x->time < y->time ? -1 : 1;
    return (x->number > y->number) - (x->number < y->number);
}

spin_status spin_times_check(const struct spin_frame_info *info, const int *index, int n)
{
    SPIN_FREED struct spin_frame_info *sorted = NULL;

    SPIN_TRY(spin_alloc((size_t)n, sizeof *sorted, (void **)&sorted));
    for (int i = 0; i < n; i++) {
        sorted[i] = info[index ? index[i] : i];
        if (!isfinite(sorted[i].time))
            return spin_malformed("the time of frame %d is not a finite number", sorted[i].number);
    }
    qsort(sorted, (size_t)n, sizeof *sorted, by_time);
    for (int i = 1; i < n; i++)
        if (sorted[i].time == sorted[i - 1].time)
            return spin_malformed(
                "frames %d and %d have the same time, %g; every frame needs a different time",
                sorted[i - 1].number, sorted[i].number, sorted[i].time);
    return SPIN_OK;
}

/* Holds out the cameras that the training held out. If one of these cameras is missing, the data
 * set is not that of the training; its own test split is used then, with a warning. */
static spin_status hold_out(struct spin_clip *clip)
{
    const spin_json *list = spin_json_get(clip->bundle.json, "held_out");
    size_t n = spin_json_length(list);
    SPIN_FREED int *camera = NULL;

    SPIN_TRY(spin_alloc(n + 1, sizeof *camera, (void **)&camera));
    for (size_t i = 0; i < n; i++) {
        int64_t id = -1;

        spin_json_integer(spin_json_at(list, i), &id);
        camera[i] = id > INT_MAX ? -1 : (int)id;
    }
    if (n > 0 && spin_views_split(&clip->views, camera, (int)n) != SPIN_OK)
        spin_warn("'%s' lacks cameras that the training held out: using the test views of the data "
                  "set instead",
                  clip->data_path);
    return SPIN_OK;
}

/* Counts the cameras of --test-cams that the training used. No camera is counted if the data set is
 * not that of the training, since its camera ids then refer to other cameras. */
static spin_status count_taught(const struct spin_clip_options *o, struct spin_clip *clip)
{
    SPIN_FREED char *own = NULL;

    SPIN_TRY(spin_bundle_data_path(&clip->bundle, &own));
    if (!o->as_trained || !own || strcmp(own, clip->data_path) != 0)
        return SPIN_OK;
    SPIN_TRY(hold_out(clip));
    for (int i = 0; i < o->n_test_cameras; i++) {
        bool taught = false;

        for (size_t v = 0; v < clip->views.n; v++)
            taught |=
                clip->views.view[v].camera_id == o->test_cameras[i] && !clip->views.view[v].test;
        clip->n_trained_test_cameras += taught;
    }
    return SPIN_OK;
}

/* Returns whether the images of the data set are rendered from the input itself. This is the case
 * with "--data renders" if no file has this name, and with "--data-from renders:..." without
 * --data. */
static bool draws_itself(const struct spin_clip_options *o)
{
    const char *name = spin_renders.name, *from = o->data_from;
    size_t n = strlen(name);

    if (o->data)
        return strcmp(o->data, name) == 0 && !spin_path_exists(o->data);
    return from && strncmp(from, name, n) == 0 && (!from[n] || from[n] == ':');
}

bool spin_clip_is_drawn(const struct spin_clip *clip)
{
    return strncmp(clip->data_from, spin_renders.name, strlen(spin_renders.name)) == 0;
}

static spin_status open_views(const struct spin_clip_options *o, struct spin_clip *clip)
{
    char *path = NULL;
    const char *from = o->data_from;
    spin_status status = SPIN_OK;

    if (draws_itself(o)) {
        SPIN_TRY(spin_path_absolute(o->input, &path));
        from = from ? from : spin_renders.name;
    } else if (o->data) {
        SPIN_TRY(spin_foreign_missing(o->data));
        SPIN_TRY(spin_path_absolute(o->data, &path));
    } else {
        SPIN_TRY(spin_bundle_data_path(&clip->bundle, &path));
        if (path && !from && clip->bundle.meta.data_from[0])
            from = clip->bundle.meta.data_from;
    }
    if (!path) {
        if (o->needs_views || o->data_from)
            return spin_misuse(
                "'%s' does not contain the path of its data set: give the folder with --data",
                o->input);
        return SPIN_OK;
    }
    clip->data_path = path;
    if (!spin_path_exists(path) && !o->needs_views && !o->data)
        return spin_not_found("the data set '%s' does not exist", path);
    SPIN_TRY(spin_views_open(path, from, &clip->views, clip->data_from, sizeof clip->data_from));
    if (!spin_clip_is_drawn(clip))
        spin_views_shift(&clip->views, clip->bundle.meta.shift);
    else if (o->data && spin_rank() == 0 && !o->quiet)
        spin_log(0, "%s", clip->views.notes);
    clip->has_views = true;
    if (o->n_test_cameras > 0)
        SPIN_TRY(count_taught(o, clip));
    if (o->n_test_cameras > 0)
        SPIN_TRY(spin_views_split(&clip->views, o->test_cameras, o->n_test_cameras));
    else if (o->as_trained)
        SPIN_TRY(hold_out(clip));
    if (o->n_outer > 0)
        SPIN_TRY(spin_outer_cameras_hold(&clip->views, o->n_outer));
    if (o->image_scale > 0 && o->image_scale != 1.0)
        SPIN_TRY(spin_views_scale(&clip->views, o->image_scale));
    if (o->needs_views || o->wants_views)
        SPIN_TRY(spin_views_check_cameras(&clip->views, o->needs_views));
    return status;
}

/* Sets *pair to the pairing to use: that of --pair, otherwise the one that the bundle records. The
 * recorded pairing applies only to the recorded data set; another data set may have other frame
 * numbers, so *pair is then "", which means "auto". */
static spin_status find_pairing(const struct spin_clip_options *o, const struct spin_clip *clip,
                                const char **pair)
{
    SPIN_FREED char *recorded = NULL;

    *pair = o->pair ? o->pair : clip->bundle.meta.pair;
    if (o->pair || !o->data)
        return SPIN_OK;
    SPIN_TRY(spin_bundle_data_path(&clip->bundle, &recorded));
    if (!recorded || strcmp(recorded, clip->data_path) != 0)
        *pair = "";
    return SPIN_OK;
}

static spin_status pair_rows(const struct spin_clip_options *o, struct spin_clip *clip)
{
    const struct spin_bundle_meta *meta = &clip->bundle.meta;
    SPIN_FREED int *row_of = NULL;
    const char *pair;
    spin_status status;

    SPIN_TRY(spin_alloc((size_t)clip->n_frames, sizeof(int), (void **)&clip->dataset_frame));
    for (int i = 0; i < clip->n_frames; i++)
        clip->dataset_frame[i] = -1;
    if (!clip->has_views)
        return SPIN_OK;
    SPIN_TRY(find_pairing(o, clip, &pair));
    SPIN_TRY(spin_alloc((size_t)meta->n_frames, sizeof *row_of, (void **)&row_of));
    status = spin_views_pair(&clip->views, meta, pair, row_of);
    for (int i = 0; status == SPIN_OK && i < clip->n_frames; i++)
        clip->dataset_frame[i] = row_of[clip->frame[i]];
    return status;
}

/* Opens a bundle. If the path exists but is not a bundle, the error message names the importer that
 * reads it, or states what kind of file it is. For a zip that no importer recognises, the message
 * is that of spin_bundle_open(). */
static spin_status open_bundle(const char *path, struct spin_bundle *out)
{
    const struct spin_importer *importer;
    unsigned char head[4];
    char why[4096], what[400];
    size_t n = 0;
    spin_status status = spin_bundle_open(path, out);

    if (status == SPIN_OK)
        return status;
    SPIN_TRY(spin_foreign_missing(path));
    if (!spin_path_exists(path))
        return status;
    snprintf(why, sizeof why, "%s", spin_last_error());
    if (spin_importer_find(path, NULL, false, &importer) == SPIN_OK)
        return spin_fail(SPIN_E_NOT_RECOGNISED,
                         "'%s' is not a bundle: convert it with spin-import (importer '%s') first",
                         path, importer->name);
    if (status != SPIN_E_UNSUPPORTED && !spin_bundle_detect(path) &&
        spin_foreign_input(path, false, what, sizeof what))
        return spin_fail(SPIN_E_NOT_RECOGNISED, "'%s' is not a bundle: %s", path, what);
    if (!spin_path_is_folder(path) && spin_file_head(path, head, sizeof head, &n) == SPIN_OK &&
        n > 0 && !spin_zip_detect(head, n))
        return spin_fail(SPIN_E_NOT_RECOGNISED, "'%s' is not a bundle", path);
    return spin_fail(status, "%s", why);
}

/* Uses the cameras that the bundle keeps, if there are any, as views. If none of them is a test
 * view, the first becomes one, since exporters use test views. */
static spin_status open_kept(struct spin_clip *clip)
{
    struct spin_view *view;
    size_t test = 0;

    SPIN_TRY(spin_kept_cameras_choose(&clip->bundle.meta.cameras, 0, &clip->views));
    view = clip->views.view;
    while (test < clip->views.n && !view[test].test)
        test++;
    clip->has_kept = clip->views.n > 0;
    if (clip->has_kept && test == clip->views.n)
        view[0].test = true;
    for (int i = 0; i < clip->n_frames && clip->has_kept; i++)
        clip->dataset_frame[i] = 0;
    return SPIN_OK;
}

/* Logs that the data set cannot be used, with the last error as the reason. This is a warning, or
 * only a log line if the data set no longer exists but the bundle keeps its cameras. */
static void log_kept(const struct spin_clip_options *o, const struct spin_clip *clip)
{
    bool keeps = clip->bundle.meta.cameras.n > 0;

    if (keeps && clip->data_path && !spin_path_exists(clip->data_path))
        spin_log(0, "'%s': %s: using the cameras that the bundle keeps", o->input,
                 spin_last_error());
    else
        spin_warn("'%s': %s: continuing %s; give the data set with --data", o->input,
                  spin_last_error(),
                  keeps ? "with the cameras that the bundle keeps" : "without its cameras");
}

/* Replaces the error of a data set that no longer exists by one that says what to do. The cameras
 * that the bundle keeps cannot replace images. */
static spin_status require_images(const struct spin_clip *clip, spin_status status)
{
    if (status == SPIN_E_MEMORY || !clip->data_path || spin_path_exists(clip->data_path))
        return status;
    return spin_fail(SPIN_E_NOT_FOUND,
                     "the data set '%s' does not exist, and its images are needed: give the data "
                     "set with --data",
                     clip->data_path);
}

/* Opens the data set and pairs its rows with the frames of the clip. A data set that cannot be
 * opened is an error if the caller needs it or the user named it. If only the bundle names it, a
 * message is printed. */
static spin_status open_data(const struct spin_clip_options *o, struct spin_clip *clip)
{
    bool named = o->data || o->data_from, opened = named || o->needs_views || o->wants_views;
    spin_status status = opened ? open_views(o, clip) : SPIN_OK;

    if (status == SPIN_OK)
        status = pair_rows(o, clip);
    if (status == SPIN_OK && opened && !clip->has_views)
        status = open_kept(clip);
    if (status == SPIN_OK || status == SPIN_E_MEMORY || named)
        return status;
    if (o->needs_views)
        return require_images(clip, status);
    if (!o->quiet)
        log_kept(o, clip);
    spin_views_free(&clip->views);
    clip->has_views = false;
    free(clip->dataset_frame);
    free(clip->data_path);
    clip->dataset_frame = NULL;
    clip->data_path = NULL;
    SPIN_TRY(pair_rows(o, clip));
    return open_kept(clip);
}

/* Sets the near plane of all cameras from the first frame of the bundle that has splats, even if
 * --range does not select this frame, since rendered images must not depend on --range. If the
 * frame cannot be read, the near plane stays unchanged, and the error is reported when the frame is
 * needed. */
static spin_status set_near(struct spin_clip *clip)
{
    const struct spin_bundle_meta *meta = &clip->bundle.meta;
    SPIN_LEAVES(spin_splats_free) struct spin_splats splats = {0};
    spin_status status;
    int f = 0;

    if (clip->views.view[0].camera.z_near > 0) /* set by the data set "renders" */
        return SPIN_OK;
    while (f < meta->n_frames && meta->frame[f].n == 0)
        f++;
    if (f == meta->n_frames)
        return SPIN_OK;
    status = spin_bundle_frame(&clip->bundle, f, SPIN_COL_MEANS, &splats);
    if (status != SPIN_OK)
        return status == SPIN_E_MEMORY ? status : SPIN_OK;
    return spin_views_set_near(&clip->views, splats.means, splats.n, spin_rank() == 0);
}

spin_status spin_clip_open(const struct spin_clip_options *o, struct spin_clip *clip)
{
    spin_status status;

    memset(clip, 0, sizeof *clip);
    SPIN_TRY(open_bundle(o->input, &clip->bundle));
    SPIN_TRY_OUT(spin_range_select(&o->range, clip->bundle.meta.frame, clip->bundle.meta.n_frames,
                                   &clip->frame, &clip->n_frames));
    for (int i = 0; i < clip->n_frames; i++) {
        size_t n = clip->bundle.meta.frame[clip->frame[i]].n;

        clip->n_max = n > clip->n_max ? n : clip->n_max;
        clip->n_mean += (double)n;
    }
    clip->n_mean /= clip->n_frames;
    SPIN_TRY_OUT(open_data(o, clip));
    if (clip->has_kept || (clip->has_views && (o->needs_views || o->wants_views)))
        SPIN_TRY_OUT(set_near(clip));
    return SPIN_OK;
out:
    spin_clip_close(clip);
    return status;
}

void spin_clip_close(struct spin_clip *clip)
{
    spin_bundle_close(&clip->bundle);
    spin_views_free(&clip->views);
    free(clip->frame);
    free(clip->dataset_frame);
    free(clip->data_path);
    memset(clip, 0, sizeof *clip);
}

spin_status spin_clip_pairs(const struct spin_clip *clip, enum spin_split split,
                            struct spin_pair **pairs, size_t *n)
{
    size_t count = 0, capacity = 0;
    struct spin_pair *list = NULL;
    struct spin_camera_cone cone;
    spin_status status;

    if (split == SPIN_SPLIT_OUTER)
        SPIN_TRY(spin_camera_cone_open(&clip->views, &cone));
    for (int f = 0; f < clip->n_frames; f++)
        for (size_t v = 0; v < clip->views.n; v++) {
            const struct spin_view *view = &clip->views.view[v];

            if (view->dataset_frame != clip->dataset_frame[f] ||
                (split != SPIN_SPLIT_ALL && view->test == (split == SPIN_SPLIT_TRAIN)) ||
                (split == SPIN_SPLIT_OUTER && !spin_camera_cone_excludes(&cone, &view->camera)))
                continue;
            status = spin_array_grow(count, &capacity, sizeof *list, (void **)&list);
            if (status != SPIN_OK) {
                free(list);
                return status;
            }
            list[count].frame = f;
            list[count++].view = v;
        }
    *pairs = list;
    *n = count;
    return SPIN_OK;
}

/* ---- The training of the clip ---------------------------------------------------------------- */

const spin_json *spin_training_of(const struct spin_bundle *bundle, enum spin_splat_source from)
{
    return spin_json_get(bundle->json, from == SPIN_FROM_TRAINED   ? "trained"
                                       : from == SPIN_FROM_REFINED ? "refined"
                                                                   : "trained_4d");
}

void spin_training_warn_background(const struct spin_bundle *bundle, enum spin_splat_source from,
                                   const float background[3], const char *what)
{
    const spin_json *taught =
        spin_json_get(spin_json_get(spin_training_of(bundle, from), "options"), "background");
    double value[3] = {0};
    bool differs = false;

    for (size_t c = 0; c < spin_json_length(taught) && c < 3; c++)
        differs |= spin_json_number(spin_json_at(taught, c), &value[c]) &&
                   fabs(value[c] - (double)background[c]) > 1e-6;
    if (differs)
        spin_warn("the splats were trained over a different background: --background %g,%g,%g %s "
                  "over that of the training",
                  value[0], value[1], value[2], what);
}

void spin_training_warn_scale(const struct spin_bundle *bundle, enum spin_splat_source from,
                              double image_scale)
{
    double taught = image_scale;

    spin_json_number(
        spin_json_get(spin_json_get(spin_training_of(bundle, from), "options"), "image_scale"),
        &taught);
    if (taught != image_scale)
        spin_warn("the splats were trained on images of a different size: --scale %g measures at "
                  "the same size",
                  taught);
}

void spin_training_warn_test_cameras(const struct spin_clip *clip, int n_test_cameras)
{
    if (clip->n_trained_test_cameras > 0)
        spin_warn("%s used to train '%s': these views are not held out",
                  spin_text_share((size_t)clip->n_trained_test_cameras, (size_t)n_test_cameras,
                                  "--test-cams camera", "was", "were", (char[96]){0}),
                  clip->bundle.path);
}
