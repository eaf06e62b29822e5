/* Pixels on demand. */
#include "scene/image_cache.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "base/err.h"
#include "base/mem.h"
#include "io/file.h"
#include "io/image.h"
#include "io/video.h"
#include "scene/dataset.h"

spin_status spin_image_cache_open(const struct spin_views *views, size_t budget,
                                  const float background[3], struct spin_image_cache *out)
{
    memset(out, 0, sizeof *out);
    SPIN_TRY(spin_alloc(views->n, sizeof *out->rgb, (void **)&out->rgb));
    out->views = views;
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
    for (size_t i = (size_t)(spin_views_row(views, (int)row) - views->view);
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
