/* Gaussians to screen ellipses and their gradients, one thread a splat of a view. The formulas are in
 * math/project.h, math/sh.h and math/tile.h. */
#include "device/cuda/cuda.h"
#include "math/project.h"
#include "math/sh.h"
#include "math/tile.h"

enum { CLAMPED_X = 8, CLAMPED_Y = 16 };

static __device__ struct spin_projection lens_of(const struct spin_camera_f32 &cam)
{
    struct spin_projection projection = {cam.fx,      cam.fy,      cam.cx, cam.cy,
                                         cam.limit_x, cam.limit_y, cam.r,  cam.t};
    return projection;
}

/* Leaves radius_px at 0 when there is nothing to draw, or nothing finite. */
static __device__ void project_one(const struct spin_camera_f32 &cam, int degree,
                                   const float *pos_w, const float *attr, struct spin_splat2d *s)
{
    struct spin_projection lens = lens_of(cam);
    spin_vec3 p = spin_to_camera(cam.r, cam.t, spin_v3(pos_w[0], pos_w[1], pos_w[2])), view;
    struct spin_projected_cov f;
    struct spin_ellipse e;
    float distance;
    int x0, y0, x1, y1;

    if (!(p.z > SPIN_PROJECT_NEAR))
        return;
    spin_projected_cov_from(&lens, p, attr + SPIN_ATTR_SCALE, attr + SPIN_ATTR_ROTATION, &f);
    e = spin_ellipse_from(&lens, &f);
    if (!(e.radius_px > 0 && e.radius_px < 1e9f))
        return;
    spin_tile_rect(e.u_px, e.v_px, e.radius_px, cam.tiles_x, cam.tiles_y, &x0, &y0, &x1, &y1);
    if (x0 >= x1 || y0 >= y1)
        return;
    view = spin_view_direction(cam.centre, pos_w, &distance);
    s->flags = spin_sh_colour(degree, view, attr + SPIN_ATTR_SH, s->colour);
    if (!isfinite(e.u_px + e.v_px + e.conic[0] + e.conic[1] + e.conic[2] + p.z + s->colour[0] +
                  s->colour[1] + s->colour[2]))
        return;
    s->flags |= (f.x_clamped ? CLAMPED_X : 0) | (f.y_clamped ? CLAMPED_Y : 0);
    s->u_px = e.u_px;
    s->v_px = e.v_px;
    for (int k = 0; k < 3; k++)
        s->conic[k] = e.conic[k];
    s->opacity = attr[SPIN_ATTR_OPACITY];
    if (cam.antialias)
        s->opacity *= spin_aa_compensation(&f);
    s->depth = p.z;
    s->radius_px = (int32_t)e.radius_px;
    s->x0 = (uint16_t)x0;
    s->y0 = (uint16_t)y0;
    s->x1 = (uint16_t)x1;
    s->y1 = (uint16_t)y1;
}

static __global__ void project_kernel(struct spin_camera_f32 cam, int degree, size_t n,
                                      const float *means, const float *attr,
                                      struct spin_splat2d *splat2d)
{
    size_t i = GPU_INDEX();
    struct spin_splat2d s = {};

    if (i >= n)
        return;
    project_one(cam, degree, means + 3 * i, attr + SPIN_ATTR * i, &s);
    splat2d[i] = s;
}

void cuda_project(struct spin_device *d, const struct spin_view_batch *views,
                  const struct spin_frame_batch *frames, const float *attr, int sh_degree,
                  struct spin_splat2d *splat2d)
{
    cuda_begin(d, SPIN_OP_PROJECT);
    for (int k = 0; k < views->n_views; k++) {
        const auto *view = &views->view[k];
        const auto *frame = &frames->frame[view->frame];

        GPU_EACH(gpu_of(d), view->n, project_kernel, view->camera, sh_degree, view->n, frame->means,
                 attr + frame->first * SPIN_ATTR, splat2d + view->first);
    }
    cuda_end(d, SPIN_OP_PROJECT);
}

static __device__ bool all_zero(const struct spin_splat2d_grad &g)
{
    return g.u_px == 0 && g.v_px == 0 && g.conic[0] == 0 && g.conic[1] == 0 && g.conic[2] == 0 &&
           g.opacity == 0 && g.colour[0] == 0 && g.colour[1] == 0 && g.colour[2] == 0;
}

static __global__ void project_back_kernel(struct spin_camera_f32 cam, int degree, size_t n,
                                           const float *means, const float *attrs,
                                           const struct spin_splat2d *splat2d,
                                           const struct spin_splat2d_grad *d_splat2d,
                                           float *d_attrs, float *d_means)
{
    size_t i = GPU_INDEX();
    struct spin_projection lens = lens_of(cam);
    const float *pos_w = means + 3 * i, *attr = attrs + SPIN_ATTR * i;
    const float *scale = attr + SPIN_ATTR_SCALE, *q = attr + SPIN_ATTR_ROTATION;
    float *d_attr = d_attrs + SPIN_ATTR * i, *d_pos_w = d_means + 3 * i;
    float d_colour[3], distance, aa_compensation = 1, d_fade = 0;
    struct spin_projected_cov f;
    struct spin_splat2d_grad g;
    spin_vec3 view, d_view;

    if (i >= n || splat2d[i].radius_px <= 0)
        return;
    g = d_splat2d[i];
    if (all_zero(g))
        return;
    spin_projected_cov_from(
        &lens, spin_to_camera(cam.r, cam.t, spin_v3(pos_w[0], pos_w[1], pos_w[2])), scale, q, &f);
    if (cam.antialias) {
        aa_compensation = spin_aa_compensation(&f);
        d_fade = g.opacity * attr[SPIN_ATTR_OPACITY];
    }
    spin_ellipse_adj(&lens, &f, scale, q, g.u_px, g.v_px, g.conic, d_fade, d_attr + SPIN_ATTR_SCALE,
                     d_attr + SPIN_ATTR_ROTATION, d_pos_w);
    for (int c = 0; c < 3; c++)
        d_colour[c] = splat2d[i].flags >> c & 1 ? 0 : g.colour[c];
    view = spin_view_direction(cam.centre, pos_w, &distance);
    d_view = spin_sh_colour_adj(degree, view, attr + SPIN_ATTR_SH, d_colour, d_attr + SPIN_ATTR_SH);
    spin_view_direction_adj(view, distance, d_view, d_pos_w);
    d_attr[SPIN_ATTR_OPACITY] += g.opacity * aa_compensation;
}

void cuda_project_back(struct spin_device *d, const struct spin_view_batch *views,
                       const struct spin_frame_batch *frames, const float *attr, int sh_degree,
                       const struct spin_splat2d *splat2d,
                       const struct spin_splat2d_grad *d_splat2d, float *d_attr)
{
    cuda_begin(d, SPIN_OP_PROJECT_BACK);
    for (int k = 0; k < views->n_views; k++) { /* views of one frame add up one after the other */
        const auto *view = &views->view[k];
        const auto *frame = &frames->frame[view->frame];

        GPU_EACH(gpu_of(d), view->n, project_back_kernel, view->camera, sh_degree, view->n,
                 frame->means, attr + frame->first * SPIN_ATTR, splat2d + view->first,
                 d_splat2d + view->first, d_attr + frame->first * SPIN_ATTR, frame->d_means);
    }
    cuda_end(d, SPIN_OP_PROJECT_BACK);
}
