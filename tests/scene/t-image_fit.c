/* K: image */
#include "base/err.h"
#include "io/image.h"
#include "tests/check.h"
#include "tests/tap.h"

enum { W = 12, H = 6 };
static uint8_t source[H][W][3];

/* The average over the area of an output pixel, by sampling it finely: 60 divides by every size
 * used here, so the samples hit every overlap evenly. */
static double area_average(int x, int y, int width, int height, int c)
{
    enum { FINE = 60 };
    double sum = 0;

    for (int j = 0; j < FINE; j++) {
        for (int i = 0; i < FINE; i++)
            sum += source[(int)((y + (j + 0.5) / FINE) * H / height)]
                         [(int)((x + (i + 0.5) / FINE) * W / width)][c];
    }
    return sum / (FINE * FINE) / 255;
}

static void test_size(const char *path, int width, int height)
{
    float *out = calloc((size_t)(width * height * 3), sizeof *out);
    double worst = 0;
    char what[64];

    snprintf(what, sizeof what, "area average at %d x %d", width, height);
    if (!ok(spin_image_load(path, width, height, NULL, out) == SPIN_OK, "loads at %d x %d", width,
            height))
        return;
    for (int c = 0; c < 3; c++) {
        for (int y = 0; y < height; y++) {
            for (int x = 0; x < width; x++)
                worst = larger(worst, fabs(out[(c * height + y) * width + x] -
                                           area_average(x, y, width, height, c)));
        }
    }
    near(worst, 0, 1e-6, what);
    free(out);
}

static void test_save(const char *path)
{
    /* [3][1][4]: below, above, halves, not a number */
    static const float image[12] = {-1,   2,        0.5f, NAN,  0, 1,
                                    0.2f, INFINITY, 0.1f, 0.9f, 1, -INFINITY};
    static const uint8_t want[12] = {0, 0, 26, 255, 255, 230, 128, 51, 255, 0, 255, 0};
    int w = 0, h = 0;
    uint8_t *rgb = NULL;

    ok(spin_image_save(path, 4, 1, image, false) == SPIN_OK, "saves");
    if (ok(spin_image_read(path, NULL, &w, &h, &rgb) == SPIN_OK && w == 4 && h == 1,
           "reads it back"))
        check_same_bits(rgb, want, sizeof want, "clamped and rounded");
    free(rgb);
}

TAP_MAIN
{
    char path[4096], other[4096];
    const char *folder = check_folder();
    float pixel[3];

    if (spin_image_start() != SPIN_OK) {
        skip("images", spin_last_error());
        return;
    }
    snprintf(path, sizeof path, "%s/a.png", folder);
    snprintf(other, sizeof other, "%s/b.png", folder);
    for (int i = 0; i < W * H * 3; i++)
        ((uint8_t *)source)[i] = (uint8_t)(i * i * 31 + i * 7);
    ok(spin_image_write(path, W, H, &source[0][0][0], false) == SPIN_OK, "writes the source");
    test_size(path, W, H);
    test_size(path, 6, 3);
    test_size(path, 4, 2);
    test_size(path, 5, 4);
    test_size(path, 1, 1);
    test_size(path, 24, 12);
    test_save(other);
    ok(spin_image_load("no/such.png", 1, 1, NULL, pixel) == SPIN_E_NOT_FOUND &&
           strstr(spin_last_error(), "no/such.png"),
       "names a missing image");
}
