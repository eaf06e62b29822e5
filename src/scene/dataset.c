/* Processes the views of a data set: reads, splits and scales them, pairs them with the frames of a
 * clip, computes the extent of the cameras, and checks images. */
#include "scene/dataset.h"

#include "base/base.h"
#include "geometry/camera_rig.h"
#include "io/file.h"
#include "io/image.h"
#include "scene/probe.h"
#include "scene/renders.h"

/* ---- Opening --------------------------------------------------------------------------------- */

static int by_row_and_camera(const void *a, const void *b)
{
    const struct spin_view *x = a, *y = b;

    if (x->dataset_frame != y->dataset_frame)
        return x->dataset_frame < y->dataset_frame ? -1 : 1;
    if (x->camera_id != y->camera_id)
        return x->camera_id < y->camera_id ? -1 : 1;
    if (x->test != y->test)
        return x->test ? 1 : -1;
    return strcmp(x->path, y->path);
}

/* Returns whether all views of a row have the same frame number, and numbers increase from row to
 * row. Only then do frame numbers identify frames. */
static bool are_numbered(const struct spin_views *views)
{
    for (size_t i = 0; i < views->n; i++) {
        const struct spin_view *v = &views->view[i], *before = v - 1;

        if (v->number < 0)
            return false;
        if (i > 0 && (v->dataset_frame == before->dataset_frame ? v->number != before->number
                                                                : v->number <= before->number))
            return false;
    }
    return true;
}

static void warn_duplicates(const struct spin_views *views)
{
    for (size_t i = 1; i < views->n; i++) {
        const struct spin_view *v = &views->view[i], *before = v - 1;

        if (v->dataset_frame == before->dataset_frame && v->camera_id == before->camera_id) {
            spin_warn("'%s' and '%s' are both images of camera %d in frame %d", before->path,
                      v->path, v->camera_id, v->number >= 0 ? v->number : v->dataset_frame);
            return;
        }
    }
}

static spin_status sort_views(struct spin_views *views)
{
    if (views->n == 0)
        return spin_malformed("the data set has no images");
    qsort(views->view, views->n, sizeof *views->view, by_row_and_camera);
    views->n_dataset_frames = views->view[views->n - 1].dataset_frame + 1;
    for (size_t i = 0; i < views->n; i++) {
        int expected = i > 0 ? views->view[i - 1].dataset_frame : 0;

        if (views->view[i].dataset_frame < expected ||
            views->view[i].dataset_frame > expected + (i > 0))
            return spin_malformed("there is no view of frame %d", expected + (i > 0));
    }
    views->numbered = are_numbered(views);
    warn_duplicates(views);
    return SPIN_OK;
}

/* An importer of data sets with options, such as "dynerf:time=unit,test=-1". */
struct spec {
    char *text; /* name of the importer */
    /* key, value, ..., NULL; these point into `text` */
    const char *pairs[2 * SPIN_VIEWS_MAX_OPTIONS + 1];
};

static spin_status parse_spec(const char *from, struct spec *spec)
{
    char *at;

    SPIN_TRY(spin_strdup(from, &spec->text));
    at = strchr(spec->text, ':');
    if (at)
        *at++ = '\0';
    for (int n = 0; at && *at; n += 2) {
        char *end = strchr(at, ','), *value;

        if (n == 2 * SPIN_VIEWS_MAX_OPTIONS)
            return spin_misuse("'%s' has more than %d options", from, SPIN_VIEWS_MAX_OPTIONS);
        if (end)
            *end++ = '\0';
        value = strchr(at, '=');
        if (!value)
            return spin_misuse("'%s': option '%s' has no value, expected NAME:KEY=VALUE,KEY=VALUE",
                               from, at);
        *value++ = '\0';
        spec->pairs[n] = at;
        spec->pairs[n + 1] = value;
        at = end;
    }
    return SPIN_OK;
}

/* Fails if the importer lacks one of the options. */
static spin_status check_spec(const struct spin_importer *importer, const struct spec *spec)
{
    for (int i = 0; spec->pairs[i]; i += 2) {
        const struct spin_plugin_option *o = importer->options;

        while (o && o->key && strcmp(o->key, spec->pairs[i]) != 0)
            o++;
        if (!o || !o->key)
            return spin_misuse("'%s' has no option '%s'", importer->name, spec->pairs[i]);
    }
    return SPIN_OK;
}

/* Writes to `used` the argument `from` with which spin_views_open() opens the data set in the same
 * way again: the importer that was found, followed by the given options. */
static spin_status keep_spec(const char *from, const struct spin_importer *importer, char *used,
                             size_t n_used)
{
    const char *options = from ? from + strcspn(from, ":") : "";
    size_t n = strlen(importer->name) + strlen(options);

    if (used && n >= n_used)
        return spin_misuse(
            "the importer with its options, '%s%s', has %zu characters, expected fewer than %zu",
            importer->name, options, n, n_used);
    if (used)
        snprintf(used, n_used, "%s%s", importer->name, options);
    return SPIN_OK;
}

/* Registers all images and masks as inputs, so that no output may replace them, even if this run
 * reads only some of them. */
static spin_status protect_images(const struct spin_views *views)
{
    struct stat st;

    for (size_t i = 0; i < views->n; i++) {
        if (stat(views->view[i].path, &st) == 0)
            SPIN_TRY(spin_inputs_add(&st));
        if (views->view[i].mask && stat(views->view[i].mask, &st) == 0)
            SPIN_TRY(spin_inputs_add(&st));
    }
    return SPIN_OK;
}

spin_status spin_views_open(const char *path, const char *from, struct spin_views *out,
                            char *used_from, size_t n_used_from)
{
    const struct spin_importer *importer;
    struct spec spec = {0};
    const char *name;
    struct spin_plugin_values values = {spec.pairs};
    spin_status status;

    memset(out, 0, sizeof *out);
    if (from)
        SPIN_TRY_OUT(parse_spec(from, &spec));
    name = spec.text && *spec.text ? spec.text : NULL;
    importer = &spin_renders;
    if (!spin_renders_reads(path, name))
        SPIN_TRY_OUT(spin_importer_find(path, name, true, &importer));
    SPIN_TRY_OUT(check_spec(importer, &spec));
    SPIN_TRY_OUT(importer->views(path, &values, out));
    SPIN_TRY_OUT(sort_views(out));
    SPIN_TRY_OUT(keep_spec(from, importer, used_from, n_used_from));
    SPIN_TRY_OUT(protect_images(out));
    free(spec.text);
    return SPIN_OK;
out:
    free(spec.text);
    spin_views_free(out);
    return spin_fail_context(status, "cannot read the data set '%s'", path);
}

/* ---- Split, size ----------------------------------------------------------------------------- */

static bool list_contains(const int *list, int n, int value)
{
    for (int i = 0; i < n; i++) {
        if (list[i] == value)
            return true;
    }
    return false;
}

spin_status spin_views_split(struct spin_views *views, const int *test_cameras, int n)
{
    for (int i = 0; i < n; i++) {
        size_t k = 0;

        while (k < views->n && views->view[k].camera_id != test_cameras[i])
            k++;
        if (k == views->n)
            return spin_misuse("the data set has no camera %d", test_cameras[i]);
    }
    for (size_t k = 0; k < views->n; k++)
        views->view[k].test = list_contains(test_cameras, n, views->view[k].camera_id);
    return SPIN_OK;
}

/* Scales the image size and rounds it. The focal lengths and the principal point are scaled by the
 * ratio of the rounded size to the old size, without a half-pixel shift, as other readers of these
 * data sets do. */
static spin_status scale_camera(struct spin_camera *camera, double image_scale)
{
    double width = round(camera->width * image_scale), height = round(camera->height * image_scale);
    double sx = width / camera->width, sy = height / camera->height;

    if (!(width >= 1 && height >= 1 && width <= INT_MAX && height <= INT_MAX))
        return spin_misuse("scale %g is out of range for an image of %d x %d pixels", image_scale,
                           camera->width, camera->height);
    camera->width = (int)width;
    camera->height = (int)height;
    camera->fx *= sx;
    camera->cx *= sx;
    camera->fy *= sy;
    camera->cy *= sy;
    return SPIN_OK;
}

spin_status spin_views_scale(struct spin_views *views, double image_scale)
{
    if (!(image_scale > 0 && image_scale <= 16))
        return spin_misuse("image scale is %g, expected above 0 and at most 16", image_scale);
    for (size_t i = 0; i < views->n; i++)
        SPIN_TRY(scale_camera(&views->view[i].camera, image_scale));
    return SPIN_OK;
}

void spin_views_shift(struct spin_views *views, const double shift[3])
{
    for (size_t i = 0; i < views->n; i++) {
        double *w = views->view[i].camera.w2c;

        for (int r = 0; r < 3; r++)
            w[4 * r + 3] += w[4 * r] * shift[0] + w[4 * r + 1] * shift[1] + w[4 * r + 2] * shift[2];
    }
}

/* ---- Pairing --------------------------------------------------------------------------------- */

const struct spin_view *spin_views_row(const struct spin_views *views, int row)
{
    size_t low = 0, high = views->n;

    while (low < high) {
        size_t middle = low + (high - low) / 2;

        if (views->view[middle].dataset_frame < row)
            low = middle + 1;
        else
            high = middle;
    }
    return &views->view[low];
}

/* Returns the row with this frame number; -1 if there is none. Numbers increase from row to row, so
 * the search is binary. */
static int row_of_number(const struct spin_views *views, int number)
{
    int low = 0, high = views->n_dataset_frames - 1;

    while (low <= high) {
        int middle = low + (high - low) / 2;
        int here = spin_views_row(views, middle)->number;

        if (here == number)
            return middle;
        if (here < number)
            low = middle + 1;
        else
            high = middle - 1;
    }
    return -1;
}

static spin_status pair_by_number(const struct spin_views *views,
                                  const struct spin_bundle_meta *meta, int *dataset_frame_of)
{
    if (!views->numbered || !meta->numbered)
        return spin_misuse("cannot pair frames by number: %s has no frame numbers; pair frames by "
                           "order with --pair order",
                           meta->numbered ? "the data set" : "the clip");
    for (int i = 0; i < meta->n_frames; i++) {
        dataset_frame_of[i] = row_of_number(views, meta->frame[i].number);
        if (dataset_frame_of[i] < 0 && views->lacks_frames)
            return spin_misuse("cannot pair frames by number: the data set has no images of frame "
                               "%d; leave the frame out with --range",
                               meta->frame[i].number);
        if (dataset_frame_of[i] < 0)
            return spin_misuse(
                "cannot pair frames by number: the clip has frame %d, the data set has frames %d "
                "to %d; leave frames out with --range, or pair frames by order with --pair order",
                meta->frame[i].number, views->view[0].number, views->view[views->n - 1].number);
    }
    return SPIN_OK;
}

static spin_status pair_by_order(const struct spin_views *views,
                                 const struct spin_bundle_meta *meta, int *dataset_frame_of)
{
    char frames[48];

    if (views->lacks_frames && meta->n_source_frames != views->n_dataset_frames)
        return spin_misuse("cannot pair frames by order: the data set has no images of some "
                           "frames, and only frame numbers would show which frames these are");
    for (int i = 0; i < meta->n_frames; i++) {
        if (meta->source_index[i] >= views->n_dataset_frames)
            return spin_misuse("cannot pair frames by order: the clip has a frame at position %d, "
                               "but the data set has only %s",
                               meta->source_index[i],
                               spin_text_count(views->n_dataset_frames, "frame", frames));
        dataset_frame_of[i] = meta->source_index[i];
    }
    return SPIN_OK;
}

/* Sets *out to whether every frame of the data set has one image, each from a different camera, as
 * in a COLMAP model without frame folders. */
static spin_status has_one_view_each(const struct spin_views *views, bool *out)
{
    SPIN_FREED int *camera = NULL;

    *out = views->n > 1 && (size_t)views->n_dataset_frames == views->n;
    if (!*out)
        return SPIN_OK;
    SPIN_TRY(spin_alloc(views->n, sizeof *camera, (void **)&camera));
    for (size_t i = 0; i < views->n; i++)
        camera[i] = views->view[i].camera_id;
    qsort(camera, views->n, sizeof *camera, spin_by_int);
    for (size_t i = 1; i < views->n; i++)
        *out = *out && camera[i] != camera[i - 1];
    return SPIN_OK;
}

/* Assigns all views to frame 0. */
static void make_still(struct spin_views *views)
{
    for (size_t i = 0; i < views->n; i++) {
        views->view[i].dataset_frame = 0;
        views->view[i].time = 0;
    }
    qsort(views->view, views->n, sizeof *views->view, by_row_and_camera);
    views->n_dataset_frames = 1;
    views->numbered = views->lacks_frames = false;
}

spin_status spin_views_warn_single(const struct spin_views *views)
{
    bool single;

    SPIN_TRY(has_one_view_each(views, &single));
    if (single)
        spin_warn(
            "the data set has one image per frame, each from a different camera position: this is "
            "right for the video of one moving camera; if the %zu images were taken at the "
            "same time, put them into a folder for each frame (see colmap in "
            "spin-importers(7))",
            views->n);
    return SPIN_OK;
}

spin_status spin_views_pair(struct spin_views *views, const struct spin_bundle_meta *meta,
                            const char *pair, int *dataset_frame_of)
{
    char frames[48];
    bool single = false;

    if (strcmp(pair, "number") == 0)
        return pair_by_number(views, meta, dataset_frame_of);
    if (meta->n_source_frames == 1)
        SPIN_TRY(has_one_view_each(views, &single));
    if (single) /* a static scene: all images belong to its only frame */
        make_still(views);
    if (strcmp(pair, "order") == 0)
        return pair_by_order(views, meta, dataset_frame_of);
    if (*pair && strcmp(pair, "auto") != 0)
        return spin_misuse("--pair is '%s', expected auto, number or order", pair);
    if (views->numbered && meta->numbered)
        return pair_by_number(views, meta, dataset_frame_of);
    if (meta->n_source_frames != views->n_dataset_frames)
        return spin_misuse("cannot pair frames: the source clip has %s, the data set has %d, and "
                           "%s frame numbers; pair frames from the first on with --pair order",
                           spin_text_count(meta->n_source_frames, "frame", frames),
                           views->n_dataset_frames,
                           views->numbered  ? "the clip has no"
                           : meta->numbered ? "the data set has no"
                                            : "neither has");
    return pair_by_order(views, meta, dataset_frame_of);
}

/* ---- Extent ---------------------------------------------------------------------------------- */

/* The position of a training camera in one view. */
struct place {
    double centre[3];
    int camera;
    size_t order; /* index of this view in the list of views */
};

static int compare_places(const struct place *x, const struct place *y)
{
    for (int c = 0; c < 3; c++)
        if (x->centre[c] != y->centre[c])
            return x->centre[c] < y->centre[c] ? -1 : 1;
    return (x->camera > y->camera) - (x->camera < y->camera);
}

static int by_order(const void *a, const void *b)
{
    const struct place *x = a, *y = b;

    return (x->order > y->order) - (x->order < y->order);
}

static int by_place(const void *a, const void *b)
{
    int result = compare_places(a, b);

    return result ? result : by_order(a, b);
}

/* Lists the distinct positions of each training camera in the order of the views, and returns their
 * number. If all cameras are test cameras, the positions of these are listed. */
static size_t list_places(const struct spin_views *views, struct place *place)
{
    size_t n = 0, n_train = 0, kept = 0;

    for (size_t i = 0; i < views->n; i++)
        n_train += !views->view[i].test;
    for (size_t i = 0; i < views->n; i++) {
        if (n_train > 0 && views->view[i].test)
            continue;
        spin_camera_centre(&views->view[i].camera, place[n].centre);
        place[n].camera = views->view[i].camera_id;
        place[n++].order = i;
    }
    qsort(place, n, sizeof *place, by_place);
    for (size_t i = 0; i < n; i++)
        if (kept == 0 || compare_places(&place[i], &place[kept - 1]) != 0)
            place[kept++] = place[i];
    qsort(place, kept, sizeof *place, by_order);
    return kept;
}

spin_status spin_views_count_positions(const struct spin_views *views, size_t *n)
{
    SPIN_FREED struct place *place = NULL;

    SPIN_TRY(spin_alloc(views->n, sizeof *place, (void **)&place));
    *n = list_places(views, place);
    return SPIN_OK;
}

double spin_views_extent(const struct spin_views *views)
{
    double mean[3] = {0}, largest = 0;
    SPIN_FREED struct place *place = NULL;
    size_t n;

    if (spin_alloc(views->n, sizeof *place, (void **)&place) != SPIN_OK)
        return NAN;
    n = list_places(views, place);
    for (size_t i = 0; i < n; i++)
        for (int c = 0; c < 3; c++)
            mean[c] += place[i].centre[c];
    for (int c = 0; c < 3 && n > 0; c++)
        mean[c] /= (double)n;
    for (size_t i = 0; i < n; i++) {
        double squared = 0;

        for (int c = 0; c < 3; c++)
            squared += (place[i].centre[c] - mean[c]) * (place[i].centre[c] - mean[c]);
        largest = fmax(largest, sqrt(squared));
    }
    return 1.1 * largest;
}

/* ---- Images ---------------------------------------------------------------------------------- */

/* Checks that the image file has the camera's aspect ratio. The expected width is the camera's
 * height times the aspect ratio of the file. The camera's width may differ from the expected width
 * by the larger of two tolerances: 1 % of the camera's width, and the effect of rounding, which is
 * half a pixel plus the change of the expected width if the height changes by half a pixel. */
spin_status spin_view_check_size(const struct spin_view *view, int width, int height)
{
    double expected = (double)view->camera.height * width / height;
    double allowed = fmax(0.01 * view->camera.width, 0.5 + 0.5 * width / height);

    if (fabs(view->camera.width - expected) <= allowed)
        return SPIN_OK;
    return spin_malformed(
        "image '%s' has %d x %d pixels, which differ in aspect ratio from the camera's %d x %d",
        view->path, width, height, view->camera.width, view->camera.height);
}

static spin_status check_image(const struct spin_view *view, int *width, int *height)
{
    int channels;
    spin_status status = spin_image_size(view->path, width, height, &channels);

    if (status == SPIN_OK)
        status = spin_view_check_size(view, *width, *height);
    return spin_fail_context(status, "camera %d", view->camera_id);
}

spin_status spin_view_check_image(const struct spin_view *view)
{
    int width, height;

    return check_image(view, &width, &height);
}

spin_status spin_views_check_cameras(const struct spin_views *views, bool warns)
{
    spin_status status = SPIN_OK;
    int n = 0, n_small = 0, width = 0, height = 0;
    SPIN_FREED int *seen = NULL;
    char first[100] = "";

    SPIN_TRY(spin_alloc(views->n + 1, sizeof *seen, (void **)&seen));
    for (size_t i = 0; i < views->n && status == SPIN_OK; i++) {
        const struct spin_camera *camera = &views->view[i].camera;

        if (list_contains(seen, n, views->view[i].camera_id))
            continue;
        status = check_image(&views->view[i], &width, &height);
        if (status == SPIN_OK && width + 1 < camera->width && n_small++ == 0)
            snprintf(first, sizeof first, "%d x %d instead of %d x %d pixels for camera %d", width,
                     height, camera->width, camera->height, views->view[i].camera_id);
        if (status == SPIN_OK || status == SPIN_E_UNSUPPORTED)
            seen[n++] = views->view[i].camera_id;
        if (status == SPIN_E_NOT_FOUND || status == SPIN_E_UNSUPPORTED)
            status = SPIN_OK;
    }
    if (status == SPIN_OK && warns && n_small > 0)
        spin_warn("the images of %d of %d cameras are smaller than the data set states and are "
                  "enlarged, such as %s: use a smaller --scale to avoid that",
                  n_small, n, first);
    return status;
}

size_t spin_views_pixels(const struct spin_views *views)
{
    size_t most = 1;

    for (size_t i = 0; i < views->n; i++) {
        const struct spin_camera *c = &views->view[i].camera;
        size_t pixels = (size_t)c->width * (size_t)c->height;

        most = pixels > most ? pixels : most;
    }
    return most;
}

/* ---- Path of a data set ---------------------------------------------------------------------- */

spin_status spin_bundle_set_data_path(struct spin_bundle_meta *meta, const char *folder,
                                      const char *data)
{
    SPIN_TRY(spin_path_relative(folder, data, &meta->data_path));
    return spin_path_absolute(data, &meta->data_absolute);
}

/* Joins a folder and a relative path. The result need not exist. Each leading "../" of the path
 * removes one component of the folder. */
static spin_status resolve_path(const char *folder, const char *path, char **out)
{
    SPIN_FREED char *from = NULL;

    SPIN_TRY(spin_path_absolute(folder, &from));
    for (size_t n; *path; path += n + (path[n] == '/')) {
        char *slash = strrchr(from, '/');

        n = strcspn(path, "/");
        if (n == 2 && strncmp(path, "..", 2) == 0 && slash)
            *slash = '\0';
        else if (n > 1 || (n == 1 && *path != '.'))
            break;
    }
    return *path ? spin_path_join(from, path, out) : spin_strdup(*from ? from : "/", out);
}

/* Returns whether a path is a data set. The relative path that the bundle records is often just
 * "..", which leads to an unrelated folder if the bundle was moved without its data set. */
static bool is_data_set(const char *path) { return spin_importer_guess(path, true) != NULL; }

spin_status spin_bundle_data_path(const struct spin_bundle *bundle, char **out)
{
    const char *path = bundle->meta.data_path, *absolute = bundle->meta.data_absolute;
    bool there;
    SPIN_FREED char *folder = NULL, *beside = NULL;

    *out = NULL;
    if (!path)
        return SPIN_OK;
    if (path[0] == '/')
        return spin_strdup(path, out);
    SPIN_TRY(spin_path_folder(bundle->path, &folder));
    SPIN_TRY(resolve_path(folder, path, &beside));
    there = spin_path_exists(beside);
    if (absolute &&
        (!there || (spin_path_exists(absolute) && !is_data_set(beside) && is_data_set(absolute))))
        return spin_strdup(absolute, out);
    return there ? spin_path_absolute(beside, out) : spin_strdup(beside, out);
}
