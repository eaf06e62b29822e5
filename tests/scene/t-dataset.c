/* views: order, split, size, pairing with a clip, pixels; choosing an importer.  K: views */

#include <time.h>

#include "base/err.h"
#include "base/log.h"
#include "base/mem.h"
#include "base/number.h"
#include "geometry/camera_rig.h"
#include "io/image.h"
#include "scene/probe.h"
#include "scene/dataset.h"
#include "scene/image_cache.h"
#include "tests/check.h"
#include "tests/tap.h"

static const struct spin_camera camera = {.width = 9,
                                          .height = 5,
                                          .fx = 10,
                                          .fy = 11,
                                          .cx = 4,
                                          .cy = 2,
                                          .w2c = {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0}};

/* n_rows frames of three cameras; camera 2 is held out; row r has number first + r, or none. */
static void make_views(struct spin_views *views, int n_rows, int first)
{
    memset(views, 0, sizeof *views);
    for (int r = 0; r < n_rows; r++) {
        for (int c = 0; c < 3; c++) {
            struct spin_view v = {
                .camera = camera, .dataset_frame = r, .camera_id = c, .test = c == 2};

            v.number = first < 0 ? -1 : first + r;
            v.camera.w2c[3] = c; /* centres at 0, -1, -2 along x */
            v.path = (char[]){"none.png"};
            if (spin_views_add(views, &v) != SPIN_OK)
                exit(1);
        }
    }
    views->n_dataset_frames = n_rows;
    views->numbered = first >= 0;
}

static void make_meta(struct spin_bundle_meta *meta, int n, int n_source, int first, int step)
{
    memset(meta, 0, sizeof *meta);
    if (spin_bundle_meta_reserve(meta, n) != SPIN_OK)
        exit(1);
    for (int i = 0; i < n; i++) {
        meta->frame[i].number = (first < 0 ? 0 : first) + step * i;
        meta->source_index[i] = step * i;
    }
    meta->n_source_frames = n_source;
    meta->numbered = first >= 0;
}

/* Clip of n frames (of n_source) numbered from `clip`, data set of 6 rows numbered from `data`; -1:
 * no numbers. want: row of the last frame, or -1 for an error with `word` in it. */
static void test_pair(int n, int n_source, int clip, int step, int data, const char *pair, int want,
                      const char *word, const char *what)
{
    struct spin_views views;
    struct spin_bundle_meta meta;
    int rows[16];
    spin_status status;
    bool good;

    make_views(&views, 6, data);
    make_meta(&meta, n, n_source, clip, step);
    status = spin_views_pair(&views, &meta, pair, rows);
    good = want < 0 ? status == SPIN_E_USAGE && strstr(spin_last_error(), word)
                    : status == SPIN_OK && rows[n - 1] == want;
    ok(good, "%s", what);
    if (!good)
        printf("#   status %d, %s\n", status, status == SPIN_OK ? "paired" : spin_last_error());
    spin_bundle_meta_free(&meta);
    spin_views_free(&views);
}

/* A clip of one frame with a data set of 4 frames with one image each: of 4 cameras, or of one. */
static void test_still(void)
{
    struct spin_views views = {0};
    struct spin_bundle_meta meta;
    int row = -1;

    for (int moving = 0; moving < 2; moving++) {
        spin_status status;

        for (int i = 0; i < 4; i++)
            if (spin_views_add(&views, &(struct spin_view){.dataset_frame = i,
                                                           .number = i,
                                                           .time = i,
                                                           .camera_id = moving ? 0 : 3 - i,
                                                           .test = i == 3,
                                                           .path = (char[]){"x.png"}}) != SPIN_OK)
                exit(1);
        views.n_dataset_frames = 4;
        views.numbered = true;
        make_meta(&meta, 1, 1, 2, 1);
        status = spin_views_pair(&views, &meta, moving ? "auto" : "order", &row);
        if (moving)
            ok(status == SPIN_OK && row == 2 && views.n_dataset_frames == 4,
               "one camera that moves: the clip is paired with one of its frames");
        else
            ok(status == SPIN_OK && row == 0 && views.n_dataset_frames == 1 &&
                   views.view[3].dataset_frame == 0 && views.view[0].camera_id == 0 &&
                   views.view[0].test && !views.view[1].test,
               "different cameras: all are views of the only frame");
        spin_bundle_meta_free(&meta);
        spin_views_free(&views);
    }
}

static void test_pairs(void)
{
    test_still();
    test_pair(6, 6, 122, 1, 122, "auto", 5, NULL, "both numbered: by number");
    test_pair(3, 6, 123, 2, 122, "auto", 5, NULL, "some frames of the clip: by number");
    test_pair(6, 6, 0, 1, 122, "auto", -1, "--pair order", "numbers that do not meet are an error");
    test_pair(6, 6, 0, 1, 122, "order", 5, NULL, "unless order is asked for");
    test_pair(6, 6, -1, 1, 122, "auto", 5, NULL, "one side without numbers: by order");
    test_pair(3, 6, -1, 2, 122, "auto", 4, NULL, "by the place in the whole source clip");
    test_pair(5, 5, -1, 1, 122, "auto", -1, "--pair order", "other counts are an error");
    test_pair(5, 5, -1, 1, 122, "order", 4, NULL, "unless order is asked for");
    test_pair(7, 7, -1, 1, 122, "order", -1, "6 frames", "there must be a row for each frame");
    test_pair(6, 6, -1, 1, 122, "number", -1, "--pair", "by number needs numbers of the clip");
    test_pair(6, 6, 1, 1, -1, "number", -1, "--pair", "and of the data set");
    test_pair(6, 6, 1, 1, 1, "colour", -1, "colour", "another word is an error");
}

static void test_split(void)
{
    struct spin_views views;
    const int cameras[] = {0, 2}, unknown[] = {0, 7}, other[] = {1};

    make_views(&views, 2, 0);
    ok(spin_views_split(&views, unknown, 2) == SPIN_E_USAGE && strstr(spin_last_error(), "7"),
       "an unknown camera is named");
    ok(!views.view[0].test, "and nothing has changed");
    ok(spin_views_split(&views, cameras, 2) == SPIN_OK && views.view[0].test &&
           !views.view[1].test && views.view[2].test && views.view[3].test,
       "cameras of the list are held out");
    ok(spin_views_split(&views, other, 1) == SPIN_OK && !views.view[0].test && views.view[1].test &&
           !views.view[2].test && !views.view[5].test,
       "and no others, whatever was before");
    spin_views_free(&views);
    make_views(&views, 1, 0);
    ok(spin_views_split(&views, cameras, 2) == SPIN_OK && views.view[0].test &&
           !views.view[1].test && views.view[2].test,
       "also a camera whose only view is the first");
    spin_views_free(&views);
}

static void test_scale(void)
{
    struct spin_views views;

    make_views(&views, 1, 0);
    ok(spin_views_scale(&views, 0.5) == SPIN_OK && views.view[0].camera.width == 5 &&
           views.view[0].camera.height == 3,
       "sizes are rounded");
    near(views.view[0].camera.fx, 10 * 5.0 / 9, 1e-12, "fx follows the real ratio");
    near(views.view[0].camera.cy, 2 * 3.0 / 5, 1e-12, "cy too");
    views.view[2].camera = (struct spin_camera){64, 48, 90, 45, 20, 33, {0}, 0};
    ok(spin_views_scale(&views, 0.3) == SPIN_OK && views.view[2].camera.width == 19 &&
           views.view[2].camera.height == 14,
       "64 x 48 pixels at 0.3: 19 x 14");
    near(fabs(views.view[2].camera.fx - 90 * 19.0 / 64) +
             fabs(views.view[2].camera.fy - 45 * 14.0 / 48) +
             fabs(views.view[2].camera.cx - 20 * 19.0 / 64) +
             fabs(views.view[2].camera.cy - 33 * 14.0 / 48),
         0, 1e-12, "a lens of two focal lengths, and a centre that is none");
    ok(spin_views_scale(&views, 0) == SPIN_E_USAGE &&
           spin_views_scale(&views, -1) == SPIN_E_USAGE &&
           spin_views_scale(&views, NAN) == SPIN_E_USAGE &&
           spin_views_scale(&views, 0.01) == SPIN_E_USAGE,
       "nothing is left at 0, -1, NaN or 0.01");
    near(spin_views_extent(&views), 1.1 * 0.5, 1e-12, "the extent is of the training cameras");
    spin_views_free(&views);
}

/* The centre of a camera that does not turn. */
static void stand_at(struct spin_view *view, double x) { view->camera.w2c[3] = -x; }

static void test_extent(void)
{
    struct spin_views views;
    double still;

    make_views(&views, 1, 0);
    stand_at(&views.view[0], 0.1);
    stand_at(&views.view[1], 0.7);
    still = spin_views_extent(&views);
    spin_views_free(&views);
    make_views(&views, 5, 0);
    for (size_t i = 0; i < views.n; i++)
        stand_at(&views.view[i], i % 3 == 0 ? 0.1 : i % 3 == 1 ? 0.7 : 50);
    ok(spin_views_extent(&views) == still, "cameras that stand still: the same bits as of a frame");
    stand_at(&views.view[3 * 4 + 2], 90);
    ok(spin_views_extent(&views) == still, "whatever a test camera does");
    stand_at(&views.view[3 * 2], 1.3);
    near(spin_views_extent(&views), 1.1 * 0.6, 1e-12, "where a camera goes counts as well, once");
    spin_views_free(&views);

    make_views(&views, 4, 0);
    for (size_t i = 0; i < views.n; i++) {
        views.view[i].test = views.view[i].camera_id > 0;
        stand_at(&views.view[i], (double)views.view[i].dataset_frame);
    }
    near(spin_views_extent(&views), 1.1 * 1.5, 1e-12, "one camera that moves has an extent");
    for (size_t i = 0; i < views.n; i++)
        stand_at(&views.view[i], 3);
    near(spin_views_extent(&views), 0, 0, "one camera in one place has none");
    for (size_t i = 0; i < views.n; i++) {
        views.view[i].test = true;
        stand_at(&views.view[i], views.view[i].camera_id);
    }
    near(spin_views_extent(&views), 1.1, 1e-12, "without training cameras it is that of all");
    spin_views_free(&views);
}

static char warned[512];
static bool keep_line(const char *line)
{
    snprintf(warned, sizeof warned, "%s", line);
    return true;
}

/* A wall before the cameras, in these units, with one splat of so many close to them. */
static double near_of(float unit, size_t close_one_in, float close)
{
    enum { N = 4000 };
    static float points[3 * N];
    struct spin_views views;
    double z_near;

    make_views(&views, 30, 0);
    for (size_t i = 0; i < views.n; i++)
        views.view[i].camera.w2c[3] = 0;
    for (size_t i = 0; i < N; i++) {
        points[3 * i] = points[3 * i + 1] = 0;
        points[3 * i + 2] = unit * (i % close_one_in == 0 ? close : 4);
    }
    ok(spin_views_set_near(&views, points, N, true) == SPIN_OK, "is set");
    z_near = spin_camera_near(&views.view[0].camera);
    for (size_t i = 0; i < views.n; i++)
        ok(spin_camera_near(&views.view[i].camera) == z_near, "one near plane for all cameras");
    spin_views_free(&views);
    return z_near;
}

/* Three views of n points, of which the first n_close are close to the cameras: as close as 0.3,
 * 0.1 and 0.2 of these units. A fourth view, behind the others in memory, does not belong to them.
 * If `cut` is set, the near plane of view 2 is behind the close points. */
static double near_of_three(size_t n, size_t n_close, float unit, bool cut)
{
    static const double close[4] = {0.3, 0.1, 0.2, 0.4};
    float points[300] = {0};
    struct spin_views views;
    double z_near;

    make_views(&views, 2, 0);
    for (size_t i = 0; i < n; i++)
        points[3 * i + 2] = unit * (i < n_close ? 0 : 4);
    for (size_t i = 0; i < 4; i++) {
        views.view[i].camera.w2c[3] = 0;
        views.view[i].camera.w2c[11] = (double)unit * close[i];
    }
    views.view[2].camera.z_near = cut ? (double)unit : 0;
    views.view[3].camera.z_near = 9 * (double)unit;
    views.n = 3;
    *warned = '\0';
    ok(spin_views_set_near(&views, points, n, true) == SPIN_OK &&
           views.view[3].camera.z_near == 9 * (double)unit,
       "%zu of %zu points are close", n_close, n);
    z_near = spin_camera_near(&views.view[0].camera);
    views.n = 6;
    spin_views_free(&views);
    return z_near;
}

static void test_near_views(void)
{
    near(near_of_three(38, 2, 1, false), 0.25 * 0.2, 1e-6,
         "the point behind the nearest 5 % counts, in the median view");
    near(near_of_three(40, 2, 1, false), SPIN_NEAR, 0, "which are two of 40, or one of 38");
    near_of_three(100, 1, 100, true);
    ok(!*warned, "one point of a hundred may be cut off: %s", warned);
    near_of_three(99, 1, 100, true);
    ok(strstr(warned, "camera 2: 1 %") != NULL, "one of 99 may not: %s", warned);
}

/* A shifted camera sees a point where the unshifted one sees the shifted point. */
static void test_shift(void)
{
    const double shift[3] = {3, -7, 20};
    const float point[3] = {0.5f, 0.25f, 40}, moved[3] = {3.5f, -6.75f, 60};
    struct spin_views views;
    double want[2][3], got[3] = {0}, worst = 0;

    make_views(&views, 1, 0);
    for (int i = 0; i < 2; i++) {
        struct spin_camera *c = &views.view[i].camera;
        const double w[12] = {0.6, 0, -0.8, 1, 0, 1, 0, 2, 0.8, 0, 0.6, 3 + i};

        memcpy(c->w2c, w, sizeof w);
        c->cx = c->cy = 500;
        c->width = c->height = 1000;
        ok(spin_camera_project_visible(c, moved, want[i]), "visible");
    }
    spin_views_shift(&views, shift);
    for (int i = 0; i < 2; i++) {
        ok(spin_camera_project_visible(&views.view[i].camera, point, got), "visible");
        for (int c = 0; c < 3; c++)
            worst = larger(worst, fabs(got[c] - want[i][c]));
    }
    near(worst, 0, 1e-6, "cameras and points are shifted together");
    spin_views_free(&views);
}

/* docs/method.md 4.1 */
static void test_near(void)
{
    near(near_of(1, SIZE_MAX, 0), SPIN_NEAR, 0, "a scene of usual units: that of 3DGS");
    near(near_of(1000, SIZE_MAX, 0), SPIN_NEAR, 0, "and of large units");
    near(near_of(0.01f, SIZE_MAX, 0), 0.01, 1e-6, "of small units: a quarter of the depth");
    near(near_of(1, 200, 0.1f), SPIN_NEAR, 0, "a few floaters before the cameras change nothing");
    near(near_of(1, 10, 0.1f), 0.025, 1e-6, "a subject close to them does");
    spin_log_set_level(0);
    spin_log_set_sink(keep_line);
    near_of(1, 200, 0.1f);
    ok(warned[0] == '\0', "one splat in 200 is not worth a warning: %s", warned);
    near_of(1, 30, 0.1f);
    ok(strstr(warned, "camera 0: 3 % of the splats in its image are cut off") != NULL,
       "one in 30 is: %s", warned);
    test_near_views();
    spin_log_set_sink(NULL);
    spin_log_set_level(-1);
}

static void test_find(void)
{
    const struct spin_importer *found = NULL;

    ok(spin_importer_find("x", "ply", false, &found) == SPIN_OK && !strcmp(found->name, "ply"),
       "an importer is found by name");
    ok(spin_importer_find("x", "plyy", false, &found) == SPIN_E_USAGE &&
           strstr(spin_last_error(), "plyy") && strstr(spin_last_error(), "d3dgs"),
       "an unknown name is an error that lists the known ones");
    ok(spin_importer_find("x", "d3dgs", true, &found) == SPIN_E_USAGE &&
           strstr(spin_last_error(), "panoptic"),
       "one that reads no views is not for data sets");
    ok(spin_importer_find(check_folder(), NULL, false, &found) == SPIN_E_NOT_RECOGNISED &&
           strstr(spin_last_error(), "it is an empty folder"),
       "an empty folder is not recognised");
    ok(spin_importer_find("no/such/thing", NULL, false, &found) != SPIN_OK &&
           strstr(spin_last_error(), "no/such/thing"),
       "what does not exist is named");
}

/* ---- Pixels ---------------------------------------------------------------------------------- */

enum { W = 8, H = 4 };

static void error_is(spin_status got, spin_status want, const char *word, const char *what)
{
    ok(got == want && strstr(spin_last_error(), word), "%s", what);
}

static void test_pixels(void)
{
    struct spin_views views = {0};
    struct spin_view bad;
    struct spin_image_cache pixels, tight;
    struct spin_view v = {.camera = camera};
    uint8_t rgb[W * H * 3];
    float a[3 * W * H], b[3 * W * H];
    char path[300];

    if (spin_image_start() != SPIN_OK) {
        skip("pixels", spin_last_error());
        return;
    }
    for (int i = 0; i < W * H * 3; i++)
        rgb[i] = (uint8_t)(7 * i);
    snprintf(path, sizeof path, "%s/image.png", check_folder());
    ok(spin_image_write(path, W, H, rgb, false) == SPIN_OK, "writes an image");
    v.path = path;
    for (int i = 0; i < 4; i++) {
        v.camera.width = i == 1 ? W / 2 : i == 3 ? W + 3 : W;
        v.camera.height = i == 1 ? H / 2 : H;
        if (spin_views_add(&views, &v) != SPIN_OK)
            exit(1);
    }
    ok(spin_image_cache_open(&views, W * H * 3, NULL, &pixels) == SPIN_OK &&
           spin_image_cache_open(&views, 0, NULL, &tight) == SPIN_OK,
       "opens");
    ok(spin_image_cache_get(&pixels, 0, a) == SPIN_OK &&
           spin_image_cache_get(&tight, 0, b) == SPIN_OK,
       "decodes an image");
    near(a[W * H + 3], rgb[3 * 3 + 1] / 255.0, 1e-6, "green of the fourth pixel is in its plane");
    check_same_bits(a, b, sizeof a, "kept or not, it is the same");
    ok(pixels.held == W * H * 3 && tight.held == 0, "and kept only within the budget");
    ok(spin_image_cache_get(&pixels, 0, b) == SPIN_OK, "comes again");
    check_same_bits(a, b, sizeof a, "the same");
    ok(spin_image_cache_get(&pixels, 2, b) == SPIN_OK && pixels.held == W * H * 3 && !pixels.rgb[2],
       "what does not fit is not kept");
    ok(spin_image_cache_get(&tight, 1, b) == SPIN_OK, "reads at half the size");
    near(b[0], (a[0] + a[1] + a[W] + a[W + 1]) / 4, 0.6 / 255, "as the mean of four pixels");
    ok(spin_image_cache_get(&tight, 3, b) == SPIN_E_MALFORMED && strstr(spin_last_error(), path),
       "another shape is an error that names the image");
    for (int i = 0; i < 4; i++)
        views.view[i].camera_id = i;
    ok(spin_view_check_image(&views.view[0]) == SPIN_OK &&
           spin_view_check_image(&views.view[1]) == SPIN_OK,
       "its header has the camera's shape, at any size");
    error_is(spin_view_check_image(&views.view[3]), SPIN_E_MALFORMED, "camera 3: image",
             "another shape names the camera");
    error_is(spin_views_check_cameras(&views, false), SPIN_E_MALFORMED, "8 x 4 pixels",
             "it is found among all cameras");
    bad = views.view[3];
    views.view[3] = views.view[0];
    views.view[0] = bad;
    error_is(spin_views_check_cameras(&views, false), SPIN_E_MALFORMED, "8 x 4 pixels",
             "and before others");
    views.view[0] = views.view[3];
    views.view[3] = bad;
    views.view[3].camera_id = 0;
    ok(spin_views_check_cameras(&views, false) == SPIN_OK, "one image of a camera is looked at");
    views.view[0].path[0] = '?';
    error_is(spin_views_check_cameras(&views, false), SPIN_E_MALFORMED, "11 x 4",
             "the first that is there");
    error_is(spin_view_check_image(&views.view[0]), SPIN_E_NOT_FOUND, "camera 0: image '?",
             "one that is not there");
    spin_image_cache_close(&pixels);
    spin_image_cache_close(&tight);
    spin_views_free(&views);
}

/* ---- Reading ahead --------------------------------------------------------------------------- */

enum { N_AHEAD = 40, ROUNDS = 20 };

/* Writes an image whose bytes depend on k, and adds its view. */
static void add_numbered(struct spin_views *views, const char *folder, int k)
{
    struct spin_view v = {.camera = camera};
    uint8_t rgb[W * H * 3];
    char path[300];

    for (int i = 0; i < W * H * 3; i++)
        rgb[i] = (uint8_t)(31 * k + 7 * i);
    snprintf(path, sizeof path, "%s/ahead-%d.png", folder, k);
    v.path = path;
    v.camera.width = W;
    v.camera.height = H;
    if (spin_image_write(path, W, H, rgb, false) != SPIN_OK || spin_views_add(views, &v) != SPIN_OK)
        exit(1);
}

/* Reads all images in steps of `stride`, each announced `ahead` views before. Returns the number of
 * images with wrong bytes. */
static int read_announced(struct spin_image_cache *cache, size_t stride, size_t ahead)
{
    uint8_t rgb[W * H * 3];
    int wrong = 0;

    for (size_t i = 0; i < N_AHEAD; i++) {
        size_t view = i * stride % N_AHEAD;

        for (size_t k = 0; k < ahead; k++)
            spin_image_cache_announce(cache, (i + k) * stride % N_AHEAD);
        wrong += spin_image_cache_get_rgb8(cache, view, rgb) != SPIN_OK;
        for (size_t b = 0; b < sizeof rgb; b++)
            if (rgb[b] != (uint8_t)(31 * view + 7 * b)) {
                wrong++;
                break;
            }
    }
    return wrong;
}

static void test_ahead(void)
{
    const size_t image = W * H * 3, budgets[] = {4 * image, 7 * image, 100 * 4 * image};
    const size_t expected[] = {1, 1, 16};
    struct spin_views views = {0};
    struct spin_image_cache cache;
    const char *folder = check_folder();

    if (spin_image_start() != SPIN_OK) {
        skip("ahead", spin_last_error());
        return;
    }
    for (int k = 0; k < N_AHEAD; k++)
        add_numbered(&views, folder, k);
    for (int k = 0; k < 3; k++) {
        int wrong = 0;

        if (spin_image_cache_open(&views, budgets[k], NULL, &cache) != SPIN_OK ||
            spin_image_cache_read_ahead(&cache) != SPIN_OK)
            exit(1);
        ok(spin_image_cache_ahead(&cache) == expected[k], "%zu images are decoded ahead",
           expected[k]);
        for (int round = 0; round < ROUNDS; round++)
            wrong += read_announced(&cache, round % 2 ? 7 : 1, (size_t)(round % 5) * 5);
        ok(wrong == 0, "images decoded ahead are those that were requested");
        ok(cache.held + expected[k] * image <= cache.budget, "the budget includes them");
        spin_image_cache_announce(&cache, 3);
        spin_image_cache_close(&cache); /* while an image may be being decoded */
    }
    ok(spin_image_cache_open(&views, 3 * image, NULL, &cache) == SPIN_OK &&
           spin_image_cache_read_ahead(&cache) == SPIN_OK && spin_image_cache_ahead(&cache) == 0,
       "a budget of three images is too small to decode ahead");
    spin_image_cache_announce(&cache, 0);
    spin_image_cache_close(&cache);
    spin_views_free(&views);
}

/* Decodes a view to one byte, its number, and counts the views. */
static spin_status decode_number(void *context, size_t view, uint8_t **rgb)
{
    if (spin_alloc(1, 1, (void **)rgb) != SPIN_OK)
        return SPIN_E_MEMORY;
    **rgb = (uint8_t)view;
    __atomic_add_fetch((int *)context, 1, __ATOMIC_SEQ_CST);
    return SPIN_OK;
}

/* Threads decode an announced view without a request for it. */
static void test_threads_decode(void)
{
    struct spin_read_ahead *ahead;
    int n = 0;
    uint8_t *rgb;

    if (!ok(spin_read_ahead_start(2, 2, decode_number, &n, &ahead) == SPIN_OK, "threads start"))
        return;
    /* In the second round, the threads are waiting for an announcement. */
    for (int round = 1; round <= 2; round++) {
        spin_read_ahead_announce(ahead, 5);
        for (int i = 0; i < 500 && __atomic_load_n(&n, __ATOMIC_SEQ_CST) < round; i++)
            nanosleep(&(struct timespec){.tv_nsec = 10000000}, NULL);
        rgb = spin_read_ahead_take(ahead, 5);
        ok(n == round && rgb && *rgb == 5, "an announced view is decoded in the background");
        free(rgb);
        nanosleep(&(struct timespec){.tv_nsec = 100000000}, NULL);
    }
    ok(!spin_read_ahead_take(ahead, 5), "and taken once");
    ok(!spin_read_ahead_take(ahead, 6), "a view that was not announced is not there");
    spin_read_ahead_free(ahead);
}

/* An image that cannot be decoded ahead is reported when it is requested. */
static void test_ahead_missing(void)
{
    struct spin_views views = {0};
    struct spin_image_cache cache;
    uint8_t rgb[W * H * 3];
    const char *folder = check_folder();

    if (spin_image_start() != SPIN_OK)
        return;
    add_numbered(&views, folder, 0);
    add_numbered(&views, folder, 1);
    views.view[1].path[0] = '?';
    if (spin_image_cache_open(&views, 1 << 20, NULL, &cache) != SPIN_OK ||
        spin_image_cache_read_ahead(&cache) != SPIN_OK)
        exit(1);
    spin_image_cache_announce(&cache, 1);
    spin_image_cache_announce(&cache, 0);
    ok(spin_image_cache_get_rgb8(&cache, 0, rgb) == SPIN_OK, "the other image is read");
    error_is(spin_image_cache_get_rgb8(&cache, 1, rgb), SPIN_E_NOT_FOUND, "does not exist",
             "a missing image is reported when it is requested");
    spin_image_cache_close(&cache);
    spin_views_free(&views);
}

static void test_options(void)
{
    struct spin_views views;

    ok(spin_views_open(check_folder(), "colmap:a=1,b=2,c=3,d=4,e=5,f=6,g=7,h=8,i=9", &views, NULL,
                       0) == SPIN_E_USAGE &&
           strstr(spin_last_error(), "more than 8 options"),
       "nine options of a reader are one too many: %s", spin_last_error());
}

TAP_MAIN
{
    spin_log_set_level(-1);
    test_options();
    test_pairs();
    test_split();
    test_scale();
    test_extent();
    test_shift();
    test_near();
    test_find();
    test_pixels();
    test_ahead();
    test_threads_decode();
    test_ahead_missing();
}
