/* Gaussians to screen ellipses and their gradients: who does which splats. The formulas are in
 * math/project.h, math/sh.h and math/tile.h. */
#include "base/base.h"
#include "device/cpu/cpu.h"
#include "math/project.h"
#include "math/sh.h"
#include "math/tile.h"

enum { CHUNK = 256, CLAMPED_X = 8, CLAMPED_Y = 16 };

struct job {
    const struct spin_camera_f32 *cam;
    struct spin_projection projection;
    size_t n, width; /* of a row of attributes */
    const float *pos_w, *attr;
    int sh_degree;
    struct spin_splat2d *splat2d;
    const struct spin_splat2d *splat2d_in;
    const struct spin_splat2d_grad *d_splat2d;
    float *d_attr, *d_pos_w;
};

static struct spin_projection lens_of(const struct spin_camera_f32 *cam)
{
    struct spin_projection projection = {cam->fx,      cam->fy,      cam->cx, cam->cy,
                                         cam->limit_x, cam->limit_y, cam->r,  cam->t};
    return projection;
}

/* Leaves radius_px at 0 when there is nothing to draw, or nothing finite: a bad splat must not
 * spoil the pixels and gradients of others. */
static inline void project_one(const struct job *job, int degree, const float *pos_w,
                               const float *attr, struct spin_splat2d *s)
{
    const struct spin_camera_f32 *cam = job->cam;
    spin_vec3 p = spin_to_camera(cam->r, cam->t, spin_v3(pos_w[0], pos_w[1], pos_w[2])), view;
    struct spin_projected_cov f;
    struct spin_ellipse e;
    float distance;
    int x0, y0, x1, y1;

    memset(s, 0, sizeof *s);
    if (!(p.z > SPIN_PROJECT_NEAR))
        return;
    spin_projected_cov_from(&job->projection, p, attr + SPIN_ATTR_SCALE, attr + SPIN_ATTR_ROTATION,
                            &f);
    e = spin_ellipse_from(&job->projection, &f);
    if (!(e.radius_px > 0 && e.radius_px < 1e9f))
        return;
    spin_tile_rect(e.u_px, e.v_px, e.radius_px, cam->tiles_x, cam->tiles_y, &x0, &y0, &x1, &y1);
    if (x0 >= x1 || y0 >= y1)
        return;
    view = spin_view_direction(cam->centre, pos_w, &distance);
    s->flags = spin_sh_colour(degree, view, attr + SPIN_ATTR_SH, s->colour);
    if (!isfinite(e.u_px + e.v_px + e.conic[0] + e.conic[1] + e.conic[2] + p.z + s->colour[0] +
                  s->colour[1] + s->colour[2]))
        return;
    s->flags |= (f.x_clamped ? CLAMPED_X : 0) | (f.y_clamped ? CLAMPED_Y : 0);
    s->u_px = e.u_px;
    s->v_px = e.v_px;
    memcpy(s->conic, e.conic, sizeof s->conic);
    s->opacity = attr[job->width - 1];
    if (cam->antialias)
        s->opacity *= spin_aa_compensation(&f);
    s->depth = p.z;
    s->radius_px = (int32_t)e.radius_px;
    s->x0 = (uint16_t)x0;
    s->y0 = (uint16_t)y0;
    s->x1 = (uint16_t)x1;
    s->y1 = (uint16_t)y1;
}

static inline void project_range(const struct job *job, int degree, size_t first, size_t last)
{
    for (size_t i = first; i < last; i++)
        project_one(job, degree, job->pos_w + 3 * i, job->attr + job->width * i, job->splat2d + i);
}

static void project_task(void *context, size_t first, size_t last)
{
    const struct job *job = context;

    if (job->sh_degree == 3) /* a constant degree lets the compiler unroll */
        project_range(job, 3, first, last);
    else
        project_range(job, job->sh_degree, first, last);
}

/* What forward and backward of view k have in common. */
static struct job job_of(const struct spin_view_batch *views, int k,
                         const struct spin_frame_batch *frames, const float *attr, int sh_degree)
{
    const struct spin_view_of_batch *view = &views->view[k];
    const struct spin_frame_of_batch *frame = &frames->frame[view->frame];

    return (struct job){.cam = &view->camera,
                        .projection = lens_of(&view->camera),
                        .n = view->n,
                        .width = spin_attr_width(frames),
                        .pos_w = frame->means,
                        .attr = attr + frame->first * spin_attr_width(frames),
                        .sh_degree = sh_degree};
}

void SPIN_CPU(project)(struct spin_device *d, const struct spin_view_batch *views,
                       const struct spin_frame_batch *frames, const float *attr, int sh_degree,
                       struct spin_splat2d *splat2d)
{
    SPIN_CPU_CLOCK(d, SPIN_OP_PROJECT);

    for (int k = 0; k < views->n_views; k++) {
        struct job job = job_of(views, k, frames, attr, sh_degree);

        job.splat2d = splat2d + views->view[k].first;
        spin_pool_rows(spin_cpu_pool(d), job.n, CHUNK, project_task, &job);
    }
}

static int all_zero(const struct spin_splat2d_grad *g)
{
    return g->u_px == 0 && g->v_px == 0 && g->conic[0] == 0 && g->conic[1] == 0 &&
           g->conic[2] == 0 && g->opacity == 0 && g->colour[0] == 0 && g->colour[1] == 0 &&
           g->colour[2] == 0;
}

static inline void project_back_one(const struct job *job, int degree, size_t i)
{
    const struct spin_camera_f32 *cam = job->cam;
    const struct spin_splat2d *s = job->splat2d_in + i;
    const struct spin_splat2d_grad *g = job->d_splat2d + i;
    const float *pos_w = job->pos_w + 3 * i, *attr = job->attr + job->width * i;
    const float *scale = attr + SPIN_ATTR_SCALE, *q = attr + SPIN_ATTR_ROTATION;
    float *d_attr = job->d_attr + job->width * i, *d_pos_w = job->d_pos_w + 3 * i;
    float d_colour[3], distance, aa_compensation = 1, d_fade = 0;
    struct spin_projected_cov f;
    spin_vec3 view, d_view;

    if (s->radius_px <= 0 || all_zero(g))
        return;
    spin_projected_cov_from(&job->projection,
                            spin_to_camera(cam->r, cam->t, spin_v3(pos_w[0], pos_w[1], pos_w[2])),
                            scale, q, &f);
    if (cam->antialias) {
        aa_compensation = spin_aa_compensation(&f);
        d_fade = g->opacity * attr[job->width - 1];
    }
    spin_ellipse_adj(&job->projection, &f, scale, q, g->u_px, g->v_px, g->conic, d_fade,
                     d_attr + SPIN_ATTR_SCALE, d_attr + SPIN_ATTR_ROTATION, d_pos_w);
    for (int c = 0; c < 3; c++)
        d_colour[c] = s->flags >> c & 1 ? 0 : g->colour[c];
    view = spin_view_direction(cam->centre, pos_w, &distance);
    d_view = spin_sh_colour_adj(degree, view, attr + SPIN_ATTR_SH, d_colour, d_attr + SPIN_ATTR_SH);
    spin_view_direction_adj(view, distance, d_view, d_pos_w);
    d_attr[job->width - 1] += g->opacity * aa_compensation;
}

static inline void project_back_range(const struct job *job, int degree, size_t first, size_t last)
{
    for (size_t i = first; i < last; i++)
        project_back_one(job, degree, i);
}

static void project_back_task(void *context, size_t first, size_t last)
{
    const struct job *job = context;

    if (job->sh_degree == 3)
        project_back_range(job, 3, first, last);
    else
        project_back_range(job, job->sh_degree, first, last);
}

void SPIN_CPU(project_back)(struct spin_device *d, const struct spin_view_batch *views,
                            const struct spin_frame_batch *frames, const float *attr, int sh_degree,
                            const struct spin_splat2d *splat2d,
                            const struct spin_splat2d_grad *d_splat2d, float *d_attr)
{
    SPIN_CPU_CLOCK(d, SPIN_OP_PROJECT_BACK);

    for (int k = 0; k < views->n_views; k++) {
        const struct spin_view_of_batch *view = &views->view[k];
        const struct spin_frame_of_batch *frame = &frames->frame[view->frame];
        struct job job = job_of(views, k, frames, attr, sh_degree);

        job.splat2d_in = splat2d + view->first;
        job.d_splat2d = d_splat2d + view->first;
        job.d_attr = d_attr + frame->first * job.width;
        job.d_pos_w = frame->d_means;
        spin_pool_rows(spin_cpu_pool(d), job.n, CHUNK, project_back_task, &job);
    }
}
