/* Images as planar floats of a camera's size (spin.h, part 6).
 *
 * The box filter is the average over the area that an output pixel covers. In units of
 * 1/(from * to) source pixel i covers [i * to, (i + 1) * to) and output pixel o covers
 * [o * from, (o + 1) * from), so all overlaps are whole numbers and sum to `from`: nothing is lost
 * to rounding, and at whole factors the weights are equal. */
#include "scene/image_fit.h"

#include <math.h>
#include <stdlib.h>

#include "base/err.h"
#include "base/mem.h"
#include "io/image.h"

/* Source pixels under output pixel o, and the weight of pixel i among them. */
struct box {
    int64_t begin, end;  /* of the output pixel, in fine units */
    int64_t first, last; /* source pixels */
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

/* sum [width][3] += weight * the row, filtered sideways. */
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

static void filter(const uint8_t *rgb, int from_width, int from_height, int width, int height,
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

spin_status spin_image_fit(const uint8_t *rgb, int from_width, int from_height, int width,
                           int height, float *out)
{
    double *sum = NULL;

    if (from_width == width && from_height == height) {
        spin_image_floats(rgb, (size_t)width * (size_t)height, out);
        return SPIN_OK;
    }
    SPIN_TRY(spin_alloc((size_t)width, 3 * sizeof *sum, (void **)&sum));
    filter(rgb, from_width, from_height, width, height, sum, out);
    free(sum);
    return SPIN_OK;
}

spin_status spin_image_load(const char *path, int width, int height, const float background[3],
                            float *out)
{
    int from_width, from_height;
    uint8_t *rgb = NULL;
    spin_status status;

    SPIN_TRY_OUT(spin_image_read(path, background, &from_width, &from_height, &rgb));
    status = spin_image_fit(rgb, from_width, from_height, width, height, out);
out:
    free(rgb);
    return status;
}

/* NaN counts as black. */
static uint8_t to_byte(float value)
{
    if (!(value > 0.0f))
        return 0;
    return value >= 1.0f ? 255 : (uint8_t)lrintf(value * 255.0f);
}

spin_status spin_image_save(const char *path, int width, int height, const float *image, bool sync)
{
    size_t plane = (size_t)width * (size_t)height;
    uint8_t *rgb = NULL;
    spin_status status;

    SPIN_TRY(spin_alloc(plane, 3, (void **)&rgb));
    for (size_t i = 0; i < plane; i++) {
        for (size_t c = 0; c < 3; c++)
            rgb[3 * i + c] = to_byte(image[c * plane + i]);
    }
    status = spin_image_write(path, width, height, rgb, sync);
    free(rgb);
    return status;
}
