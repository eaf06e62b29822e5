/* Determines the alpha of input images, from their files or from the colours of their pixels. */
#include "eval/matte.h"

#include <stdlib.h>
#include <string.h>

#include "base/base.h"
#include "eval/dynamic_mask.h"
#include "scene/dataset.h"

enum {
    TOLERANCE = 6, /* largest difference from the background colour that counts as noise */
    MARGIN = 2     /* pixels within this distance of a pixel that is not empty are unknown */
};

/* Least share of transparent pixels for SPIN_SURROUNDED_BY_ALPHA. */
static const double least_share = 0.05;

/* ---- Colours --------------------------------------------------------------------------------- */

/* Flood fill of the empty region of an image from its border. */
struct region {
    int width, height;
    const uint8_t *rgb8, *background;
    uint8_t *empty;  /* [h][w] 1 for pixels of the empty region, otherwise 0 */
    uint32_t *stack; /* empty pixels whose neighbours were not visited yet */
    size_t n;
};

static void visit(struct region *r, int x, int y)
{
    size_t i = (size_t)y * (size_t)r->width + (size_t)x;

    if (x < 0 || y < 0 || x >= r->width || y >= r->height || r->empty[i])
        return;
    for (int c = 0; c < 3; c++)
        if (abs(r->rgb8[3 * i + (size_t)c] - r->background[c]) > TOLERANCE)
            return;
    r->empty[i] = 1;
    r->stack[r->n++] = (uint32_t)i;
}

static void grow_from_border(struct region *r)
{
    for (int x = 0; x < r->width; x++) {
        visit(r, x, 0);
        visit(r, x, r->height - 1);
    }
    for (int y = 0; y < r->height; y++) {
        visit(r, 0, y);
        visit(r, r->width - 1, y);
    }
    while (r->n > 0) {
        int i = (int)r->stack[--r->n], x = i % r->width, y = i / r->width;

        visit(r, x - 1, y);
        visit(r, x + 1, y);
        visit(r, x, y - 1);
        visit(r, x, y + 1);
    }
}

/* Sets value i of a row or column to the minimum of the values from i - MARGIN to i + MARGIN. The
 * row or column has n values, which are `step` bytes apart. */
static void shrink_line(const uint8_t *from, uint8_t *to, int n, size_t step)
{
    for (int i = 0; i < n; i++) {
        int first = i > MARGIN ? i - MARGIN : 0, last = i + MARGIN < n ? i + MARGIN : n - 1;
        uint8_t least = 1;

        for (int k = first; k <= last; k++)
            least = from[(size_t)k * step] < least ? from[(size_t)k * step] : least;
        to[(size_t)i * step] = least;
    }
}

static void shrink(int width, int height, uint8_t *empty, uint8_t *scratch)
{
    size_t w = (size_t)width;

    for (int y = 0; y < height; y++)
        shrink_line(empty + (size_t)y * w, scratch + (size_t)y * w, width, 1);
    for (int x = 0; x < width; x++)
        shrink_line(scratch + x, empty + x, height, w);
}

spin_status spin_matte_of_colours(int width, int height, const uint8_t *rgb8,
                                  const uint8_t background[3], uint8_t *out)
{
    size_t plane = (size_t)width * (size_t)height;
    SPIN_FREED uint32_t *stack = NULL;
    struct region r = {width, height, rgb8, background, out, NULL, 0};

    SPIN_TRY(spin_alloc(plane, sizeof *stack, (void **)&stack));
    r.stack = stack;
    memset(out, 0, plane);
    grow_from_border(&r);
    shrink(width, height, out, (uint8_t *)stack);
    return SPIN_OK;
}

/* ---- Alpha ----------------------------------------------------------------------------------- */

/* Computes alpha from the image composited over white and over black, whose difference is 1 -
 * alpha. */
static spin_status read_alpha(const struct spin_view *view, uint8_t *out)
{
    static const float black[3] = {0, 0, 0}, white[3] = {1, 1, 1};
    int width = view->camera.width, height = view->camera.height;
    size_t plane = (size_t)width * (size_t)height;
    SPIN_FREED float *over_black = NULL;
    float *over_white;

    SPIN_TRY(spin_alloc(plane, 6 * sizeof *over_black, (void **)&over_black));
    over_white = over_black + 3 * plane;
    SPIN_TRY(spin_image_load(view->path, width, height, black, over_black));
    SPIN_TRY(spin_image_load(view->path, width, height, white, over_white));
    for (size_t i = 0; i < plane; i++) {
        float alpha = 1 - (over_white[i] - over_black[i]);

        out[i] = (uint8_t)(1.5f + 254 * (alpha < 0 ? 0 : alpha > 1 ? 1 : alpha));
    }
    return SPIN_OK;
}

/* ---- Borders --------------------------------------------------------------------------------- */

/* A histogram of the border pixels of images shows the most frequent colour. */

enum {
    MOST_VIEWS = 24, /* largest number of images that are decoded */
    /* Number of histogram levels per channel; a level and its two neighbours cover 12 of 256
       values, more than the noise of JPEG. */
    LEVELS = 64,
    COLOURS = LEVELS * LEVELS * LEVELS
};

static void count_pixel(const uint8_t *rgb, uint32_t *count)
{
    count[(rgb[0] / 4 * LEVELS + rgb[1] / 4) * LEVELS + rgb[2] / 4]++;
}

/* Adds the border pixels of an image to the histogram, and returns the number of these pixels. */
static uint64_t count_border(const struct spin_camera *camera, const uint8_t *rgb8, uint32_t *count)
{
    size_t w = (size_t)camera->width, h = (size_t)camera->height;

    for (size_t x = 0; x < w; x++) {
        count_pixel(rgb8 + 3 * x, count);
        count_pixel(rgb8 + 3 * ((h - 1) * w + x), count);
    }
    for (size_t y = 0; y < h; y++) {
        count_pixel(rgb8 + 3 * y * w, count);
        count_pixel(rgb8 + 3 * (y * w + w - 1), count);
    }
    return 2 * (uint64_t)(w + h);
}

/* Sets colour to the most frequent colour in the histogram. Returns the number of pixels of this
 * colour and of the adjacent levels, since a flat colour with noise may extend over two levels per
 * channel. */
static uint64_t largest_group(const uint32_t *count, float colour[3])
{
    int best = 0, at[3];
    uint64_t sum = 0;

    for (int i = 1; i < COLOURS; i++)
        best = count[i] > count[best] ? i : best;
    at[0] = best / LEVELS / LEVELS;
    at[1] = best / LEVELS % LEVELS;
    at[2] = best % LEVELS;
    for (int i = 0; i < COLOURS; i++)
        if (abs(i / LEVELS / LEVELS - at[0]) <= 1 && abs(i / LEVELS % LEVELS - at[1]) <= 1 &&
            abs(i % LEVELS - at[2]) <= 1)
            sum += count[i];
    for (int c = 0; c < 3; c++)
        colour[c] = (4.0f * (float)at[c] + 1.5f) / 255; /* the centre of the level */
    return sum;
}

spin_status spin_borders_are_flat(const struct spin_views *views, struct spin_image_cache *images,
                                  const struct spin_pair *pairs, size_t n, bool *flat,
                                  float colour[3])
{
    SPIN_FREED uint32_t *count = NULL;
    SPIN_FREED uint8_t *rgb8 = NULL;
    uint64_t all = 0;
    size_t used = n < MOST_VIEWS ? n : MOST_VIEWS, pixels = 0;

    *flat = false;
    for (size_t i = 0; i < used; i++) {
        const struct spin_camera *c = &views->view[pairs[i * n / used].view].camera;

        pixels = (size_t)c->width * (size_t)c->height > pixels
                     ? (size_t)c->width * (size_t)c->height
                     : pixels;
    }
    SPIN_TRY(spin_alloc(COLOURS, sizeof *count, (void **)&count));
    SPIN_TRY(spin_alloc(pixels + 1, 3, (void **)&rgb8));
    for (size_t i = 0; i < used; i++) {
        size_t view = pairs[i * n / used].view;

        SPIN_TRY(spin_image_cache_get_rgb8(images, view, rgb8));
        all += count_border(&views->view[view].camera, rgb8, count);
    }
    *flat = all > 0 && 2 * largest_group(count, colour) >= all;
    return SPIN_OK;
}

/* ---- Surroundings ---------------------------------------------------------------------------- */

/* Sets *share to the share, 0..1, of pixels with an alpha below 0.5 in the images. */
static spin_status find_share(const struct spin_views *views, const struct spin_pair *pairs,
                              size_t n, double *share)
{
    size_t used = n < MOST_VIEWS ? n : MOST_VIEWS, n_pixels = 0, n_transparent = 0;

    for (size_t i = 0; i < used; i++) {
        const struct spin_view *view = &views->view[pairs[i * n / used].view];
        size_t plane = (size_t)view->camera.width * (size_t)view->camera.height;
        SPIN_FREED uint8_t *matte = NULL;

        SPIN_TRY(spin_alloc(plane, 1, (void **)&matte));
        SPIN_TRY(read_alpha(view, matte));
        for (size_t k = 0; k < plane; k++)
            n_transparent += matte[k] < 128;
        n_pixels += plane;
    }
    *share = n_pixels > 0 ? (double)n_transparent / (double)n_pixels : 0;
    return SPIN_OK;
}

spin_status spin_surroundings_find(const struct spin_views *views, struct spin_image_cache *images,
                                   const struct spin_pair *pairs, size_t n,
                                   enum spin_surroundings *out, float colour[3])
{
    double share = 0;
    bool flat;

    if (spin_views_have_alpha(views, pairs, n))
        SPIN_TRY(find_share(views, pairs, n, &share));
    SPIN_TRY(spin_borders_are_flat(views, images, pairs, n, &flat, colour));
    *out = share >= least_share ? SPIN_SURROUNDED_BY_ALPHA
           : flat               ? SPIN_SURROUNDED_BY_COLOUR
                                : SPIN_SURROUNDED_BY_SCENE;
    return SPIN_OK;
}

/* ---- Mattes of views ------------------------------------------------------------------------- */

static bool is_background(const float colour[3], const float background[3])
{
    for (int c = 0; c < 3; c++)
        if (255 * fabsf(colour[c] - background[c]) > TOLERANCE)
            return false;
    return true;
}

spin_status spin_mattes_open(const struct spin_views *views, struct spin_image_cache *images,
                             const struct spin_pair *pairs, size_t n, struct spin_mattes *m,
                             enum spin_surroundings *surroundings)
{
    float colour[3];

    *m = (struct spin_mattes){0};
    SPIN_TRY(spin_surroundings_find(views, images, pairs, n, surroundings, colour));
    m->alpha = *surroundings == SPIN_SURROUNDED_BY_ALPHA;
    if (!m->alpha &&
        (*surroundings != SPIN_SURROUNDED_BY_COLOUR || !is_background(colour, images->background)))
        return SPIN_OK;
    SPIN_TRY(spin_alloc(views->n, sizeof *m->kept, (void **)&m->kept));
    m->views = views;
    m->images = images;
    for (int c = 0; c < 3; c++)
        m->background[c] = (uint8_t)lrintf(255 * images->background[c]);
    m->budget = images->budget / 4;
    images->budget -= m->budget;
    return SPIN_OK;
}

void spin_mattes_close(struct spin_mattes *m)
{
    for (size_t i = 0; m->views && i < m->views->n; i++)
        free(m->kept[i]);
    free(m->kept);
    *m = (struct spin_mattes){0};
}

static spin_status compute(struct spin_mattes *m, size_t view, uint8_t *out)
{
    const struct spin_view *v = &m->views->view[view];
    size_t plane = (size_t)v->camera.width * (size_t)v->camera.height;
    SPIN_FREED uint8_t *rgb8 = NULL;

    if (m->alpha)
        return read_alpha(v, out);
    SPIN_TRY(spin_alloc(plane, 3, (void **)&rgb8));
    SPIN_TRY(spin_image_cache_get_rgb8(m->images, view, rgb8));
    return spin_matte_of_colours(v->camera.width, v->camera.height, rgb8, m->background, out);
}

spin_status spin_mattes_find(struct spin_mattes *m, size_t view, uint8_t *out)
{
    const struct spin_camera *c = &m->views->view[view].camera;
    size_t plane = (size_t)c->width * (size_t)c->height;

    if (m->kept[view]) {
        memcpy(out, m->kept[view], plane);
        return SPIN_OK;
    }
    SPIN_TRY(compute(m, view, out));
    if (plane > m->budget - m->held)
        return SPIN_OK;
    SPIN_TRY(spin_alloc(plane, 1, (void **)&m->kept[view]));
    memcpy(m->kept[view], out, plane);
    m->held += plane;
    return SPIN_OK;
}
