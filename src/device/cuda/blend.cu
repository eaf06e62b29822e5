/* Alpha blending of the splats of a tile, front to back, and its gradient, back to front. A block has a tile, a thread
 * a pixel of it; the splats come in batches through shared memory. The formulas are math/blend.h's. Forwards a warp has
 * 8 x 4 pixels, and passes over the splats of a batch whose alpha is below 1/255 in all of them.
 *
 * Backwards, a batch is first visited by the pixels, which leave what a splat is to them in shared memory; then by
 * threads that have a splat and a part of the pixels. Each (splat, tile) pair writes its sums to a slot of its own, and
 * the slots of a splat are added in order: no atomics, the same bits every time. */
#include "device/cuda/cuda.h"
#include "device/pairs.h"
#include "math/blend.h"

enum {
    SIDE = SPIN_TILE,
    PIXELS = SIDE * SIDE,
    FRONT = PIXELS,
    BACK = 16,
    PARTS = PIXELS / BACK,
    WARP = 32,
    WARP_X = 8,
    WARP_Y = WARP / WARP_X
};
static const unsigned all_lanes = 0xffffffffu;

struct picture {
    struct spin_camera_f32 cam;
    float background[3];
    const struct spin_splat2d *splat2d;
    const uint32_t *lists, *start;
};

/* Offsets from the tile's first pixel, as on the CPU. */
static __device__ struct spin_blend_splat make_ready(const struct spin_splat2d *s, int x0, int y0)
{
    return spin_blend_prepare(s->u_px - (float)x0, s->v_px - (float)y0, s->conic, s->opacity,
                              s->colour);
}

/* A splat of a batch, and how far it reaches. */
struct front {
    struct spin_blend_splat splat;
    float reach_x, reach_y;
};

static __device__ struct front make_front(const struct spin_splat2d *s, int x0, int y0)
{
    struct front f;

    f.splat = make_ready(s, x0, y0);
    spin_blend_reach(f.splat.a, f.splat.b, f.splat.c, f.splat.log2_opacity, &f.reach_x, &f.reach_y);
    return f;
}

/* Whether it may show in a warp's pixels, of which (x, y) is the first. */
static __device__ bool comes_near(const struct front *f, int x, int y)
{
    float dx = f->splat.u_px - (float)x, dy = f->splat.v_px - (float)y;

    return !(dx + f->reach_x < 0 || dx - f->reach_x > WARP_X - 1 || dy + f->reach_y < 0 ||
             dy - f->reach_y > WARP_Y - 1);
}

static __global__ void blend_kernel(struct picture p, float *image, float *final_transmittance,
                                    int32_t *last_contributor)
{
    __shared__ struct front batch[FRONT];
    int me = (int)threadIdx.x, tile = (int)blockIdx.x, lane = me % WARP, warp = me / WARP;
    int x0 = tile % p.cam.tiles_x * SIDE, y0 = tile / p.cam.tiles_x * SIDE;
    int warp_x = warp % (SIDE / WARP_X) * WARP_X, warp_y = warp / (SIDE / WARP_X) * WARP_Y;
    int in_x = warp_x + lane % WARP_X, in_y = warp_y + lane / WARP_X; /* of the tile */
    int x = x0 + in_x, y = y0 + in_y;
    bool inside = x < p.cam.width && y < p.cam.height;
    uint32_t first = p.start[tile], n = p.start[tile + 1] - first;
    struct spin_blend_pixel pixel = {1, {0, 0, 0}, !inside};
    int32_t used = 0;

    for (uint32_t at = 0; at < n; at += FRONT) {
        uint32_t count = n - at < FRONT ? n - at : (uint32_t)FRONT;

        if (__syncthreads_and(pixel.stopped))
            break;
        if ((uint32_t)me < count)
            batch[me] = make_front(p.splat2d + p.lists[first + at + (uint32_t)me], x0, y0);
        __syncthreads();
        for (uint32_t from = 0; from < count; from += WARP) {
            uint32_t i = from + (uint32_t)lane;
            unsigned near;

            if (__all_sync(all_lanes, pixel.stopped))
                break;
            near = __ballot_sync(all_lanes, i < count && comes_near(&batch[i], warp_x, warp_y));
            for (; near; near &= near - 1) {
                const struct spin_blend_splat *s;

                i = from + (uint32_t)__ffs((int)near) - 1;
                s = &batch[i].splat;
                if (spin_blend_step(s, s->u_px - (float)in_x, s->v_px - (float)in_y, &pixel))
                    used = (int32_t)(at + i) + 1;
            }
        }
    }
    if (inside) {
        size_t plane = (size_t)p.cam.width * (size_t)p.cam.height;
        size_t to = (size_t)y * (size_t)p.cam.width + (size_t)x;

        for (size_t c = 0; c < 3; c++)
            image[c * plane + to] = pixel.colour[c] + pixel.t * p.background[c];
        final_transmittance[to] = pixel.t;
        last_contributor[to] = used;
    }
}

static struct picture picture_of(const struct spin_view_batch *views, int k,
                                 const struct spin_splat2d *splat2d, const struct spin_tiles *tiles)
{
    struct picture p = {};

    p.cam = views->view[k].camera;
    memcpy(p.background, views->background, sizeof p.background);
    p.splat2d = splat2d + views->view[k].first;
    p.lists = tiles->intersections;
    p.start = tiles->start + (size_t)k * (views->max_tiles + 1);
    return p;
}

void cuda_blend(struct spin_device *d, const struct spin_view_batch *views,
                const struct spin_splat2d *splat2d, const struct spin_tiles *tiles, float *image,
                float *final_transmittance, int32_t *last_contributor)
{
    cuda_begin(d, SPIN_OP_BLEND);
    for (int k = 0; k < views->n_views; k++) {
        struct picture p = picture_of(views, k, splat2d, tiles);
        size_t at = (size_t)k * views->max_pixels;

        GPU_LAUNCH(gpu_of(d), blend_kernel, (unsigned)(p.cam.tiles_x * p.cam.tiles_y), PIXELS, p,
                   image + 3 * at, final_transmittance + at, last_contributor + at);
    }
    cuda_end(d, SPIN_OP_BLEND);
}

/* ---- Backward -------------------------------------------------------------------------------- */

static __device__ size_t slot_of(const struct spin_splat2d *s, int tile_x, int tile_y)
{
    struct spin_pair_rect r = spin_pair_rect(s);

    return s->first_intersection + (size_t)(tile_y - r.y0) * (size_t)(r.x1 - r.x0) +
           (size_t)(tile_x - r.x0);
}

static __device__ void add_sums(struct spin_blend_sums *to, const struct spin_blend_sums &more)
{
    for (int c = 0; c < 3; c++)
        to->colour[c] += more.colour[c];
    to->e += more.e;
    to->ex += more.ex;
    to->ey += more.ey;
    to->exx += more.exx;
    to->exy += more.exy;
    to->eyy += more.eyy;
}

static __global__ void blend_back_kernel(struct picture p, const float *final_transmittance,
                                         const int32_t *last_contributor, const float *d_image,
                                         struct spin_blend_sums *slots)
{
    __shared__ struct spin_blend_splat batch[BACK];
    __shared__ float weight[BACK][PIXELS + 1], de[BACK][PIXELS + 1], g[3][PIXELS];
    __shared__ struct spin_blend_sums part[BACK][PARTS];
    int me = (int)threadIdx.x, tile = (int)blockIdx.x;
    int tile_x = tile % p.cam.tiles_x, tile_y = tile / p.cam.tiles_x;
    int x = tile_x * SIDE + me % SIDE, y = tile_y * SIDE + me / SIDE;
    uint32_t first = p.start[tile], n = p.start[tile + 1] - first;
    struct spin_blend_pixel_adj pixel = {};
    int32_t used = 0;

    if (x < p.cam.width && y < p.cam.height) {
        size_t plane = (size_t)p.cam.width * (size_t)p.cam.height;
        size_t at = (size_t)y * (size_t)p.cam.width + (size_t)x;

        used = last_contributor[at];
        pixel.t = final_transmittance[at];
        for (size_t c = 0; c < 3; c++) {
            pixel.g[c] = d_image[c * plane + at];
            pixel.s += pixel.t * pixel.g[c] * p.background[c];
        }
    }
    for (int c = 0; c < 3; c++)
        g[c][me] = pixel.g[c];
    for (uint32_t batches = (n + BACK - 1) / BACK; batches > 0; batches--) {
        uint32_t at = (batches - 1) * BACK, count = n - at < BACK ? n - at : (uint32_t)BACK;
        uint32_t splat = (uint32_t)me / PARTS, k = (uint32_t)me % PARTS;
        struct spin_blend_sums sums = {};

        if ((uint32_t)me < count)
            batch[me] = make_ready(p.splat2d + p.lists[first + at + (uint32_t)me], tile_x * SIDE,
                                   tile_y * SIDE);
        __syncthreads();
        for (uint32_t i = count; i-- > 0;) {
            float dx = batch[i].u_px - (float)(me % SIDE), dy = batch[i].v_px - (float)(me / SIDE);
            float w = 0, e = 0;

            if (used > (int32_t)(at + i) &&
                spin_blend_counts(spin_blend_power(&batch[i], dx, dy), batch[i].log2_opacity))
                spin_blend_pixel_adj(&batch[i], dx, dy, &pixel, &w, &e);
            weight[i][me] = w;
            de[i][me] = e;
        }
        __syncthreads();
        for (uint32_t j = k; splat < count && j < PIXELS; j += PARTS) {
            float of_pixel[3] = {g[0][j], g[1][j], g[2][j]};

            spin_blend_add_adj(of_pixel, weight[splat][j], de[splat][j],
                               batch[splat].u_px - (float)(j % SIDE),
                               batch[splat].v_px - (float)(j / SIDE), &sums);
        }
        part[splat][k] = sums;
        __syncthreads();
        if (splat < count && k == 0) {
            for (int other = 1; other < PARTS; other++)
                add_sums(&sums, part[splat][other]);
            slots[slot_of(p.splat2d + p.lists[first + at + splat], tile_x, tile_y)] = sums;
        }
    }
}

/* Adds the slots of each splat, and finishes. */
static __global__ void reduce_kernel(size_t n, const struct spin_splat2d *splat2d,
                                     const struct spin_blend_sums *slots,
                                     struct spin_splat2d_grad *d_splat2d)
{
    size_t i = GPU_INDEX();
    struct spin_splat2d_grad d = {};
    struct spin_blend_sums sum;
    uint32_t pairs;

    if (i >= n)
        return;
    pairs = spin_pair_count(spin_pair_rect(&splat2d[i]));
    if (pairs > 0) {
        slots += splat2d[i].first_intersection;
        sum = slots[0];
        for (uint32_t k = 1; k < pairs; k++)
            add_sums(&sum, slots[k]);
        spin_blend_finish_adj(splat2d[i].conic, splat2d[i].opacity, &sum, &d.u_px, &d.v_px, d.conic,
                              &d.opacity);
        for (int c = 0; c < 3; c++)
            d.colour[c] = sum.colour[c];
    }
    d_splat2d[i] = d;
}

void cuda_blend_back(struct spin_device *d, const struct spin_view_batch *views,
                     const struct spin_splat2d *splat2d, const struct spin_tiles *tiles,
                     const float *final_transmittance, const int32_t *last_contributor,
                     const float *d_image, struct spin_splat2d_grad *d_splat2d)
{
    uint64_t most =
        tiles->n_intersections < SPIN_MAX_PAIRS ? tiles->n_intersections : SPIN_MAX_PAIRS;
    struct spin_blend_sums *slots =
        (struct spin_blend_sums *)cuda_scratch(d, CUDA_SCRATCH_BLEND, (most + 1) * sizeof *slots);

    if (!slots)
        return;
    cuda_begin(d, SPIN_OP_BLEND_BACK);
    for (int k = 0; k < views->n_views; k++) {
        const auto *view = &views->view[k];
        struct picture p = picture_of(views, k, splat2d, tiles);
        size_t at = (size_t)k * views->max_pixels;

        GPU_LAUNCH(gpu_of(d), blend_back_kernel, (unsigned)(p.cam.tiles_x * p.cam.tiles_y), PIXELS,
                   p, final_transmittance + at, last_contributor + at, d_image + 3 * at, slots);
        GPU_EACH(gpu_of(d), view->n, reduce_kernel, view->n, splat2d + view->first, slots,
                 d_splat2d + view->first);
    }
    cuda_end(d, SPIN_OP_BLEND_BACK);
}
