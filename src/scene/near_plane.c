#include "scene/near_plane.h"

#include "base/base.h"

enum {
    NEAR_VIEWS = 64,    /* maximum number of views that are sampled, evenly spaced */
    NEAR_POINTS = 4096, /* maximum number of points that are sampled, evenly spaced */
    /* 1/NEAR_SHARE of the points in an image are nearer than the depth of the foreground. */
    NEAR_SHARE = 20,
    /* A warning is printed if the near plane cuts off over 1/CUT_SHARE of the points in an
     * image. */
    CUT_SHARE = 100
};
/* Maximum distance of the near plane, as a fraction of the foreground's depth. */
static const double before_foreground = 0.25;

/* Samples the points, lists the depths of those inside a camera's image in ascending order, and
 * returns the number of listed depths. */
static size_t list_depths(const struct spin_camera *camera, const float *points, size_t n,
                          float *depth)
{
    size_t n_inside = 0, stride = n / NEAR_POINTS + 1;
    double p[3];

    for (size_t i = 0; i < n; i += stride)
        if (spin_camera_project_visible(camera, points + 3 * i, p))
            depth[n_inside++] = (float)p[2];
    qsort(depth, n_inside, sizeof *depth, spin_by_float);
    return n_inside;
}

/* Prints a warning about the view whose near plane cuts off the largest share of the points in its
 * image, if this share is more than 1 / CUT_SHARE. */
static void warn_cut(const struct spin_views *views, const float *points, size_t n, float *depth)
{
    const struct spin_view *worst = NULL;
    size_t step = views->n / NEAR_VIEWS + 1;
    double most = 1.0 / CUT_SHARE;

    for (size_t v = 0; v < views->n; v += step) {
        const struct spin_camera *camera = &views->view[v].camera;
        size_t n_inside = list_depths(camera, points, n, depth), n_cut = 0;

        while (n_cut < n_inside && (double)depth[n_cut] <= spin_camera_near(camera))
            n_cut++;
        if ((double)n_cut > most * (double)n_inside) {
            worst = &views->view[v];
            most = (double)n_cut / (double)n_inside;
        }
    }
    if (worst)
        spin_warn("camera %d: %.0f %% of the splats in its image are cut off by the near plane at "
                  "%.3g world units: check whether the camera is inside the scene's splats",
                  worst->camera_id, 100 * most, spin_camera_near(&worst->camera));
}

spin_status spin_views_set_near(struct spin_views *views, const float *points, size_t n, bool warns)
{
    size_t step = views->n / NEAR_VIEWS + 1, n_views = 0;
    SPIN_FREED float *depth = NULL;
    float foreground[NEAR_VIEWS];
    double z_near;

    SPIN_TRY(spin_alloc(NEAR_POINTS, sizeof *depth, (void **)&depth));
    for (size_t v = 0; v < views->n; v += step) {
        size_t n_inside = list_depths(&views->view[v].camera, points, n, depth);

        if (n_inside > 0)
            foreground[n_views++] = depth[n_inside / NEAR_SHARE];
    }
    qsort(foreground, n_views, sizeof *foreground, spin_by_float);
    z_near = n_views > 0 ? before_foreground * (double)foreground[n_views / 2] : SPIN_NEAR;
    for (size_t v = 0; v < views->n && z_near < SPIN_NEAR; v++)
        views->view[v].camera.z_near = z_near;
    if (warns)
        warn_cut(views, points, n, depth);
    return SPIN_OK;
}
