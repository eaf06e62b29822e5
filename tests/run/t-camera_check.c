/* Points over the images of cameras: colours, sizes, order in depth, and shares; which views.
 * K: check-cameras overlay */
#include "run/camera_check.h"

#include "io/image.h"
#include "scene/dataset.h"
#include "tests/check.h"
#include "tests/tap.h"

enum { W = 902, H = 6 }; /* squares have a radius of one pixel */

/* At pixel u, v and depth z; red, green and blue. */
struct point {
    double u, v, z, rgb[3];
};

static const struct point points[] = {
    {4.5, 2.5, 1, {1, 0, 0}},    /* in front of the next */
    {5.5, 3.5, 2, {0, 1, 0}},    /* whose lower right part is visible */
    {0.2, 0.2, 1, {0, 0, 2}},    /* clipped by two edges; too blue */
    {901.8, 5.8, 1, {1, 1, -1}}, /* and by the others */
    {902.2, 3, 1, {1, 1, 1}},    /* outside */
    {20, -0.2, 1, {1, 1, 1}},    /* outside */
    {20, 3, -1, {1, 1, 1}},      /* behind */
};
enum { N = sizeof points / sizeof *points };

/* Each square at a corner, its neighbours, and the pixels of points that are not drawn. */
enum { DARK = 0x5a5a5a };
static const struct {
    int x, y;
    unsigned colour;
} pixels[] = {{3, 1, 0xff0000}, {5, 3, 0xff0000},   {6, 3, 0x00ff00}, {5, 4, 0x00ff00},
              {6, 1, DARK},     {2, 2, DARK},       {1, 1, 0x0000ff}, {2, 0, DARK},
              {899, 5, DARK},   {900, 4, 0xffff00}, {10, 2, DARK},    {20, 0, DARK}};

/* Returns the colour of a pixel, as 0xrrggbb. */
static unsigned at(const uint8_t *rgb, int x, int y)
{
    const uint8_t *p = rgb + 3 * (y * W + x);

    return (unsigned)p[0] << 16 | (unsigned)p[1] << 8 | p[2];
}

static void check_overlay(void)
{
    static float image[3 * W * H];
    const float black[3] = {0};
    char path[600], out[600];
    struct spin_view view = {.path = path};
    struct spin_splats s = {0};
    struct spin_camera_overlay_share share;
    uint8_t *rgb = NULL;
    int width, height, wrong = 0;

    view.camera = (struct spin_camera){W, H, 10, 10, 3, 2, {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0}, 0};
    snprintf(path, sizeof path, "%s/image.png", check_folder());
    snprintf(out, sizeof out, "%s/out.png", check_folder());
    for (int i = 0; i < 3 * W * H; i++)
        image[i] = 200 / 255.0f;
    if (spin_image_save(path, W, H, image, false) != SPIN_OK)
        exit(1);
    for (int k = 0; k < 3; k++) {
        unsigned columns = SPIN_COL_MEANS | (k == 0 ? SPIN_COL_RGB : k == 1 ? SPIN_COL_SH : 0);

        if (spin_splats_reserve(&s, N, columns, 1) != SPIN_OK)
            exit(1);
        for (size_t i = 0; i < N; i++) {
            const struct point *p = &points[i];

            s.means[3 * i] = (float)((p->u - 3) / 10 * p->z);
            s.means[3 * i + 1] = (float)((p->v - 2) / 10 * p->z);
            s.means[3 * i + 2] = (float)p->z;
            for (size_t c = 0; c < 3 && k < 2; c++)
                (k ? s.sh : s.rgb)[(k ? 12 : 3) * i + c] =
                    (float)(k ? (p->rgb[c] - 0.5) / 0.28209479177387814 : p->rgb[c]);
        }
        if (!ok(spin_camera_overlay_draw(&view, &s, out, &share) == SPIN_OK &&
                    spin_image_read(out, black, &width, &height, &rgb) == SPIN_OK && width == W &&
                    height == H,
                "draws points with %s",
                k == 0   ? "colours"
                : k == 1 ? "SH"
                         : "neither"))
            exit(1);
        near(share.in_front, 6.0 / N, 1e-12, "all but one are in front");
        near(share.inside, 4.0 / N, 1e-12, "and four inside");
        for (size_t i = 0; i < sizeof pixels / sizeof *pixels; i++)
            wrong += at(rgb, pixels[i].x, pixels[i].y) !=
                     (k < 2 || pixels[i].colour == DARK ? pixels[i].colour : 0xff8000);
        ok(wrong == 0, "squares, near ones before far ones, on a dark image: %d are wrong", wrong);
        free(rgb);
        spin_splats_free(&s);
    }
}

static void check_choice(void)
{
    struct spin_view view[12];
    const struct spin_views views = {.view = view, .n = 12};
    size_t index[8];

    for (int i = 0; i < 12; i++) /* two views of row 0, seven of row 1, three of row 4 */
        view[i] = (struct spin_view){.dataset_frame = i < 2 ? 0 : i < 9 ? 1 : 4};
    ok(spin_camera_overlay_choose(&views, 1, 3, index) == 3 && index[0] == 2 && index[1] == 4 &&
           index[2] == 6,
       "three of seven views");
    ok(spin_camera_overlay_choose(&views, 4, 8, index) == 3 && index[0] == 9 && index[2] == 11,
       "all of three");
    ok(spin_camera_overlay_choose(&views, 2, 8, index) == 0 &&
           spin_camera_overlay_choose(&views, 5, 8, index) == 0,
       "none of a row without views");
}

TAP_MAIN
{
    check_overlay();
    check_choice();
}
