/* Dynamic regions: a square that moves over a static image is found exactly, from images and from
 * masks; missing input is an error.
 * K: eval moving */
#include "eval/metrics.h"

#include "spin_run.h"
#include "base/mem.h"
#include "io/image.h"
#include "scene/dataset.h"
#include "scene/image_cache.h"
#include "tests/check.h"
#include "tests/tap.h"

enum { W = 40, H = 30, ROWS = 5, SIDE = 6, PLANE = W * H };

static struct spin_views views;
static const char *folder;
static const float black[3];

/* The wall: a ramp, different in each channel. */
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

/* One camera with masks, one without, and one that moves. */
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

/* Number of wrong mask pixels. The expected mask is the square dilated by a diamond of `grown`
 * pixels: before the rule dilates, it drops the corners of the square, which have too few changed
 * neighbours. */
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
                image[i] = 0.5f; /* not used: the mask was kept */
            if (spin_dynamic_mask_find(&m, pair[row].view, image, &n) != SPIN_OK)
                exit(1);
            wrong += wrong_pixels(&m, row, grown);
        }
    ok(wrong == 0, "%s: and again when what is found is kept", what);
    ok(sum > 0 && sum <= ROWS * (SIDE + 2) * (SIDE + 2), "%s: %zu pixels move", what, sum);
    spin_dynamic_mask_close(&m);
    spin_image_cache_close(&pixels);
}

/* A block of 3 x 3 pixels that is brighter than the median by `more` of 255 in one channel. */
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

/* ---- Masks of another size, edges, long clips ------------------------------------------------ */

/* Random numbers that are the same on every machine. */
static unsigned drawn(unsigned *seed)
{
    *seed = *seed * 1664525u + 1013904223u;
    return *seed >> 16;
}

/* A view of W + 1 x H pixels with a mask of w x h, which is sampled at the pixel centres. The upper
 * half of the mask is empty, except its corner. most: its largest value; 1: zeros and ones. */
static void check_mask_size(int w, int h, unsigned most)
{
    enum { WIDE = W + 1 };
    static uint8_t rgb[3 * 100 * 100];
    struct spin_views odd = {0};
    struct spin_view v = {.camera = {.width = WIDE, .height = H, .fx = 30, .fy = 20}};
    struct spin_pair pair = {0, 0};
    struct spin_image_cache pixels;
    struct spin_dynamic_mask m;
    char path[600], picture[600];
    unsigned seed = 7;
    size_t n = 0, want = 0;
    int wrong = 0;

    for (int i = 0; i < w * h; i++)
        memset(rgb + 3 * i, i < w * h / 2 ? 0 : (int)(drawn(&seed) % (most + 1)), 3);
    memset(rgb, (int)most, 3);
    snprintf(path, sizeof path, "%s/size_%d_%d_%u.png", folder, w, h, most);
    snprintf(picture, sizeof picture, "%s/0_0.png", folder);
    v.mask = path;
    v.path = picture;
    if (spin_image_write(path, w, h, rgb, false) != SPIN_OK ||
        spin_views_add(&odd, &v) != SPIN_OK ||
        spin_image_cache_open(&odd, 0, black, &pixels) != SPIN_OK ||
        spin_dynamic_mask_open(&odd, &pixels, SPIN_DYNAMIC_AUTO, &pair, 1, &m) != SPIN_OK ||
        spin_dynamic_mask_keep(&m) != SPIN_OK)
        exit(1);
    for (int round = 0; round < 2; round++) { /* computed, then kept: 41 x 30 bits end within a
                                               * byte */
        ok(spin_dynamic_mask_find(&m, 0, NULL, &n) == SPIN_OK && m.from == SPIN_DYNAMIC_MASKS,
           "a mask of %d x %d, values to %u", w, h, most);
        want = 0;
        for (int y = 0; y < H; y++)
            for (int x = 0; x < WIDE; x++) {
                int column = (int)floor((x + 0.5) / WIDE * w), row = (int)floor((y + 0.5) / H * h);
                int moves = rgb[3 * (row * w + column)] >= (most == 1 ? 1 : 128);

                wrong += m.mask[y * WIDE + x] != moves;
                want += (size_t)moves;
            }
    }
    ok(wrong == 0 && n == want && want > 0, "is looked up at the pixels' middles: %zu of %zu", n,
       want);
    spin_dynamic_mask_close(&m);
    spin_image_cache_close(&pixels);
    spin_views_free(&odd);
}

/* The rule applied to noise; the reference uses an image with a margin of zeros. */
static void check_edges(int width, int height)
{
    static float image[3 * 400];
    static uint8_t median[3 * 400], scratch[400], mask[400];
    uint8_t changed[22][22] = {{0}}, kept[22][22] = {{0}};
    size_t plane = (size_t)(width * height);
    unsigned seed = 3;
    int wrong = 0;

    for (size_t i = 0; i < plane; i++) {
        bool change = drawn(&seed) % 9 < 4;
        size_t c = drawn(&seed) % 3;

        for (size_t k = 0; k < 3; k++) {
            median[3 * i + k] = 120;
            image[k * plane + i] = (float)(120 + (change && k == c ? 30 : 5)) / 255;
        }
        changed[i / (size_t)width + 1][i % (size_t)width + 1] = change;
    }
    spin_dynamic_mask_rule(width, height, image, median, scratch, mask);
    for (int y = 1; y <= height; y++)
        for (int x = 1; x <= width; x++) {
            int friends = -changed[y][x];

            for (int k = 0; k < 9; k++)
                friends += changed[y + k / 3 - 1][x + k % 3 - 1];
            kept[y][x] = changed[y][x] && friends >= 4;
        }
    for (int y = 1; y <= height; y++)
        for (int x = 1; x <= width; x++) {
            int any = 0;

            for (int k = 0; k < 9; k++)
                any |= kept[y + k / 3 - 1][x + k % 3 - 1];
            wrong += mask[(y - 1) * width + x - 1] != any;
        }
    ok(wrong == 0, "noise of %d x %d pixels: what has four friends, grown by one, to the edges",
       width, height);
}

/* One camera over n frames; `change` alters its view of frame n / 2. */
static size_t chosen_of(int n, void (*change)(struct spin_camera *), size_t *chosen)
{
    struct spin_views clip = {0};
    size_t k;

    for (int f = 0; f < n; f++)
        for (int camera = 0; camera < 2; camera++) {
            struct spin_view v = {.dataset_frame = f, .camera_id = camera, .path = (char *)"none"};

            v.camera =
                (struct spin_camera){64, 48, 70, 55, 20, 33, {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1}, 0};
            if (change && camera == 1 && f == n / 2)
                change(&v.camera);
            if (spin_views_add(&clip, &v) != SPIN_OK)
                exit(1);
        }
    k = spin_moving_views(&clip, 1, chosen);
    spin_views_free(&clip);
    return k;
}

static void by_a_hair(struct spin_camera *c) { c->w2c[3] += 5e-5; }
static void by_a_step(struct spin_camera *c) { c->w2c[7] += 2e-3; }
static void by_focus(struct spin_camera *c) { c->fy += 1; }
static void by_shift(struct spin_camera *c) { c->cy -= 1; }
static void by_height(struct spin_camera *c) { c->height -= 1; }

/* A median uses at most 25 frames, spread evenly from the first to the last. */
static void check_long_clips(void)
{
    static void (*const moves[])(struct spin_camera *) = {by_a_step, by_focus, by_shift, by_height};
    static const char *const name[] = {"its place", "its focal length", "its centre", "its size"};
    size_t chosen[SPIN_MOVING_ROWS];

    for (int n = 24; n < 500; n += n < 28 ? 1 : 71) {
        size_t k = chosen_of(n, NULL, chosen),
               most = n < SPIN_MOVING_ROWS ? (size_t)n : SPIN_MOVING_ROWS;
        bool even = k == most;

        for (size_t i = 0; i < k; i++) /* view 2 f + 1 belongs to frame f */
            even =
                even && chosen[i] == 2 * (size_t)ceil((double)i * (n - 1) / (double)(most - 1)) + 1;
        ok(even, "of %d frames %zu, evenly, with the first and the last", n, most);
    }
    ok(chosen_of(9, by_a_hair, chosen) == 9, "a camera that trembles stands still");
    for (size_t i = 0; i < 4; i++)
        ok(chosen_of(9, moves[i], chosen) == 0, "one that changes %s does not", name[i]);
}

/* Four grey images: the median is the upper of the two middle values. If only some views have
 * masks, the images are used. */
static void check_few_frames(void)
{
    static const float grey[4] = {0.2f, 0.4f, 0.6f, 0.8f};
    static float image[3 * PLANE];
    struct spin_views clip = {0};
    struct spin_pair pair[4];
    struct spin_image_cache pixels;
    struct spin_dynamic_mask m;
    char path[600], mask[600];

    snprintf(mask, sizeof mask, "%s/mask_0.png", folder);
    for (int f = 0; f < 4; f++) {
        struct spin_view v = {.dataset_frame = f, .path = path, .mask = f < 3 ? mask : NULL};

        v.camera = (struct spin_camera){W, H, 30, 30, 20, 15, {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1}, 0};
        snprintf(path, sizeof path, "%s/grey_%d.png", folder, f);
        for (size_t i = 0; i < 3 * PLANE; i++)
            image[i] = grey[f];
        if (spin_image_save(path, W, H, image, false) != SPIN_OK ||
            spin_views_add(&clip, &v) != SPIN_OK)
            exit(1);
        pair[f] = (struct spin_pair){f, (size_t)f};
    }
    if (spin_image_cache_open(&clip, 0, black, &pixels) != SPIN_OK)
        exit(1);
    ok(spin_dynamic_mask_open(&clip, &pixels, SPIN_DYNAMIC_MASKS, pair, 4, &m) == SPIN_E_NOT_FOUND,
       "masks for some views only: %s", spin_last_error());
    ok(spin_dynamic_mask_open(&clip, &pixels, SPIN_DYNAMIC_AUTO, pair, 4, &m) == SPIN_OK &&
           m.from == SPIN_DYNAMIC_IMAGES,
       "the images serve");
    for (size_t f = 0; f < 4; f++) {
        size_t n = 0;

        ok(spin_dynamic_mask_find(&m, f, NULL, &n) == SPIN_OK && n == (f == 2 ? 0 : PLANE),
           "frame %zu of four: %zu pixels move", f, n);
    }
    spin_dynamic_mask_close(&m);
    spin_image_cache_close(&pixels);
    spin_views_free(&clip);
}

/* Bits that were set before are cleared. */
static void check_bits(void)
{
    uint8_t mask[13] = {1, 0, 0, 1, 1, 0, 0, 0, 0, 1, 0, 0, 1}, bits[2] = {255, 255};
    struct spin_dynamic_mask m = {.mask = mask};

    spin_dynamic_mask_bits(&m, 13, bits);
    ok(bits[0] == 1 + 8 + 16 && bits[1] == 2 + 16, "13 pixels are 13 bits, lowest first");
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
    check_mask_size(80, 60, 255);
    check_mask_size(13, 50, 1);
    check_mask_size(7, 5, 255);
    check_mask_size(W + 1, H, 255);
    check_edges(20, 17);
    check_edges(5, 3);
    check_edges(2, 9);
    check_long_clips();
    check_few_frames();
    check_bits();
    check_means();
    spin_views_free(&views);
}
