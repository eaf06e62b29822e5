/* Static places whose appearance changes, as opposed to objects that pass in front of them.
 * K: tracks appearance */
#include "train/tracks.h"

#include "tests/check.h"
#include "tests/tap.h"

enum { FRAMES = 5, CAMERAS = 3, W = 32, H = 16 };
static struct spin_view view[FRAMES * CAMERAS];
static struct spin_pair pair[FRAMES * CAMERAS];
static int camera_ids[CAMERAS] = {2, 5, 7};
static struct spin_plan plan;
static struct spin_photos photos;

/* Cameras on the z axis that look along it; each sees [-2, 2] x [-1, 1] at z = 0 with 8 pixels
 * per unit, the last one the right half only. All pixels are grey. */
static void open_views(void)
{
    for (int f = 0; f < FRAMES; f++)
        for (int c = 0; c < CAMERAS; c++) {
            int i = f * CAMERAS + c;
            struct spin_view *v = &view[i];

            v->camera = (struct spin_camera){.width = W,
                                             .height = H,
                                             .fx = 8,
                                             .fy = 8,
                                             .cx = c == CAMERAS - 1 ? 0 : W / 2,
                                             .cy = H / 2,
                                             .w2c = {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 1}};
            v->camera_id = camera_ids[c];
            pair[i] = (struct spin_pair){f, (size_t)i};
        }
    plan.clip.views = (struct spin_views){.view = view, .n = FRAMES * CAMERAS};
    plan.clip.n_frames = FRAMES;
    plan.camera = camera_ids;
    plan.n_cameras = CAMERAS;
    plan.train = pair;
    plan.n_train = FRAMES * CAMERAS;
    plan.max_pixels = (size_t)W * H;
    if (spin_image_cache_open(&plan.clip.views, 1 << 20, NULL, &photos.cache) != SPIN_OK)
        exit(1);
    for (int i = 0; i < FRAMES * CAMERAS; i++) {
        photos.cache.rgb[i] = malloc((size_t)3 * W * H);
        memset(photos.cache.rgb[i], 100, (size_t)3 * W * H);
    }
}

/* The 3x3 pixels around (x, y), y = 0, of one view. */
static void paint(int frame, int c, double x, int grey)
{
    const struct spin_camera *camera = &view[frame * CAMERAS + c].camera;
    uint8_t *rgb = photos.cache.rgb[frame * CAMERAS + c];
    int at = (int)(8 * x + camera->cx);

    for (int j = -1; j <= 1; j++)
        for (int i = -3; i < 6; i++)
            rgb[3 * ((H / 2 + j) * W + at) + i] = (uint8_t)grey;
}

TAP_MAIN
{
    enum { SHADOW, PASSING, LEFT, FAINT, STILL, BEHIND, N };
    static const float place[N][3] = {{1.5f, 0, 0}, {1, 0, 0},     {-1, 0, 0},
                                      {0.5f, 0, 0}, {-1.7f, 0, 0}, {0, 0, -3}};
    uint8_t varies[N];

    open_views();
    for (int c = 0; c < CAMERAS;
         c++) { /* all cameras see it; one of them has shown the change for most of the clip */
        paint(3, c, 1.5, 80);
        paint(2, c, 0.5, 104);
    }
    paint(1, 0, 1, 200); /* one of three shows it */
    paint(1, 0, -1, 60); /* two cameras see the place, and both show it */
    paint(1, 1, -1, 60);
    ok(spin_appearance_varies(&plan, &photos, N, place[0], varies) == SPIN_OK,
       "looks at places: %s", spin_last_error());
    ok(varies[SHADOW] == 1, "what all cameras see in one frame changes");
    ok(varies[PASSING] == 0, "what one of three sees passes in front");
    ok(varies[LEFT] == 1, "cameras that do not see the place have no voice");
    ok(varies[FAINT] == 0, "four levels of 255 are noise");
    ok(varies[STILL] == 0 && varies[BEHIND] == 0, "nor does what nobody sees change");
    paint(1, 1, -1, 100);
    ok(spin_appearance_varies(&plan, &photos, N, place[0], varies) == SPIN_OK && varies[LEFT] == 0,
       "one of two cameras is not enough");
    paint(1, 1, 1, 200);
    ok(spin_appearance_varies(&plan, &photos, N, place[0], varies) == SPIN_OK &&
           varies[PASSING] == 1,
       "two of three are");
    for (int f = 0; f < FRAMES; f++) { /* cameras may differ from each other in all frames */
        paint(f, 0, -1.7, 220);
        paint(f, 1, -1.7, 50);
    }
    for (int c = 0; c < 2; c++) { /* two have the place beside and behind them for a frame each */
        view[3 * CAMERAS + c].camera.w2c[3] = -1;
        view[4 * CAMERAS + c].camera.w2c[11] = -1;
    }
    ok(spin_appearance_varies(&plan, &photos, N, place[0], varies) == SPIN_OK && varies[STILL] == 0,
       "each camera is compared with itself, where it sees the place");
    spin_image_cache_close(&photos.cache);
}
