/* Projects splats to ellipses in the image, and propagates gradients back, a block of splats at a
 * time. The formulas are in math/project.h, math/sh.h and math/tile.h. */
#include "base/base.h"
#include "device/cpu/cpu.h"
#include "math/project.h"
#include "math/sh.h"
#include "math/tile.h"

enum { CHUNK = 256, BLOCK = 32, CLAMPED_X = 8, CLAMPED_Y = 16 };

struct job {
    const struct spin_camera_f32 *cam;
    struct spin_projection projection;
    size_t n, width; /* `width`: number of floats in a row of attributes */
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

/* A block of splats, stored as a structure of arrays so that the compiler vectorises the loops over
 * splats. In an incomplete block, the entries after the last splat repeat the first splat. */
struct block {
    size_t row[BLOCK];
    float pos[3][BLOCK], scale[3][BLOCK], q[4][BLOCK], opacity[BLOCK];
    /* Forward: the results of the projection. */
    float u[BLOCK], v[BLOCK], conic[3][BLOCK], radius[BLOCK], depth[BLOCK], fade[BLOCK];
    int32_t x0[BLOCK], y0[BLOCK], x1[BLOCK], y1[BLOCK], flags[BLOCK], drawn[BLOCK];
    /* Backward: the gradients of these results; then the gradients of the inputs. */
    float d_u[BLOCK], d_v[BLOCK], d_conic[3][BLOCK], d_fade[BLOCK];
    float d_pos[3][BLOCK], d_scale[3][BLOCK], d_q[4][BLOCK], d_rot[9][BLOCK];
};

static void block_load(const struct job *job, int n, struct block *b)
{
    for (int i = 0; i < BLOCK; i++) {
        size_t row = b->row[i < n ? i : 0];
        const float *pos = job->pos_w + 3 * row, *attr = job->attr + job->width * row;

        for (int k = 0; k < 3; k++) {
            b->pos[k][i] = pos[k];
            b->scale[k][i] = attr[SPIN_ATTR_SCALE + k];
        }
        for (int k = 0; k < 4; k++)
            b->q[k][i] = attr[SPIN_ATTR_ROTATION + k];
        b->opacity[i] = attr[job->width - 1];
    }
}

/* One splat of the block, in the form of the arguments of math/project.h. */
struct one {
    spin_vec3 p; /* in camera coordinates */
    float scale[3], q[4];
};

/* Computes one axis of spin_to_camera() in a fixed order of multiply-adds that starts with product
 * `first`. The published results were computed by code for a single splat, for which the compiler
 * chose one order in the forward pass and another in the backward pass. This function keeps both
 * orders, since another order would change the last bits. */
SPIN_FN float to_camera(const struct spin_projection *lens, int axis, int first,
                        const struct block *b, int i)
{
    const float *r = lens->r + 3 * axis;

    return r[first] * b->pos[first][i] + r[1 - first] * b->pos[1 - first][i] + r[2] * b->pos[2][i] +
           lens->t[axis];
}

SPIN_FN struct one one_of(const struct spin_projection *lens, const struct block *b, int i,
                          int first_of_x)
{
    struct one s = {spin_v3(to_camera(lens, 0, first_of_x, b, i), to_camera(lens, 1, 1, b, i),
                            to_camera(lens, 2, 0, b, i)),
                    {b->scale[0][i], b->scale[1][i], b->scale[2][i]},
                    {b->q[0][i], b->q[1][i], b->q[2][i], b->q[3][i]}};
    return s;
}

static __attribute__((noinline)) void block_project(const struct job *job,
                                                    struct block *SPIN_RESTRICT b)
{
    const struct spin_projection lens = job->projection;
    int tiles_x = job->cam->tiles_x, tiles_y = job->cam->tiles_y;
    float z_near = job->cam->z_near;

    for (int i = 0; i < BLOCK; i++) {
        struct one s = one_of(&lens, b, i, 1);
        struct spin_projected_cov f;
        struct spin_ellipse e;
        int x0, y0, x1, y1;

        spin_projected_cov_from(&lens, s.p, s.scale, s.q, &f);
        e = spin_ellipse_from(&lens, &f);
        spin_tile_rect(e.u_px, e.v_px, e.radius_px, tiles_x, tiles_y, &x0, &y0, &x1, &y1);
        b->drawn[i] =
            (s.p.z > z_near) & (e.radius_px > 0) & (e.radius_px < 1e9f) & (x0 < x1) & (y0 < y1);
        b->flags[i] = (f.x_clamped ? CLAMPED_X : 0) | (f.y_clamped ? CLAMPED_Y : 0);
        b->fade[i] = spin_aa_compensation(&f);
        b->u[i] = e.u_px;
        b->v[i] = e.v_px;
        for (int k = 0; k < 3; k++)
            b->conic[k][i] = e.conic[k];
        b->radius[i] = e.radius_px;
        b->depth[i] = s.p.z;
        b->x0[i] = x0;
        b->y0[i] = y0;
        b->x1[i] = x1;
        b->y1[i] = y1;
    }
}

/* Stores the projection of splat i in *s. If the splat is not visible or not finite, its radius_px
 * stays 0, so that it does not affect the pixels and gradients of other splats. */
static inline void store_one(const struct job *job, int degree, const struct block *b, int i,
                             struct spin_splat2d *s)
{
    size_t row = b->row[i];
    float distance;

    memset(s, 0, sizeof *s);
    if (!b->drawn[i])
        return;
    s->flags = spin_sh_colour(
        degree, spin_view_direction(job->cam->centre, job->pos_w + 3 * row, &distance),
        job->attr + job->width * row + SPIN_ATTR_SH, s->colour);
    if (!isfinite(b->u[i] + b->v[i] + b->conic[0][i] + b->conic[1][i] + b->conic[2][i] +
                  b->depth[i] + s->colour[0] + s->colour[1] + s->colour[2]))
        return;
    s->flags |= (unsigned)b->flags[i];
    s->u_px = b->u[i];
    s->v_px = b->v[i];
    for (int k = 0; k < 3; k++)
        s->conic[k] = b->conic[k][i];
    s->opacity = b->opacity[i] * (job->cam->antialias ? b->fade[i] : 1);
    s->depth = b->depth[i];
    s->radius_px = (int32_t)b->radius[i];
    s->x0 = (uint16_t)b->x0[i];
    s->y0 = (uint16_t)b->y0[i];
    s->x1 = (uint16_t)b->x1[i];
    s->y1 = (uint16_t)b->y1[i];
}

static inline void project_range(const struct job *job, int degree, size_t first, size_t last)
{
    struct block b;

    for (; first < last; first += BLOCK) {
        int n = last - first < BLOCK ? (int)(last - first) : BLOCK;

        for (int i = 0; i < n; i++)
            b.row[i] = first + (size_t)i;
        block_load(job, n, &b);
        block_project(job, &b);
        for (int i = 0; i < n; i++)
            store_one(job, degree, &b, i, job->splat2d + b.row[i]);
    }
}

/* Calls `range` with a constant degree, so that the compiler unrolls the loops over SH
 * coefficients. */
#define OF_DEGREE(range, job, first, last)                                                         \
    ((job)->sh_degree == 3   ? range(job, 3, first, last)                                          \
     : (job)->sh_degree == 0 ? range(job, 0, first, last)                                          \
                             : range(job, (job)->sh_degree, first, last))

static void project_task(void *context, size_t first, size_t last)
{
    const struct job *job = context;

    OF_DEGREE(project_range, job, first, last);
}

/* Returns a job for view k with the members that the forward and the backward pass have in common.
 */
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

static __attribute__((noinline)) void block_project_back(const struct job *job,
                                                         struct block *SPIN_RESTRICT b)
{
    const struct spin_projection lens = job->projection;

    for (int i = 0; i < BLOCK; i++) {
        struct one s = one_of(&lens, b, i, 0);
        float d_conic[3] = {b->d_conic[0][i], b->d_conic[1][i], b->d_conic[2][i]};
        float d_pos[3] = {b->d_pos[0][i], b->d_pos[1][i], b->d_pos[2][i]};
        float d_scale[3] = {b->d_scale[0][i], b->d_scale[1][i], b->d_scale[2][i]};
        float d_rot[3][3];
        struct spin_projected_cov f;

        spin_projected_cov_from(&lens, s.p, s.scale, s.q, &f);
        spin_ellipse_adj(&lens, &f, s.scale, b->d_u[i], b->d_v[i], d_conic, b->d_fade[i], d_scale,
                         d_rot, d_pos);
        b->fade[i] = spin_aa_compensation(&f);
        for (int k = 0; k < 3; k++) {
            b->d_pos[k][i] = d_pos[k];
            b->d_scale[k][i] = d_scale[k];
        }
        for (int k = 0; k < 9; k++)
            b->d_rot[k][i] = d_rot[k / 3][k % 3];
    }
    for (int i = 0; i < BLOCK; i++) {
        float q[4] = {b->q[0][i], b->q[1][i], b->q[2][i], b->q[3][i]};
        float d_q[4] = {b->d_q[0][i], b->d_q[1][i], b->d_q[2][i], b->d_q[3][i]};
        float d_rot[3][3] = {{b->d_rot[0][i], b->d_rot[1][i], b->d_rot[2][i]},
                             {b->d_rot[3][i], b->d_rot[4][i], b->d_rot[5][i]},
                             {b->d_rot[6][i], b->d_rot[7][i], b->d_rot[8][i]}};

        spin_matrix_quat_adj(q, d_rot, d_q);
        for (int k = 0; k < 4; k++)
            b->d_q[k][i] = d_q[k];
    }
}

static void block_load_back(const struct job *job, int n, struct block *b)
{
    for (int i = 0; i < BLOCK; i++) {
        size_t row = b->row[i < n ? i : 0];
        const struct spin_splat2d_grad *g = job->d_splat2d + row;
        const float *d_attr = job->d_attr + job->width * row;

        b->d_u[i] = g->u_px;
        b->d_v[i] = g->v_px;
        b->d_fade[i] = job->cam->antialias ? g->opacity * b->opacity[i] : 0;
        for (int k = 0; k < 3; k++) {
            b->d_conic[k][i] = g->conic[k];
            b->d_pos[k][i] = job->d_pos_w[3 * row + (size_t)k];
            b->d_scale[k][i] = d_attr[SPIN_ATTR_SCALE + k];
        }
        for (int k = 0; k < 4; k++)
            b->d_q[k][i] = d_attr[SPIN_ATTR_ROTATION + k];
    }
}

static inline void store_back_one(const struct job *job, int degree, const struct block *b, int i)
{
    size_t row = b->row[i];
    const struct spin_splat2d_grad *g = job->d_splat2d + row;
    const float *pos_w = job->pos_w + 3 * row, *attr = job->attr + job->width * row;
    float *d_attr = job->d_attr + job->width * row, *d_pos_w = job->d_pos_w + 3 * row;
    float d_colour[3], distance;
    spin_vec3 view, d_view;

    for (int k = 0; k < 3; k++) {
        d_pos_w[k] = b->d_pos[k][i];
        d_attr[SPIN_ATTR_SCALE + k] = b->d_scale[k][i];
        d_colour[k] = job->splat2d_in[row].flags >> k & 1 ? 0 : g->colour[k];
    }
    for (int k = 0; k < 4; k++)
        d_attr[SPIN_ATTR_ROTATION + k] = b->d_q[k][i];
    view = spin_view_direction(job->cam->centre, pos_w, &distance);
    d_view = spin_sh_colour_adj(degree, view, attr + SPIN_ATTR_SH, d_colour, d_attr + SPIN_ATTR_SH);
    if (degree > 0)
        spin_view_direction_adj(view, distance, d_view, d_pos_w);
    d_attr[job->width - 1] += g->opacity * (job->cam->antialias ? b->fade[i] : 1);
}

static inline void back_block(const struct job *job, int degree, int n, struct block *b)
{
    block_load(job, n, b);
    block_load_back(job, n, b);
    block_project_back(job, b);
    for (int i = 0; i < n; i++)
        store_back_one(job, degree, b, i);
}

/* Collects the splats in [first, last) that have a gradient, and processes them block by block. */
static inline void project_back_range(const struct job *job, int degree, size_t first, size_t last)
{
    struct block b;
    int n = 0;

    for (size_t i = first; i < last; i++) {
        if (job->splat2d_in[i].radius_px > 0 && !all_zero(job->d_splat2d + i))
            b.row[n++] = i;
        if (n > 0 && (n == BLOCK || i + 1 == last)) {
            back_block(job, degree, n, &b);
            n = 0;
        }
    }
}

static void project_back_task(void *context, size_t first, size_t last)
{
    const struct job *job = context;

    OF_DEGREE(project_back_range, job, first, last);
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
