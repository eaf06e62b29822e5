#include "exporters/lib/poster.h"

#include "base/base.h"
#include "io/image.h"

enum { W = SPIN_POSTER_WIDTH, H = SPIN_POSTER_HEIGHT };

static void set_camera(const struct spin_initial_view *view, struct spin_camera *out)
{
    double aspect = (double)W / H, focal = spin_initial_view_focal(view, H);

    focal *= fmin(1, aspect / view->aspect);
    *out = (struct spin_camera){.width = W,
                                .height = H,
                                .fx = focal,
                                .fy = focal,
                                .cx = 0.5 * W,
                                .cy = 0.5 * H,
                                .z_near = view->z_near};
    spin_initial_view_pose(view->eye, view->target, view->up, out->w2c);
}

spin_status spin_poster_write(const struct spin_export_job *job,
                              const struct spin_initial_view *view,
                              const struct spin_splats *splats, struct spin_out *out)
{
    SPIN_FREED float *image = NULL;
    SPIN_FREED uint8_t *rgb = NULL;
    SPIN_FREED unsigned char *png = NULL;
    struct spin_camera camera;
    size_t n_png = 0;

    set_camera(view, &camera);
    SPIN_TRY(spin_alloc((size_t)W * H, 3 * sizeof *image, (void **)&image));
    SPIN_TRY(spin_alloc((size_t)W * H, 3, (void **)&rgb));
    SPIN_TRY(spin_render(job->renderer, splats, &camera, job->background, image));
    for (size_t c = 0; c < 3; c++)
        for (size_t i = 0; i < (size_t)W * H; i++)
            rgb[3 * i + c] = (uint8_t)(255 * fminf(fmaxf(image[c * W * H + i], 0), 1) + 0.5f);
    SPIN_TRY(spin_image_encode(W, H, rgb, &png, &n_png));
    return spin_out_write(out, png, n_png);
}
