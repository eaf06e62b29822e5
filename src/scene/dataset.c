/* The views of a data set: sorted, split, scaled, paired with a clip, and their pixels. */
#include "scene/dataset.h"

#include <limits.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "base/err.h"
#include "base/log.h"
#include "base/mem.h"
#include "io/image.h"
#include "io/video.h"
#include "scene/probe.h"

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

/* One number per row, growing from row to row: only then do numbers say which frame is which. */
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
            spin_warn("'%s' and '%s' are both camera %d of frame %d", before->path, v->path,
                      v->camera_id, v->dataset_frame);
            return;
        }
    }
}

static spin_status arrange(struct spin_views *views)
{
    if (views->n == 0)
        return spin_fail(SPIN_E_MALFORMED, "it has no views");
    qsort(views->view, views->n, sizeof *views->view, by_row_and_camera);
    views->n_dataset_frames = views->view[views->n - 1].dataset_frame + 1;
    for (size_t i = 0; i < views->n; i++) {
        int expected = i > 0 ? views->view[i - 1].dataset_frame : 0;

        if (views->view[i].dataset_frame < expected ||
            views->view[i].dataset_frame > expected + (i > 0))
            return spin_fail(SPIN_E_MALFORMED, "it has no view of frame %d", expected + (i > 0));
    }
    views->numbered = are_numbered(views);
    warn_duplicates(views);
    return SPIN_OK;
}

/* "dynerf:time=unit,test=-1": a name and the reader's own options, cut apart in `text`. */
struct spec {
    char *text;
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
            return spin_fail(SPIN_E_USAGE, "'%s' has more than %d options", from,
                             SPIN_VIEWS_MAX_OPTIONS);
        if (end)
            *end++ = '\0';
        value = strchr(at, '=');
        if (!value)
            return spin_fail(SPIN_E_USAGE,
                             "'%s': option '%s' has no value, expected NAME:KEY=VALUE,"
                             "KEY=VALUE",
                             from, at);
        *value++ = '\0';
        spec->pairs[n] = at;
        spec->pairs[n + 1] = value;
        at = end;
    }
    return SPIN_OK;
}

/* Options the reader does not have are asked wrongly, not dropped. */
static spin_status check_spec(const struct spin_importer *importer, const struct spec *spec)
{
    for (int i = 0; spec->pairs[i]; i += 2) {
        const struct spin_plugin_option *o = importer->options;

        while (o && o->key && strcmp(o->key, spec->pairs[i]) != 0)
            o++;
        if (!o || !o->key)
            return spin_fail(SPIN_E_USAGE, "'%s' has no option '%s'", importer->name,
                             spec->pairs[i]);
    }
    return SPIN_OK;
}

/* What to open the data set with again: the name that was found, or all that was asked for. */
static spin_status keep_spec(const char *from, const struct spin_importer *importer, char *used,
                             size_t n_used)
{
    const char *text = from ? from : importer->name;

    if (used && strlen(text) >= n_used)
        return spin_fail(SPIN_E_USAGE, "'%s' has %zu letters, expected less than %zu", text,
                         strlen(text), n_used);
    if (used)
        snprintf(used, n_used, "%s", text);
    return SPIN_OK;
}

spin_status spin_views_open(const char *path, const char *from, struct spin_views *out,
                            char *used_from, size_t n_used_from)
{
    const struct spin_importer *importer;
    struct spec spec = {NULL};
    struct spin_plugin_values values = {spec.pairs};
    spin_status status;

    memset(out, 0, sizeof *out);
    if (from)
        SPIN_TRY_OUT(parse_spec(from, &spec));
    SPIN_TRY_OUT(spin_importer_find(path, spec.text, true, &importer));
    SPIN_TRY_OUT(check_spec(importer, &spec));
    SPIN_TRY_OUT(importer->views(path, &values, out));
    SPIN_TRY_OUT(arrange(out));
    SPIN_TRY_OUT(keep_spec(from, importer, used_from, n_used_from));
    free(spec.text);
    return SPIN_OK;
out:
    free(spec.text);
    spin_views_free(out);
    return spin_fail_context(status, "cannot read the data set '%s'", path);
}

/* ---- Split, size ----------------------------------------------------------------------------- */

static bool contains(const int *list, int n, int value)
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
            return spin_fail(SPIN_E_USAGE, "the data set has no camera %d", test_cameras[i]);
    }
    for (size_t k = 0; k < views->n; k++)
        views->view[k].test = contains(test_cameras, n, views->view[k].camera_id);
    return SPIN_OK;
}

/* Focal lengths and centre go with the real ratio of the rounded sizes, without a half-pixel shift:
 * that is what every reader of these data sets does. */
static spin_status scale_camera(struct spin_camera *camera, double image_scale)
{
    double width = round(camera->width * image_scale), height = round(camera->height * image_scale);
    double sx = width / camera->width, sy = height / camera->height;

    if (!(width >= 1 && height >= 1 && width <= INT_MAX && height <= INT_MAX))
        return spin_fail(SPIN_E_USAGE, "scale %g leaves nothing of an image of %d x %d pixels",
                         image_scale, camera->width, camera->height);
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
        return spin_fail(SPIN_E_USAGE, "image scale is %g, expected above 0 and at most 16",
                         image_scale);
    for (size_t i = 0; i < views->n; i++)
        SPIN_TRY(scale_camera(&views->view[i].camera, image_scale));
    return SPIN_OK;
}

/* ---- Pairing --------------------------------------------------------------------------------- */

/* First view of a row, by bisection: views are sorted by row. */
static const struct spin_view *first_of_row(const struct spin_views *views, int row)
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

/* Row with this frame number, or -1. Numbers grow with the row. */
static int row_of_number(const struct spin_views *views, int number)
{
    int low = 0, high = views->n_dataset_frames - 1;

    while (low <= high) {
        int middle = low + (high - low) / 2;
        int here = first_of_row(views, middle)->number;

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
        return spin_fail(
            SPIN_E_USAGE,
            "cannot pair frames by number: %s has no frame numbers; --pair order pairs "
            "them by order",
            meta->numbered ? "the data set" : "the clip");
    for (int i = 0; i < meta->n_frames; i++) {
        dataset_frame_of[i] = row_of_number(views, meta->frame[i].number);
        if (dataset_frame_of[i] < 0)
            return spin_fail(
                SPIN_E_USAGE,
                "cannot pair frames by number: the clip has a frame %d, the data set has "
                "%d to %d; --range leaves frames out, --pair order pairs them by order",
                meta->frame[i].number, views->view[0].number, views->view[views->n - 1].number);
    }
    return SPIN_OK;
}

static spin_status pair_by_order(const struct spin_views *views,
                                 const struct spin_bundle_meta *meta, int *dataset_frame_of)
{
    for (int i = 0; i < meta->n_frames; i++) {
        if (meta->source_index[i] >= views->n_dataset_frames)
            return spin_fail(
                SPIN_E_USAGE,
                "cannot pair frames by order: the clip has a frame at place %d, the data "
                "set has %d frames",
                meta->source_index[i], views->n_dataset_frames);
        dataset_frame_of[i] = meta->source_index[i];
    }
    return SPIN_OK;
}

spin_status spin_views_pair(const struct spin_views *views, const struct spin_bundle_meta *meta,
                            const char *pair, int *dataset_frame_of)
{
    if (strcmp(pair, "number") == 0)
        return pair_by_number(views, meta, dataset_frame_of);
    if (strcmp(pair, "order") == 0)
        return pair_by_order(views, meta, dataset_frame_of);
    if (strcmp(pair, "auto") != 0)
        return spin_fail(SPIN_E_USAGE, "--pair is '%s', expected auto, number or order", pair);
    if (views->numbered && meta->numbered)
        return pair_by_number(views, meta, dataset_frame_of);
    if (meta->n_source_frames != views->n_dataset_frames)
        return spin_fail(
            SPIN_E_USAGE,
            "cannot pair frames: the clip was made of %d frames, the data set has %d, and "
            "%s frame numbers; --pair order pairs them from the first on",
            meta->n_source_frames, views->n_dataset_frames,
            views->numbered  ? "the clip has no"
            : meta->numbered ? "the data set has no"
                             : "neither has");
    return pair_by_order(views, meta, dataset_frame_of);
}

/* ---- Extent ---------------------------------------------------------------------------------- */

/* -R^T t */
static void camera_centre(const struct spin_camera *camera, double out[3])
{
    const double *m = camera->w2c;

    for (int i = 0; i < 3; i++)
        out[i] = -(m[i] * m[3] + m[4 + i] * m[7] + m[8 + i] * m[11]);
}

/* A training camera at one place. */
struct place {
    double centre[3];
    int camera;
    size_t order; /* of the view */
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

/* Every place of every training camera once, in the order of the views. */
static size_t list_places(const struct spin_views *views, struct place *place)
{
    size_t n = 0, n_train = 0, kept = 0;

    for (size_t i = 0; i < views->n; i++)
        n_train += !views->view[i].test;
    for (size_t i = 0; i < views->n; i++) {
        if (n_train > 0 && views->view[i].test)
            continue;
        camera_centre(&views->view[i].camera, place[n].centre);
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

double spin_views_extent(const struct spin_views *views)
{
    double mean[3] = {0}, largest = 0;
    struct place *place;
    void *block = NULL;
    size_t n;

    if (spin_alloc(views->n, sizeof *place, &block) != SPIN_OK)
        return NAN;
    place = block;
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
    free(block);
    return 1.1 * largest;
}

/* ---- Pixels ---------------------------------------------------------------------------------- */

spin_status spin_image_cache_open(const struct spin_views *views, size_t budget,
                                  const float background[3], struct spin_image_cache *out)
{
    void *block = NULL;

    memset(out, 0, sizeof *out);
    SPIN_TRY(spin_alloc(views->n, sizeof *out->rgb, &block));
    out->views = views;
    out->rgb = block;
    out->budget = budget;
    for (int c = 0; background && c < 3; c++)
        out->background[c] = background[c];
    return SPIN_OK;
}

void spin_image_cache_close(struct spin_image_cache *pixels)
{
    for (size_t i = 0; pixels->rgb && i < pixels->views->n; i++)
        free(pixels->rgb[i]);
    free(pixels->rgb);
    memset(pixels, 0, sizeof *pixels);
}

/* Rounding both sides of a scaled image moves the ratio by up to a pixel; else one per cent. */
spin_status spin_view_check_size(const struct spin_view *view, int width, int height)
{
    double expected = (double)view->camera.height * width / height;
    double allowed = fmax(0.01 * view->camera.width, 0.5 + 0.5 * width / height);

    if (fabs(view->camera.width - expected) <= allowed)
        return SPIN_OK;
    return spin_fail(
        SPIN_E_MALFORMED,
        "image '%s' has %d x %d pixels, which is another shape than the camera's %d x %d",
        view->path, width, height, view->camera.width, view->camera.height);
}

spin_status spin_view_check_image(const struct spin_view *view)
{
    int width, height, channels;
    spin_status status = spin_image_size(view->path, &width, &height, &channels);

    if (status == SPIN_OK)
        status = spin_view_check_size(view, width, height);
    return status == SPIN_OK ? SPIN_OK : spin_fail_context(status, "camera %d", view->camera_id);
}

spin_status spin_views_check_cameras(const struct spin_views *views)
{
    spin_status status = SPIN_OK;
    int *seen, n = 0;

    SPIN_TRY(spin_alloc(views->n + 1, sizeof *seen, (void **)&seen));
    for (size_t i = 0; i < views->n && status == SPIN_OK; i++) {
        if (contains(seen, n, views->view[i].camera_id))
            continue;
        status = spin_view_check_image(&views->view[i]);
        if (status == SPIN_OK || status == SPIN_E_UNSUPPORTED)
            seen[n++] = views->view[i].camera_id;
        if (status == SPIN_E_NOT_FOUND || status == SPIN_E_UNSUPPORTED)
            status = SPIN_OK;
    }
    free(seen);
    return status;
}

/* Decoded pixels at the camera's size, still 8-bit, so that a kept image and one decoded anew are the
 * same. Takes *rgb and gives another block where the sizes differ. */
static spin_status fit(const struct spin_view *view, int width, int height, uint8_t **rgb)
{
    size_t plane = (size_t)view->camera.width * (size_t)view->camera.height;
    void *fitted = NULL, *image = NULL;
    spin_status status;

    if (width == view->camera.width && height == view->camera.height)
        return SPIN_OK;
    SPIN_TRY_OUT(spin_view_check_size(view, width, height));
    SPIN_TRY_OUT(spin_alloc(plane, 3, &fitted));
    SPIN_TRY_OUT(spin_alloc(plane, 3 * sizeof(float), &image));
    SPIN_TRY_OUT(
        spin_image_fit(*rgb, width, height, view->camera.width, view->camera.height, image));
    for (size_t i = 0; i < plane; i++) {
        for (size_t c = 0; c < 3; c++)
            ((uint8_t *)fitted)[3 * i + c] =
                (uint8_t)lrintf(((float *)image)[c * plane + i] * 255.0f);
    }
out:
    free(*rgb);
    *rgb = status == SPIN_OK ? fitted : NULL;
    if (status != SPIN_OK)
        free(fitted);
    free(image);
    return status;
}

static size_t bytes_of(const struct spin_view *view)
{
    return 3 * (size_t)view->camera.width * (size_t)view->camera.height;
}

static bool has_room(const struct spin_image_cache *pixels, size_t view)
{
    return bytes_of(&pixels->views->view[view]) <= pixels->budget - pixels->held;
}

static void keep(struct spin_image_cache *pixels, size_t view, uint8_t *rgb)
{
    pixels->rgb[view] = rgb;
    pixels->held += bytes_of(&pixels->views->view[view]);
}

/* ---- Frames of videos, on the way to one ------------------------------------------------------ */

struct passing {
    struct spin_image_cache *pixels;
    const struct spin_view *view; /* that is asked for */
    size_t n_file;                /* of its path */
    int64_t frame;
};

/* The view that shows another frame of the same video: its row is as far away as the frame. */
static bool find_passed(const struct passing *p, int64_t frame, size_t *out)
{
    const struct spin_views *views = p->pixels->views;
    int64_t row = p->view->dataset_frame + frame - p->frame;
    size_t n;

    if (row < 0 || row >= views->n_dataset_frames)
        return false;
    for (size_t i = (size_t)(first_of_row(views, (int)row) - views->view);
         i < views->n && views->view[i].dataset_frame == row; i++) {
        const char *path = views->view[i].path;
        int64_t other;

        if (strncmp(path, p->view->path, p->n_file) == 0 && spin_video_path(path, &n, &other) &&
            n == p->n_file && other == frame) {
            *out = i;
            return true;
        }
    }
    return false;
}

static bool wants_passed(void *context, int64_t frame)
{
    const struct passing *p = context;
    size_t view;

    return find_passed(p, frame, &view) && !p->pixels->rgb[view] && has_room(p->pixels, view);
}

/* What cannot be kept is decoded again when its turn comes, and fails then if it must. */
static void take_passed(void *context, int64_t frame, int width, int height, const uint8_t *rgb)
{
    const struct passing *p = context;
    size_t view, n = 3 * (size_t)width * (size_t)height;
    void *copy = NULL;

    if (!find_passed(p, frame, &view) || spin_alloc(n, 1, &copy) != SPIN_OK)
        return;
    memcpy(copy, rgb, n);
    if (fit(&p->pixels->views->view[view], width, height, (uint8_t **)&copy) == SPIN_OK)
        keep(p->pixels, view, copy);
}

static spin_status read_passing(struct spin_image_cache *pixels, const struct spin_view *view,
                                int *width, int *height, uint8_t **rgb)
{
    struct passing p = {.pixels = pixels, .view = view};
    struct spin_video_passer passer = {&p, wants_passed, take_passed};
    char *file = NULL;
    spin_status status;

    if (!spin_video_path(view->path, &p.n_file, &p.frame) || spin_path_exists(view->path))
        return spin_image_read(view->path, pixels->background, width, height, rgb);
    SPIN_TRY(spin_strdup(view->path, &file));
    file[p.n_file] = '\0';
    status = spin_video_read(file, p.frame, &passer, width, height, rgb);
    free(file);
    return status;
}

/* 8-bit RGB at the camera's size. */
static spin_status decode(struct spin_image_cache *pixels, const struct spin_view *view,
                          uint8_t **out)
{
    int width, height;

    SPIN_TRY(read_passing(pixels, view, &width, &height, out));
    return fit(view, width, height, out);
}

void spin_image_floats(const uint8_t *rgb, size_t plane, float *out)
{
    for (size_t c = 0; c < 3; c++) {
        for (size_t i = 0; i < plane; i++)
            out[c * plane + i] = (float)rgb[3 * i + c] / 255.0f;
    }
}

/* The bytes of a view; *owned is to be freed. */
static spin_status find_bytes(struct spin_image_cache *pixels, size_t view, const uint8_t **out,
                              uint8_t **owned)
{
    uint8_t *rgb = pixels->rgb[view];

    *owned = NULL;
    if (!rgb) {
        SPIN_TRY(decode(pixels, &pixels->views->view[view], &rgb));
        if (has_room(pixels, view))
            keep(pixels, view, rgb);
        else
            *owned = rgb;
    }
    *out = rgb;
    return SPIN_OK;
}

spin_status spin_image_cache_get(struct spin_image_cache *pixels, size_t view, float *out)
{
    const uint8_t *rgb;
    uint8_t *owned;

    SPIN_TRY(find_bytes(pixels, view, &rgb, &owned));
    spin_image_floats(rgb, bytes_of(&pixels->views->view[view]) / 3, out);
    free(owned);
    return SPIN_OK;
}

spin_status spin_image_cache_get_rgb8(struct spin_image_cache *pixels, size_t view, uint8_t *out)
{
    const uint8_t *rgb;
    uint8_t *owned;

    SPIN_TRY(find_bytes(pixels, view, &rgb, &owned));
    memcpy(out, rgb, bytes_of(&pixels->views->view[view]));
    free(owned);
    return SPIN_OK;
}
