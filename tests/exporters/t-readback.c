/* Errors of positions, in sizes of splats and in pixels.
 * K: export check */
#include "exporters/lib/readback.h"
#include "tests/tap.h"

static struct spin_view view_at(int frame, double focal)
{
    return (struct spin_view){.dataset_frame = frame,
                              .camera = {.width = 100,
                                         .height = 50,
                                         .fx = focal,
                                         .fy = focal / 2,
                                         .cx = 50,
                                         .cy = 25,
                                         .w2c = {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0}}};
}

TAP_MAIN
{
    static const struct {
        float mean[3];
        const char *what;
    } unseen[] = {
        {{0, 0, -2}, "behind the camera"},      {{0, 0, 0.1f}, "nearer than what is drawn"},
        {{1.1f, 0, 2}, "right of the picture"}, {{-1.1f, 0, 2}, "left of the picture"},
        {{0, 1.1f, 2}, "below the picture"},    {{0, -1.1f, 2}, "above the picture"}};
    struct spin_view view[] = {view_at(0, 100), view_at(0, 120), view_at(1, 1000)};
    const struct spin_views views = {.view = view, .n = 3, .n_dataset_frames = 2};
    const int rows[] = {0, 1, -1};
    const struct spin_export_job job = {.views = &views, .dataset_frame_of = rows};
    const float sizes[3] = {logf(0.1f), logf(0.5f), logf(0.2f)};
    struct spin_export_check check;
    struct spin_readback e;

    spin_readback_begin(&e);
    spin_readback_frame(&e, &job, 0);
    for (size_t i = 0; i < sizeof unseen / sizeof *unseen; i++) {
        spin_readback_add(&e, unseen[i].mean, sizes, 0.001);
        spin_readback_fill_check(&e, 1, &check);
        ok(isnan(check.place_pixels), "%s no pixel is off", unseen[i].what);
    }
    near(check.place_sizes, 0.002, 1e-9, "of the largest size");
    spin_readback_add(&e, (const float[]){0.05f, 0.02f, 2}, sizes, 0.01);
    spin_readback_fill_check(&e, 1, &check);
    near(check.place_sizes, 0.02, 1e-8, "the most of them");
    near(check.place_pixels, 0.6, 1e-9, "pixels of the camera with the longest focal length");
    spin_readback_frame(&e, &job, 2);
    spin_readback_add(&e, (const float[]){0, 0, 2}, sizes, 1);
    spin_readback_fill_check(&e, 1, &check);
    near(check.place_pixels, 0.6, 1e-9, "a frame without cameras adds none");
    spin_readback_begin(&e);
    spin_readback_frame(&e, &(const struct spin_export_job){.views = NULL}, 0);
    spin_readback_add(&e, (const float[]){0, 0, 2}, sizes, 1);
    spin_readback_fill_check(&e, 1, &check);
    ok(isnan(check.place_pixels), "no data set, no pixels");
}
