/* Projects splats to ellipses in the image, and propagates gradients back, with one thread per
 * splat of a view. The formulas are in math/project.h, math/sh.h and math/tile.h. A warp copies the
 * attribute rows of its splats through shared memory, so that its lanes access consecutive floats.
 * Rows of splats that are not visible and SH coefficients above the degree are not copied. */
#include "device/cuda/cuda.h"
#include "math/project.h"
#include "math/sh.h"
#include "math/tile.h"

enum { CLAMPED_X = 8, CLAMPED_Y = 16 };
/* ALL: number of values in the attribute rows of a warp's splats. AT_ONCE: number of values that a
 * lane loads before it stores the first one. */
enum { WARP = 32, BLOCK = 128, ALL = WARP * (int)SPIN_ATTR, AT_ONCE = 8 };
static const unsigned all_lanes = 0xffffffffu;

/* One attribute row per lane, padded by one float to avoid bank conflicts. */
struct rows {
    float of[WARP][SPIN_ATTR + 1];
};

/* Returns the row, of 32 consecutive rows, that contains value k; -1 if the mask bit of this row is
 * 0, or if the value is an SH coefficient above the degree. */
static __device__ int row_with(int k, unsigned mask, int degree)
{
    int row = k / SPIN_ATTR, column = k % SPIN_ATTR;
    bool used = column < SPIN_ATTR_SH + 3 * spin_sh_count(degree) || column == SPIN_ATTR_OPACITY;

    return used && mask >> row & 1 ? row : -1;
}

/* Copies the rows of `from` [32][SPIN_ATTR] whose mask bit is 1 to `rows`, without the SH
 * coefficients above the degree. All lanes must call the function. */
static __device__ void load_rows(struct rows *rows, const float *from, unsigned mask, int degree)
{
    int lane = (int)threadIdx.x % WARP;

    for (int first = lane; first < ALL; first += AT_ONCE * WARP) {
        float value[AT_ONCE];

        for (int j = 0; j < AT_ONCE; j++) {
            int k = first + j * WARP;

            value[j] = row_with(k, mask, degree) < 0 ? 0 : from[k];
        }
        for (int j = 0; j < AT_ONCE; j++) {
            int k = first + j * WARP;

            rows->of[k / SPIN_ATTR][k % SPIN_ATTR] = value[j];
        }
    }
    __syncwarp(all_lanes);
}

/* Adds the rows whose mask bit is 1 to `to` [32][SPIN_ATTR]. All lanes must call the function. */
static __device__ void add_rows(float *to, const struct rows *rows, unsigned mask, int degree)
{
    int lane = (int)threadIdx.x % WARP;

    __syncwarp(all_lanes);
    for (int first = lane; first < ALL; first += AT_ONCE * WARP) {
        float value[AT_ONCE];

        for (int j = 0; j < AT_ONCE; j++) {
            int k = first + j * WARP;

            value[j] = row_with(k, mask, degree) < 0 ? 0 : to[k];
        }
        for (int j = 0; j < AT_ONCE; j++) {
            int k = first + j * WARP, row = row_with(k, mask, degree);

            if (row >= 0)
                to[k] = value[j] + rows->of[row][k % SPIN_ATTR];
        }
    }
}

/* Calls spin_sh_colour() with a constant degree, so that its arrays stay in registers. */
static __device__ unsigned colour_of(int degree, spin_vec3 view, const float *sh, float *colour)
{
    switch (degree) {
    case 0:
        return spin_sh_colour(0, view, sh, colour);
    case 1:
        return spin_sh_colour(1, view, sh, colour);
    case 2:
        return spin_sh_colour(2, view, sh, colour);
    default:
        return spin_sh_colour(3, view, sh, colour);
    }
}

/* Replaces the coefficients sh by their gradient, and returns the gradient of the view direction.
 */
template <int DEGREE>
static __device__ spin_vec3 colour_adj(spin_vec3 view, const float *d_colour, float *sh)
{
    float basis[SPIN_SH_MAX], weight[SPIN_SH_MAX] = {};

    spin_sh_basis(DEGREE, view, basis);
    for (int k = 0; k < (DEGREE + 1) * (DEGREE + 1); k++)
        for (int c = 0; c < 3; c++) {
            weight[k] += sh[3 * k + c] * d_colour[c];
            sh[3 * k + c] = basis[k] * d_colour[c];
        }
    return spin_sh_slope(DEGREE, view, weight);
}

static __device__ spin_vec3 colour_back(int degree, spin_vec3 view, const float *d_colour,
                                        float *sh)
{
    switch (degree) {
    case 0:
        return colour_adj<0>(view, d_colour, sh);
    case 1:
        return colour_adj<1>(view, d_colour, sh);
    case 2:
        return colour_adj<2>(view, d_colour, sh);
    default:
        return colour_adj<3>(view, d_colour, sh);
    }
}

static __device__ struct spin_projection lens_of(const struct spin_camera_f32 &cam)
{
    struct spin_projection projection = {cam.fx,      cam.fy,      cam.cx, cam.cy,
                                         cam.limit_x, cam.limit_y, cam.r,  cam.t};
    return projection;
}

/* Projects a splat with the position pos_w, which is p in camera coordinates. If the splat is not
 * visible or not finite, its radius_px stays 0. */
static __device__ void project_one(const struct spin_camera_f32 &cam, int degree,
                                   const float *pos_w, spin_vec3 p, const float *attr,
                                   struct spin_splat2d *s)
{
    struct spin_projection lens = lens_of(cam);
    spin_vec3 view;
    struct spin_projected_cov f;
    struct spin_ellipse e;
    float distance;
    int x0, y0, x1, y1;

    spin_projected_cov_from(&lens, p, attr + SPIN_ATTR_SCALE, attr + SPIN_ATTR_ROTATION, &f);
    e = spin_ellipse_from(&lens, &f);
    if (!(e.radius_px > 0 && e.radius_px < 1e9f))
        return;
    spin_tile_rect(e.u_px, e.v_px, e.radius_px, cam.tiles_x, cam.tiles_y, &x0, &y0, &x1, &y1);
    if (x0 >= x1 || y0 >= y1)
        return;
    view = spin_view_direction(cam.centre, pos_w, &distance);
    s->flags = colour_of(degree, view, attr + SPIN_ATTR_SH, s->colour);
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
    __shared__ struct rows rows[BLOCK / WARP];
    size_t i = GPU_INDEX(), lane = threadIdx.x % WARP;
    struct rows *mine = &rows[threadIdx.x / WARP];
    union {
        struct spin_splat2d splat;
        float4 part[sizeof(struct spin_splat2d) / sizeof(float4)];
    } out = {};
    float pos_w[3] = {0, 0, 0};
    spin_vec3 p;
    bool before;
    unsigned mask;

    for (int k = 0; k < 3 && i < n; k++)
        pos_w[k] = means[3 * i + k];
    p = spin_to_camera(cam.r, cam.t, spin_v3(pos_w[0], pos_w[1], pos_w[2]));
    before = i < n && p.z > cam.z_near;
    mask = __ballot_sync(all_lanes, before);
    if (mask)
        load_rows(mine, attr + SPIN_ATTR * (i - lane), mask, degree);
    if (before)
        project_one(cam, degree, pos_w, p, mine->of[lane], &out.splat);
    for (size_t k = 0; k < sizeof out / sizeof(float4) && i < n; k++)
        ((float4 *)&splat2d[i])[k] = out.part[k];
}

static unsigned blocks_of(size_t n) { return (unsigned)((n + BLOCK - 1) / BLOCK); }

void cuda_project(struct spin_device *d, const struct spin_view_batch *views,
                  const struct spin_frame_batch *frames, const float *attr, int sh_degree,
                  struct spin_splat2d *splat2d)
{
    cuda_clocked clocked(d, SPIN_OP_PROJECT);
    for (int k = 0; k < views->n_views; k++) {
        const auto *view = &views->view[k];
        const auto *frame = &frames->frame[view->frame];

        if (view->n > 0)
            GPU_LAUNCH(gpu_of(d), project_kernel, blocks_of(view->n), BLOCK, view->camera,
                       sh_degree, view->n, frame->means, attr + frame->first * SPIN_ATTR,
                       splat2d + view->first);
    }
}

static __device__ bool all_zero(const struct spin_splat2d_grad &g)
{
    return g.u_px == 0 && g.v_px == 0 && g.conic[0] == 0 && g.conic[1] == 0 && g.conic[2] == 0 &&
           g.opacity == 0 && g.colour[0] == 0 && g.colour[1] == 0 && g.colour[2] == 0;
}

/* Replaces the attributes attr by their gradient, and adds the gradient of the position to d_pos_w.
 */
static __device__ void project_one_back(const struct spin_camera_f32 &cam, int degree,
                                        const float *pos_w, uint32_t flags,
                                        const struct spin_splat2d_grad &g, float *attr,
                                        float *d_pos_w)
{
    struct spin_projection lens = lens_of(cam);
    float *scale = attr + SPIN_ATTR_SCALE, *q = attr + SPIN_ATTR_ROTATION;
    float d_scale[3] = {}, d_q[4] = {}, d_pos[3] = {}, d_colour[3], d_rot[3][3];
    float distance, aa_compensation = 1, d_fade = 0;
    struct spin_projected_cov f;
    spin_vec3 view, d_view;

    spin_projected_cov_from(
        &lens, spin_to_camera(cam.r, cam.t, spin_v3(pos_w[0], pos_w[1], pos_w[2])), scale, q, &f);
    if (cam.antialias) {
        aa_compensation = spin_aa_compensation(&f);
        d_fade = g.opacity * attr[SPIN_ATTR_OPACITY];
    }
    spin_ellipse_adj(&lens, &f, scale, g.u_px, g.v_px, g.conic, d_fade, d_scale, d_rot, d_pos);
    spin_matrix_quat_adj(q, d_rot, d_q);
    for (int c = 0; c < 3; c++)
        d_colour[c] = flags >> c & 1 ? 0 : g.colour[c];
    view = spin_view_direction(cam.centre, pos_w, &distance);
    d_view = colour_back(degree, view, d_colour, attr + SPIN_ATTR_SH);
    spin_view_direction_adj(view, distance, d_view, d_pos);
    for (int k = 0; k < 3; k++)
        scale[k] = d_scale[k];
    for (int k = 0; k < 4; k++)
        q[k] = d_q[k];
    attr[SPIN_ATTR_OPACITY] = g.opacity * aa_compensation;
    for (int k = 0; k < 3; k++)
        d_pos_w[k] += d_pos[k];
}

static __global__ void __launch_bounds__(BLOCK, 5)
    project_back_kernel(struct spin_camera_f32 cam, int degree, size_t n, const float *means,
                        const float *attrs, const struct spin_splat2d *splat2d,
                        const struct spin_splat2d_grad *d_splat2d, float *d_attrs, float *d_means)
{
    __shared__ struct rows rows[BLOCK / WARP];
    size_t i = GPU_INDEX(), lane = threadIdx.x % WARP, first = i - lane;
    struct rows *mine = &rows[threadIdx.x / WARP];
    union {
        struct spin_splat2d_grad grad;
        float4 part[sizeof(struct spin_splat2d_grad) / sizeof(float4)];
    } in = {};
    bool some = i < n && splat2d[i].radius_px > 0;
    unsigned mask;

    for (size_t k = 0; k < sizeof in / sizeof(float4) && some; k++)
        in.part[k] = ((const float4 *)&d_splat2d[i])[k];
    some = some && !all_zero(in.grad);
    mask = __ballot_sync(all_lanes, some);
    if (!mask)
        return;
    load_rows(mine, attrs + SPIN_ATTR * first, mask, degree);
    if (some)
        project_one_back(cam, degree, means + 3 * i, splat2d[i].flags, in.grad, mine->of[lane],
                         d_means + 3 * i);
    add_rows(d_attrs + SPIN_ATTR * first, mine, mask, degree);
}

void cuda_project_back(struct spin_device *d, const struct spin_view_batch *views,
                       const struct spin_frame_batch *frames, const float *attr, int sh_degree,
                       const struct spin_splat2d *splat2d,
                       const struct spin_splat2d_grad *d_splat2d, float *d_attr)
{
    cuda_clocked clocked(d, SPIN_OP_PROJECT_BACK);
    /* Each view has its own launch, since views of the same frame add to the same rows. */
    for (int k = 0; k < views->n_views; k++) {
        const auto *view = &views->view[k];
        const auto *frame = &frames->frame[view->frame];

        if (view->n > 0)
            GPU_LAUNCH(gpu_of(d), project_back_kernel, blocks_of(view->n), BLOCK, view->camera,
                       sh_degree, view->n, frame->means, attr + frame->first * SPIN_ATTR,
                       splat2d + view->first, d_splat2d + view->first,
                       d_attr + frame->first * SPIN_ATTR, frame->d_means);
    }
}
