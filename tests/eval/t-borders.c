/* Flat borders are distinguished from textured ones: for any colour, with noise, and if only part
 * of the border is flat.
 * K: eval backdrop */
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

/* Images whose first columns have one colour and whose other columns are textured. */
static bool is_flat(float level, float noise, int flat_columns)
{
    static float image[3 * PLANE];
    struct spin_views views = {0};
    struct spin_image_cache images;
    struct spin_pair pairs[3] = {{0, 0}, {0, 1}, {0, 2}};
    float colour[3];
    bool flat = false;

    for (int k = 0; k < 3; k++) {
        char path[600];
        struct spin_view v = {.camera_id = k, .path = path};

        v.camera = (struct spin_camera){.width = W, .height = H, .fx = 30, .fy = 30};
        snprintf(path, sizeof path, "%s/%d.png", folder, k);
        for (int i = 0; i < 3 * PLANE; i++) {
            bool textured = i % W >= flat_columns;

            image[i] = textured ? 0.2f + 0.017f * (float)((i * 7 + k) % 31)
                                : level + noise * (float)(i % 3 - 1);
        }
        need(spin_image_save(path, W, H, image, false));
        need(spin_views_add(&views, &v));
    }
    need(spin_image_cache_open(&views, 1 << 20, NULL, &images));
    need(spin_borders_are_flat(&views, &images, pairs, 3, &flat, colour));
    spin_image_cache_close(&images);
    spin_views_free(&views);
    return flat;
}

TAP_MAIN
{
    folder = check_folder();
    ok(is_flat(0, 0, W), "black borders are flat");
    ok(is_flat(1, 0, W), "so are white ones");
    ok(is_flat(0.5f, 0.01f, W), "and grey ones with the noise of JPEG");
    ok(!is_flat(0, 0, 0), "borders with texture are not");
    ok(!is_flat(0, 0, W / 4), "nor are those of which a quarter is flat");
    ok(is_flat(0, 0, 3 * W / 4), "a subject that touches the border leaves it flat");
}
