/* Reads images as planar floats at the size of a camera, and caches decoded images.
 *
 * Resizing uses a box filter: an output pixel is the mean over the area that it covers in the
 * source image. Along one side with `from` source and `to` output pixels, measured in units of
 * 1/(from * to) of its length, source pixel i covers [i * to, (i + 1) * to), and output pixel o
 * covers [o * from, (o + 1) * from). All overlaps are therefore integers, whose sum is `from`:
 * weights have no rounding errors, and are equal if the sizes differ by an integer factor. */
#include "scene/image_cache.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "base/mem.h"
#include "io/file.h"
#include "io/image.h"
#include "io/video.h"
#include "scene/dataset.h"

/* The interval that an output pixel covers along one side of the image. */
struct box {
    int64_t begin, end;  /* in units of 1/(from * to) of that side */
    int64_t first, last; /* source pixels that overlap the interval */
};

static struct box box_at(int64_t o, int64_t from, int64_t to)
{
    struct box b = {.begin = o * from, .end = (o + 1) * from};

    b.first = b.begin / to;
    b.last = (b.end - 1) / to;
    return b;
}

static double box_weight(const struct box *b, int64_t i, int64_t to)
{
    int64_t begin = i * to > b->begin ? i * to : b->begin;
    int64_t end = (i + 1) * to < b->end ? (i + 1) * to : b->end;

    return (double)(end - begin);
}

/* Resizes a source row horizontally to `width` pixels, multiplies it by `weight` and adds it to sum
 * [width][3]. */
static void add_row(const uint8_t *row, int from_width, int width, double weight, double *sum)
{
    for (int x = 0; x < width; x++) {
        struct box b = box_at(x, from_width, width);
        double rgb[3] = {0};

        for (int64_t i = b.first; i <= b.last; i++) {
            double w = box_weight(&b, i, width);

            for (int c = 0; c < 3; c++)
                rgb[c] += w * row[3 * i + c];
        }
        for (int c = 0; c < 3; c++)
            sum[3 * x + c] += weight * rgb[c];
    }
}

static void filter_box(const uint8_t *rgb, int from_width, int from_height, int width, int height,
                       double *sum, float *out)
{
    size_t plane = (size_t)width * (size_t)height;
    double whole = 255.0 * from_width * from_height;

    for (int y = 0; y < height; y++) {
        struct box b = box_at(y, from_height, height);

        for (int x = 0; x < 3 * width; x++)
            sum[x] = 0;
        for (int64_t i = b.first; i <= b.last; i++)
            add_row(rgb + (size_t)i * 3 * (size_t)from_width, from_width, width,
                    box_weight(&b, i, height), sum);
        for (int x = 0; x < width; x++) {
            for (int c = 0; c < 3; c++)
                out[(size_t)c * plane + (size_t)y * (size_t)width + (size_t)x] =
                    (float)(sum[3 * x + c] / whole);
        }
    }
}

void spin_image_floats(const uint8_t *rgb, size_t n_pixels, float *out)
{
    for (size_t c = 0; c < 3; c++) {
        for (size_t i = 0; i < n_pixels; i++)
            out[c * n_pixels + i] = (float)rgb[3 * i + c] / 255.0f;
    }
}

/* Converts interleaved 8-bit RGB to planar floats 0..1, [3][height][width]. Resizes the image if
 * the sizes differ. */
static spin_status filter_image(const uint8_t *rgb, int from_width, int from_height, int width,
                                int height, float *out)
{
    SPIN_FREED double *sum = NULL;

    if (from_width == width && from_height == height) {
        spin_image_floats(rgb, (size_t)width * (size_t)height, out);
        return SPIN_OK;
    }
    SPIN_TRY(spin_alloc((size_t)width, 3 * sizeof *sum, (void **)&sum));
    filter_box(rgb, from_width, from_height, width, height, sum, out);
    return SPIN_OK;
}

spin_status spin_image_load(const char *path, int width, int height, const float background[3],
                            float *out)
{
    int from_width, from_height;
    SPIN_FREED uint8_t *rgb = NULL;

    SPIN_TRY(spin_image_read(path, background, &from_width, &from_height, &rgb));
    return filter_image(rgb, from_width, from_height, width, height, out);
}

/* Converts 0..1 to 0..255, rounded and clamped; NaN becomes 0. */
static uint8_t to_byte(float value)
{
    if (!(value > 0.0f))
        return 0;
    return value >= 1.0f ? 255 : (uint8_t)lrintf(value * 255.0f);
}

spin_status spin_image_save(const char *path, int width, int height, const float *image, bool sync)
{
    size_t plane = (size_t)width * (size_t)height;
    SPIN_FREED uint8_t *rgb = NULL;

    SPIN_TRY(spin_alloc(plane, 3, (void **)&rgb));
    for (size_t i = 0; i < plane; i++) {
        for (size_t c = 0; c < 3; c++)
            rgb[3 * i + c] = to_byte(image[c * plane + i]);
    }
    return spin_image_write(path, width, height, rgb, sync);
}

/* ---- Cache ----------------------------------------------------------------------------------- */

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
    spin_read_ahead_free(pixels->ahead);
    for (size_t i = 0; pixels->rgb && i < pixels->views->n; i++)
        free(pixels->rgb[i]);
    free(pixels->rgb);
    memset(pixels, 0, sizeof *pixels);
}

/* Resizes a decoded image to the size of its camera. If the sizes differ, *rgb is freed and
 * replaced by the resized image. The resized image is rounded to 8 bits even if it is not cached:
 * cached images have 8 bits, and results must not depend on whether an image is cached. On failure,
 * *rgb is freed and set to NULL. */
static spin_status resize_to_camera(const struct spin_view *view, int width, int height,
                                    uint8_t **rgb)
{
    size_t plane = (size_t)view->camera.width * (size_t)view->camera.height;
    void *fitted = NULL, *image = NULL;
    spin_status status;

    if (width == view->camera.width && height == view->camera.height)
        return SPIN_OK;
    SPIN_TRY_OUT(spin_view_check_size(view, width, height));
    SPIN_TRY_OUT(spin_alloc(plane, 3, &fitted));
    SPIN_TRY_OUT(spin_alloc(plane, 3 * sizeof(float), &image));
    SPIN_TRY_OUT(filter_image(*rgb, width, height, view->camera.width, view->camera.height, image));
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
    return pixels->held + pixels->reserved + bytes_of(&pixels->views->view[view]) <= pixels->budget;
}

static void cache_image(struct spin_image_cache *pixels, size_t view, uint8_t *rgb)
{
    pixels->rgb[view] = rgb;
    pixels->held += bytes_of(&pixels->views->view[view]);
}

/* ---- Frames of videos that are decoded before the requested frame ---------------------------- */

struct passing {
    struct spin_image_cache *pixels;
    const struct spin_view *view; /* the requested view */
    size_t n_file;                /* length of the video's path in view->path */
    int64_t frame;                /* the requested frame of the video */
};

/* Finds the view that shows frame `frame` of the video that contains the requested view. Within one
 * video, the difference between data set row and video frame is constant. */
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

/* Stores a frame in the cache. An error is ignored here; it is reported if the frame is requested
 * later and decoded again. */
static void store_passed(void *context, int64_t frame, int width, int height, const uint8_t *rgb)
{
    const struct passing *p = context;
    size_t view, n = 3 * (size_t)width * (size_t)height;
    void *copy = NULL;

    if (!find_passed(p, frame, &view) || spin_alloc(n, 1, &copy) != SPIN_OK)
        return;
    memcpy(copy, rgb, n);
    if (resize_to_camera(&p->pixels->views->view[view], width, height, (uint8_t **)&copy) ==
        SPIN_OK)
        cache_image(p->pixels, view, copy);
}

static spin_status read_passing(struct spin_image_cache *pixels, const struct spin_view *view,
                                int *width, int *height, uint8_t **rgb)
{
    struct passing p = {.pixels = pixels, .view = view};
    struct spin_video_passer passer = {&p, wants_passed, store_passed};
    SPIN_FREED char *file = NULL;

    if (!spin_video_path(view->path, &p.n_file, &p.frame) || spin_path_exists(view->path))
        return spin_image_read(view->path, pixels->background, width, height, rgb);
    SPIN_TRY(spin_strdup(view->path, &file));
    file[p.n_file] = '\0';
    return spin_video_read(file, p.frame, &passer, width, height, rgb);
}

/* Decodes the image of a view to 8-bit RGB and resizes it to the size of the camera. */
static spin_status decode_view(struct spin_image_cache *pixels, const struct spin_view *view,
                               uint8_t **out)
{
    int width, height;

    SPIN_TRY(read_passing(pixels, view, &width, &height, out));
    return resize_to_camera(view, width, height, out);
}

/* ---- Reading ahead --------------------------------------------------------------------------- */

enum {
    READERS = 4,    /* number of background threads */
    MOST_AHEAD = 16 /* maximum number of images decoded ahead */
};

static spin_status decode_file(void *context, size_t view, uint8_t **rgb)
{
    const struct spin_image_cache *pixels = context;
    const struct spin_view *of = &pixels->views->view[view];
    int width, height;

    SPIN_TRY(spin_image_read(of->path, pixels->background, &width, &height, rgb));
    return resize_to_camera(of, width, height, rgb);
}

spin_status spin_image_cache_read_ahead(struct spin_image_cache *pixels)
{
    size_t largest = 1, n;

    for (size_t i = 0; i < pixels->views->n; i++)
        largest = bytes_of(&pixels->views->view[i]) > largest ? bytes_of(&pixels->views->view[i])
                                                              : largest;
    n = pixels->budget / 4 / largest;
    n = n < MOST_AHEAD ? n : MOST_AHEAD;
    if (n == 0)
        return SPIN_OK;
    SPIN_TRY(spin_read_ahead_start(READERS, n, decode_file, pixels, &pixels->ahead));
    pixels->reserved = n * largest;
    return SPIN_OK;
}

size_t spin_image_cache_ahead(const struct spin_image_cache *pixels)
{
    return pixels->ahead ? spin_read_ahead_capacity(pixels->ahead) : 0;
}

void spin_image_cache_announce(struct spin_image_cache *pixels, size_t view)
{
    const char *path = pixels->views->view[view].path;
    int64_t frame;
    size_t n;

    /* Video decoders, and the player that renders images, are not thread-safe. */
    if (pixels->ahead && !pixels->rgb[view] && !spin_image_is_drawn(path) &&
        !spin_video_path(path, &n, &frame))
        spin_read_ahead_announce(pixels->ahead, view);
}

/* Sets *out to the image of a view, from the cache or decoded. If a decoded image does not fit into
 * the cache, *owned is that image, and the caller frees it; otherwise *owned is NULL. */
static spin_status find_bytes(struct spin_image_cache *pixels, size_t view, const uint8_t **out,
                              uint8_t **owned)
{
    uint8_t *rgb = pixels->rgb[view];

    *owned = NULL;
    if (!rgb) {
        rgb = pixels->ahead ? spin_read_ahead_take(pixels->ahead, view) : NULL;
        if (!rgb)
            SPIN_TRY(decode_view(pixels, &pixels->views->view[view], &rgb));
        if (has_room(pixels, view))
            cache_image(pixels, view, rgb);
        else
            *owned = rgb;
    }
    *out = rgb;
    return SPIN_OK;
}

spin_status spin_image_cache_get(struct spin_image_cache *pixels, size_t view, float *out)
{
    const uint8_t *rgb;
    SPIN_FREED uint8_t *owned = NULL;

    SPIN_TRY(find_bytes(pixels, view, &rgb, &owned));
    spin_image_floats(rgb, bytes_of(&pixels->views->view[view]) / 3, out);
    return SPIN_OK;
}

spin_status spin_image_cache_get_rgb8(struct spin_image_cache *pixels, size_t view, uint8_t *out)
{
    const uint8_t *rgb;
    SPIN_FREED uint8_t *owned = NULL;

    SPIN_TRY(find_bytes(pixels, view, &rgb, &owned));
    memcpy(out, rgb, bytes_of(&pixels->views->view[view]));
    return SPIN_OK;
}
