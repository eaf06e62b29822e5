/* Mattes of images: pixels around a subject are empty, those inside and beside it are unknown, and
 * files with alpha say it themselves.
 * K: eval matte alpha */
#include "eval/matte.h"

#include "io/image.h"
#include "tests/check.h"
#include "tests/tap.h"

enum { W = 40, H = 30, PLANE = W * H };

static const char *folder;

static void need(spin_status status)
{
    if (status != SPIN_OK) {
        ok(false, "%s", spin_last_error());
        exit(tap_done());
    }
}

/* A square subject from 10 to 24 in both directions, with a hole from 14 to 19. */
static bool is_inside(int x, int y, int first, int last)
{
    return x >= first && x <= last && y >= first && y <= last;
}

static uint8_t at(const uint8_t *matte, int x, int y) { return matte[y * W + x]; }

static void test_colours(void)
{
    static const uint8_t grey[3] = {40, 50, 60};
    uint8_t rgb[3 * PLANE], matte[PLANE];

    for (int i = 0; i < 3 * PLANE; i++) {
        int x = i / 3 % W, y = i / 3 / W;
        bool subject = is_inside(x, y, 10, 24) && !is_inside(x, y, 14, 19);

        rgb[i] = (uint8_t)(subject ? 200 : grey[i % 3] + i % 5 - 2);
    }
    need(spin_matte_of_colours(W, H, rgb, grey, matte));
    ok(at(matte, 0, 0) == 1 && at(matte, W - 1, H - 1) == 1 && at(matte, 7, 12) == 1 &&
           at(matte, 12, 27) == 1,
       "pixels that have the background colour, with noise, are empty");
    ok(at(matte, 8, 12) == 0 && at(matte, 26, 12) == 0 && at(matte, 12, 26) == 0,
       "up to two pixels from the subject");
    ok(at(matte, 12, 12) == 0, "the subject is unknown");
    ok(at(matte, 16, 16) == 0, "and so is a hole in it");
    rgb[3 * (5 * W + 5) + 1] = 57;
    need(spin_matte_of_colours(W, H, rgb, grey, matte));
    ok(at(matte, 7, 7) == 0 && at(matte, 8, 5) == 1, "a pixel of another colour is not empty");
}

/* Writes an image of three views: a subject of alpha 0.5 and 1 or, without alpha, a white one, in
 * front of a level of grey. */
static void write_views(struct spin_views *views, bool alpha, float level)
{
    static float image[3 * PLANE], cover[PLANE];

    for (int i = 0; i < 3 * PLANE; i++) {
        int x = i % PLANE % W, y = i % PLANE / W;

        cover[i % PLANE] = is_inside(x, y, 14, 19) ? 0.5f : is_inside(x, y, 10, 24);
        image[i] = cover[i % PLANE] + (1 - cover[i % PLANE]) * (alpha ? 0 : level);
    }
    for (int k = 0; k < 3; k++) {
        char path[600];
        struct spin_view v = {.camera_id = k, .path = path};
        struct spin_film film = {.width = W, .height = H, .image = image, .bits = 8};

        v.camera = (struct spin_camera){.width = W, .height = H, .fx = 30, .fy = 30};
        snprintf(path, sizeof path, "%s/%d%d.png", folder, alpha, k);
        film.alpha = alpha ? cover : NULL;
        need(spin_film_write(path, &film, false));
        need(spin_views_add(views, &v));
    }
}

static void find(bool alpha, float level, const float background[3], uint8_t *matte, bool *found,
                 size_t *held)
{
    struct spin_views views = {0};
    struct spin_image_cache images;
    struct spin_pair pairs[3] = {{0, 0}, {0, 1}, {0, 2}};
    struct spin_mattes mattes;
    enum spin_surroundings surroundings;
    uint8_t again[PLANE];

    write_views(&views, alpha, level);
    need(spin_image_cache_open(&views, 8 * PLANE, background, &images));
    need(spin_mattes_open(&views, &images, pairs, 3, &mattes, &surroundings));
    *found = mattes.views != NULL;
    ok(surroundings == (alpha ? SPIN_SURROUNDED_BY_ALPHA : SPIN_SURROUNDED_BY_COLOUR),
       "the surroundings are %s", alpha ? "transparent" : "of one colour");
    for (size_t k = 0; *found && k < 3; k++) {
        need(spin_mattes_find(&mattes, k, matte));
        need(spin_mattes_find(&mattes, k, again));
        ok(memcmp(matte, again, PLANE) == 0, "the matte of view %zu is the same again", k);
    }
    *held = mattes.held;
    spin_mattes_close(&mattes);
    spin_image_cache_close(&images);
    spin_views_free(&views);
}

static void test_files(void)
{
    static const float white[3] = {1, 1, 1}, grey[3] = {0.3f, 0.3f, 0.3f};
    uint8_t matte[PLANE];
    bool found;
    size_t held;

    find(true, 0, NULL, matte, &found, &held);
    ok(found && held == 2 * PLANE, "mattes of files with alpha, as far as the budget allows");
    ok(at(matte, 0, 0) == 1 && at(matte, 11, 11) == 255 && abs(at(matte, 16, 16) - 128) <= 1,
       "are their alpha: empty, opaque, and in between");
    find(false, 0, NULL, matte, &found, &held);
    ok(found && at(matte, 0, 0) == 1 && at(matte, 11, 11) == 0 && at(matte, 16, 16) == 0,
       "without alpha, only the surroundings are known");
    find(false, 0.3f, NULL, matte, &found, &held);
    ok(!found, "a flat colour that is not the background has no mattes");
    find(false, 0.3f, white, matte, &found, &held);
    ok(!found, "also if the background is white");
    find(false, 0.3f, grey, matte, &found, &held);
    ok(found && at(matte, 0, 0) == 1 && at(matte, 11, 11) == 0,
       "one that is the background has them, though it is not black");
}

TAP_MAIN
{
    folder = check_folder();
    test_colours();
    test_files();
}
