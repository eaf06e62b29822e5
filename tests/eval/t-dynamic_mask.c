/* Moving regions: a square that wanders over a still picture is found to the pixel, from the images and
 * from masks; what cannot be found is said.
 * K: eval moving */
#include "eval/metrics.h"

#include "spin_run.h"
#include "base/mem.h"
#include "scene/dataset.h"
#include "scene/image_cache.h"
#include "tests/check.h"
#include "tests/tap.h"

enum { W = 40, H = 30, ROWS = 5, SIDE = 6, PLANE = W * H };

static struct spin_views views;
static const char *folder;
static const float black[3];

/* The wall: a ramp that every channel sees otherwise. */
static void draw_wall(float *image)
{
    for (size_t c = 0; c < 3; c++)
        for (size_t i = 0; i < PLANE; i++)
            image[c * PLANE + i] = 0.2f + 0.01f * (float)((i * (c + 1)) % 29);
}

static bool in_square(int row, int x, int y)
{
    int left = 7 * row;

    return x >= left && x < left + SIDE && y >= 10 && y < 10 + SIDE;
}

static void draw_square(float *image, int row, float value)
{
    for (int y = 0; y < H; y++)
        for (int x = 0; x < W; x++)
            for (int c = 0; c < 3; c++)
                if (in_square(row, x, y))
                    image[c * PLANE + y * W + x] = value;
}

/* One camera with masks for its first rows, one without, one that moves. */
static void make_views(void)
{
    static float image[3 * PLANE];

    for (int row = 0; row < ROWS; row++)
        for (int camera = 0; camera < 3; camera++) {
            char path[600], mask[600];
            struct spin_view v = {
                .dataset_frame = row, .number = row, .camera_id = camera, .path = path};

            v.camera = (struct spin_camera){.width = W, .height = H, .fx = 30, .fy = 30};
            v.camera.cx = W / 2.0;
            v.camera.cy = H / 2.0;
            v.camera.w2c[0] = v.camera.w2c[5] = v.camera.w2c[10] = 1;
            v.camera.w2c[3] = camera == 2 ? row : 0;
            snprintf(path, sizeof path, "%s/%d_%d.png", folder, camera, row);
            snprintf(mask, sizeof mask, "%s/mask_%d.png", folder, row);
            draw_wall(image);
            draw_square(image, row, 0.9f);
            image[W + 35] += row == 3 ? 0.5f : 0; /* a speck */
            if (spin_image_save(path, W, H, image, false) != SPIN_OK)
                exit(1);
            if (camera == 0) {
                memset(image, 0, sizeof image);
                draw_square(image, row, row % 2 ? 1.0f : 1.0f / 255);
                if (spin_image_save(mask, W, H, image, false) != SPIN_OK)
                    exit(1);
                v.mask = mask;
            }
            if (spin_views_add(&views, &v) != SPIN_OK)
                exit(1);
        }
}

/* Pixels of the mask that should not be as they are: the square is grown by
 * `grown` pixels, its corners stay (they have too few friends). */
static int wrong_pixels(const struct spin_dynamic_mask *m, int row, int grown)
{
    int wrong = 0;

    for (int y = 0; y < H; y++)
        for (int x = 0; x < W; x++) {
            bool want = false;

            for (int dy = -grown; dy <= grown; dy++)
                for (int dx = -grown; dx <= grown; dx++)
                    want = want || (abs(dx) + abs(dy) <= grown && in_square(row, x + dx, y + dy));
            wrong += m->mask[y * W + x] != want;
        }
    return wrong;
}

static void check_from(enum spin_dynamic_from from, int camera, int grown, const char *what)
{
    static float image[3 * PLANE];
    struct spin_pair pair[ROWS];
    struct spin_image_cache pixels;
    struct spin_dynamic_mask m;
    int wrong = 0;
    size_t n = 0, sum = 0;

    for (int row = 0; row < ROWS; row++)
        pair[row] = (struct spin_pair){row, (size_t)(3 * row + camera)};
    ok(spin_image_cache_open(&views, 0, black, &pixels) == SPIN_OK &&
           spin_dynamic_mask_open(&views, &pixels, from, pair, ROWS, &m) == SPIN_OK,
       "%s: opens", what);
    for (int row = 0; row < ROWS; row++) {
        if (spin_image_cache_get(&pixels, pair[row].view, image) != SPIN_OK ||
            spin_dynamic_mask_find(&m, pair[row].view, image, &n) != SPIN_OK)
            exit(1);
        wrong += wrong_pixels(&m, row, grown);
        sum += n;
    }
    ok(wrong == 0, "%s: every pixel of %d pictures is right", what, ROWS);
    if (spin_dynamic_mask_keep(&m) != SPIN_OK)
        exit(1);
    for (int round = 0; round < 2; round++)
        for (int row = 0; row < ROWS; row++) {
            if (round == 0 && spin_image_cache_get(&pixels, pair[row].view, image) != SPIN_OK)
                exit(1);
            for (size_t i = 0; round == 1 && i < 3 * PLANE; i++)
                image[i] = 0.5f; /* not looked at: it was found before */
            if (spin_dynamic_mask_find(&m, pair[row].view, image, &n) != SPIN_OK)
                exit(1);
            wrong += wrong_pixels(&m, row, grown);
        }
    ok(wrong == 0, "%s: and again when what is found is kept", what);
    ok(sum > 0 && sum <= ROWS * (SIDE + 2) * (SIDE + 2), "%s: %zu pixels move", what, sum);
    spin_dynamic_mask_close(&m);
    spin_image_cache_close(&pixels);
}

/* A block of 3 x 3 that is brighter than the median by so much of 255 in one channel. */
static size_t n_moving_by(int more)
{
    static float image[3 * PLANE];
    static uint8_t median[3 * PLANE], scratch[PLANE], mask[PLANE];
    size_t n = 0;

    memset(median, 100, sizeof median);
    for (size_t i = 0; i < 3 * PLANE; i++)
        image[i] = 100 / 255.0f;
    for (int y = 10; y < 13; y++)
        for (int x = 10; x < 13; x++)
            image[PLANE + y * W + x] = (float)(100 + more) / 255;
    spin_dynamic_mask_rule(W, H, image, median, scratch, mask);
    for (size_t i = 0; i < PLANE; i++)
        n += mask[i];
    return n;
}

static void check_threshold(void)
{
    ok(n_moving_by(19) == 0 && n_moving_by(-19) == 0, "19 of 255 is noise");
    ok(n_moving_by(22) > 8 && n_moving_by(-22) > 8, "22 of 255 is not");
}

static void check_refusals(void)
{
    struct spin_pair still = {0, 1}, wandering = {0, 2};
    struct spin_image_cache pixels;
    struct spin_dynamic_mask m;

    if (spin_image_cache_open(&views, 0, black, &pixels) != SPIN_OK)
        exit(1);
    ok(spin_dynamic_mask_open(&views, &pixels, SPIN_DYNAMIC_MASKS, &still, 1, &m) ==
           SPIN_E_NOT_FOUND,
       "no masks: %s", spin_last_error());
    ok(spin_dynamic_mask_open(&views, &pixels, SPIN_DYNAMIC_IMAGES, &wandering, 1, &m) ==
           SPIN_E_UNSUPPORTED,
       "a camera that moves: %s", spin_last_error());
    ok(spin_dynamic_mask_open(&views, &pixels, SPIN_DYNAMIC_AUTO, &wandering, 1, &m) == SPIN_OK &&
           m.from == SPIN_DYNAMIC_OFF,
       "and nothing is measured when nothing was asked for");
    spin_dynamic_mask_close(&m);
    ok(spin_dynamic_mask_open(&views, &pixels, SPIN_DYNAMIC_AUTO, &still, 1, &m) == SPIN_OK &&
           m.from == SPIN_DYNAMIC_IMAGES,
       "without masks the images serve");
    spin_dynamic_mask_close(&m);
    spin_image_cache_close(&pixels);
}

static void check_means(void)
{
    struct spin_eval_view view[3] = {
        {.frame = 1, .camera = 7, .q = {.valid = true, .psnr = 20, .psnr_dynamic = 10}},
        {.frame = 1, .camera = 8, .q = {.valid = true, .psnr = 30, .psnr_dynamic = NAN}},
        {.frame = 2, .camera = 7, .q = {.valid = true, .psnr = 40, .psnr_dynamic = 30}},
    };
    struct spin_eval_report r = {.view = view, .n_views = 3};
    int one = 1, seven = 7, nine = 9;

    near(spin_eval_mean(&r, NULL, NULL).psnr, 30, 1e-12, "mean over all views");
    near(spin_eval_mean(&r, &one, NULL).psnr, 25, 1e-12, "over a frame's");
    near(spin_eval_mean(&r, NULL, &seven).psnr, 30, 1e-12, "over a camera's");
    near(spin_eval_mean(&r, NULL, NULL).psnr_dynamic, 20, 1e-12, "only views that have it count");
    ok(!spin_eval_mean(&r, NULL, &nine).valid && isnan(spin_eval_mean(&r, NULL, &nine).psnr),
       "no view, no mean");
}

TAP_MAIN
{
    folder = check_folder();
    make_views();
    check_from(SPIN_DYNAMIC_AUTO, 0, 0, "masks");
    check_from(SPIN_DYNAMIC_IMAGES, 0, 1, "images of a camera with masks");
    check_from(SPIN_DYNAMIC_AUTO, 1, 1, "images");
    check_threshold();
    check_refusals();
    check_means();
    spin_views_free(&views);
}
