/* Computes a histogram of the border pixels of images, and counts the pixels of the most frequent
 * colour. */
#include "eval/borders.h"

#include "base/base.h"

enum {
    MOST_VIEWS = 24,
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
