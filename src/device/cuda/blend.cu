/* Blends the splats of a tile front to back, and computes the gradients of the splats back to
 * front. Each tile has a block and each pixel a thread; the splats are loaded into shared memory in
 * batches. The formulas are those of math/blend.h. A warp covers 8 x 4 pixels, and skips the splats
 * of a batch whose alpha is below 1/255 in all of these pixels.
 *
 * In the backward pass, a block starts at the last splat that contributes to any of its pixels. A
 * warp processes two splats at a time, and each pixel stores its terms of the gradients of both
 * splats in shared memory. When the terms of eight splats are stored, each lane sums a row of eight
 * pixels for one splat, so four lanes work on each splat. The sums of the warps for a batch are
 * added in order. Each (splat, tile) pair writes its sums to its own slot, and the slots of a splat
 * are added in order. This needs no atomics and gives the same bits in every run. */
#include "device/cuda/cuda.h"
#include "device/pairs.h"
#include "math/blend.h"

enum {
    SIDE = SPIN_TILE,
    PIXELS = SIDE * SIDE,
    FRONT = PIXELS, /* number of splats in a batch of the forward pass */
    WARP = 32,
    WARP_X = 8, /* width and height of a warp's pixels */
    WARP_Y = WARP / WARP_X,
    WARPS = PIXELS / WARP,
    BACK = WARP,       /* number of splats in a batch of the backward pass */
    LOADED = 4 * BACK, /* number of splats that the backward pass loads at a time */
    TWO = 2,
    HELD = WARP / WARP_Y, /* number of splats whose terms a warp stores before it sums them */
    ROW = WARP_X / 4,     /* number of float4s that hold a row of a warp's pixels */
    VALUES = sizeof(struct spin_blend_sums) / sizeof(float)
};
static const unsigned all_lanes = 0xffffffffu;

struct picture {
    struct spin_camera_f32 cam;
    float background[3];
    float change[3]; /* is added to the background of pixels of known alpha */
    const uint8_t *matte;
    const struct spin_splat2d *splat2d;
    const uint32_t *lists, *start;
};

/* Returns channel c of the background of pixel i. */
static __device__ float background_of(const struct picture &p, size_t i, size_t c)
{
    return p.background[c] + (p.matte && p.matte[i] ? p.change[c] : 0);
}

/* Prepares a splat for blending as the CPU device does, with its position relative to the tile's
 * first pixel (x0, y0). */
static __device__ struct spin_blend_splat prepare_splat(const struct spin_splat2d *s, int x0,
                                                        int y0)
{
    return spin_blend_prepare(s->u_px - (float)x0, s->v_px - (float)y0, s->conic, s->opacity,
                              s->colour);
}

/* A splat of a batch, with the distances in x and y within which it may contribute. The struct is
 * aligned for 16-byte loads. */
struct alignas(16) front {
    struct spin_blend_splat splat;
    float reach_x, reach_y;
};

static __device__ struct front make_front(const struct spin_splat2d *s, int x0, int y0)
{
    struct front f;

    f.splat = prepare_splat(s, x0, y0);
    spin_blend_reach(f.splat.a, f.splat.b, f.splat.c, f.splat.log2_opacity, &f.reach_x, &f.reach_y);
    return f;
}

/* Returns whether the splat may contribute to a pixel of the warp whose first pixel is (x, y). */
static __device__ bool reaches_warp(const struct front *f, int x, int y)
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
    int in_x = warp_x + lane % WARP_X, in_y = warp_y + lane / WARP_X; /* relative to the tile */
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
            near = __ballot_sync(all_lanes, i < count && reaches_warp(&batch[i], warp_x, warp_y));
            for (; near; near &= near - 1) {
                struct spin_blend_splat s;

                i = from + (uint32_t)__ffs((int)near) - 1;
                s = batch[i].splat;
                if (spin_blend_step(&s, s.u_px - (float)in_x, s.v_px - (float)in_y, &pixel))
                    used = (int32_t)(at + i) + 1;
            }
        }
    }
    if (inside) {
        size_t plane = (size_t)p.cam.width * (size_t)p.cam.height;
        size_t to = (size_t)y * (size_t)p.cam.width + (size_t)x;

        for (size_t c = 0; c < 3; c++)
            image[c * plane + to] = pixel.colour[c] + pixel.t * background_of(p, to, c);
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
    memcpy(p.change, views->view[k].background_change, sizeof p.change);
    p.matte = views->view[k].matte;
    p.splat2d = splat2d + views->view[k].first;
    p.lists = tiles->intersections;
    p.start = tiles->start + (size_t)k * (views->max_tiles + 1);
    return p;
}

void cuda_blend(struct spin_device *d, const struct spin_view_batch *views,
                const struct spin_splat2d *splat2d, const struct spin_tiles *tiles, float *image,
                float *final_transmittance, int32_t *last_contributor)
{
    cuda_clocked clocked(d, SPIN_OP_BLEND);
    for (int k = 0; k < views->n_views; k++) {
        struct picture p = picture_of(views, k, splat2d, tiles);
        size_t at = (size_t)k * views->max_pixels;

        GPU_LAUNCH(gpu_of(d), blend_kernel, (unsigned)(p.cam.tiles_x * p.cam.tiles_y), PIXELS, p,
                   image + 3 * at, final_transmittance + at, last_contributor + at);
    }
}

/* Renders depth with one thread per pixel. Warps do not skip splats, since depth is only rendered
 * for output and never in training. */
static __global__ void depth_kernel(struct picture p, float *depth)
{
    int tile = (int)blockIdx.x, in_x = (int)threadIdx.x % SIDE, in_y = (int)threadIdx.x / SIDE;
    int x0 = tile % p.cam.tiles_x * SIDE, y0 = tile / p.cam.tiles_x * SIDE;
    size_t plane = (size_t)p.cam.width * (size_t)p.cam.height;
    size_t to = (size_t)(y0 + in_y) * (size_t)p.cam.width + (size_t)(x0 + in_x);
    struct spin_blend_pixel pixel = {1, {0, 0, 0}, 0};

    if (x0 + in_x >= p.cam.width || y0 + in_y >= p.cam.height)
        return;
    for (uint32_t k = p.start[tile]; k < p.start[tile + 1] && !pixel.stopped; k++) {
        struct spin_blend_splat s = prepare_splat(p.splat2d + p.lists[k], x0, y0);

        s.colour[0] = p.splat2d[p.lists[k]].depth;
        s.colour[1] = 1;
        s.colour[2] = 0;
        spin_blend_depth(&s, s.u_px - (float)in_x, s.v_px - (float)in_y, &pixel);
    }
    depth[to] = spin_blend_expected(&pixel);
    depth[plane + to] = pixel.colour[2];
}

void cuda_depth(struct spin_device *d, const struct spin_view_batch *views,
                const struct spin_splat2d *splat2d, const struct spin_tiles *tiles, float *depth)
{
    cuda_clocked clocked(d, SPIN_OP_BLEND);
    for (int k = 0; k < views->n_views; k++) {
        struct picture p = picture_of(views, k, splat2d, tiles);

        GPU_LAUNCH(gpu_of(d), depth_kernel, (unsigned)(p.cam.tiles_x * p.cam.tiles_y), PIXELS, p,
                   depth + 2 * (size_t)k * views->max_pixels);
    }
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
    to->absolute_u += more.absolute_u;
    to->absolute_v += more.absolute_v;
}

/* Terms of up to HELD splats for the pixels of a warp: a row for each splat, with a value for each
 * lane. Rows are padded so that lanes that read different rows use different banks. */
struct held {
    float4 weight[HELD][WARP / 4 + 1], de[HELD][WARP / 4 + 1];
};

static __device__ float at_of(const float4 &v, int k)
{
    return k == 0 ? v.x : k == 1 ? v.y : k == 2 ? v.z : v.w;
}

/* Returns the sums of one splat over one row of a warp's pixels. g [3] is the gradient of the image
 * at the warp's pixels, `weight` and `de` are the splat's terms, and (dx, dy) is the offset from
 * the row's first pixel to the splat. */
template <bool absolute>
static __device__ struct spin_blend_sums
sums_of_row(const struct spin_blend_splat &s, const float4 *weight, const float4 *de,
            const float4 (*g)[WARP / 4], int row, float dx, float dy)
{
    struct spin_blend_sums sums = {};

    for (int q = 0; q < ROW; q++)
        for (int k = 0; k < 4; k++) {
            float e = at_of(de[q], k), w = at_of(weight[q], k), x = dx - (float)(4 * q + k);

            for (int c = 0; c < 3; c++)
                sums.colour[c] += w * at_of(g[c][row * ROW + q], k);
            sums.e += e;
            sums.ex += e * x;
            sums.exx += e * x * x;
            if (absolute)
                spin_blend_add_absolute(&s, e, x, dy, &sums);
        }
    sums.ey = sums.e * dy;
    sums.exy = sums.ex * dy;
    sums.eyy = sums.ey * dy;
    return sums;
}

/* Adds up the sums of a splat over the rows of a warp. WARP_Y neighbouring lanes contain the sums
 * of one row each. */
template <bool absolute> static __device__ void add_rows(struct spin_blend_sums *sums)
{
    for (int by = 1; by < WARP_Y; by *= 2) {
        struct spin_blend_sums other = {};

        for (int c = 0; c < 3; c++)
            other.colour[c] = __shfl_xor_sync(all_lanes, sums->colour[c], by);
        other.e = __shfl_xor_sync(all_lanes, sums->e, by);
        other.ex = __shfl_xor_sync(all_lanes, sums->ex, by);
        other.ey = __shfl_xor_sync(all_lanes, sums->ey, by);
        other.exx = __shfl_xor_sync(all_lanes, sums->exx, by);
        other.exy = __shfl_xor_sync(all_lanes, sums->exy, by);
        other.eyy = __shfl_xor_sync(all_lanes, sums->eyy, by);
        if (absolute) {
            other.absolute_u = __shfl_xor_sync(all_lanes, sums->absolute_u, by);
            other.absolute_v = __shfl_xor_sync(all_lanes, sums->absolute_v, by);
        }
        add_sums(sums, other);
    }
}

/* Computes the sums over a warp's pixels for the n splats in `held`, and stores each in part
 * [BACK]. `mine` is the index in the batch of the splat on which this lane works. */
template <bool absolute>
static __device__ void add_held(const struct held &held, int n, uint32_t mine,
                                const struct front *batch, const float4 (*g)[WARP / 4], int warp_x,
                                int warp_y, struct spin_blend_sums *part)
{
    int lane = (int)threadIdx.x % WARP, of = lane / WARP_Y, row = lane % WARP_Y;
    struct spin_blend_sums sums = {};

    __syncwarp(all_lanes);
    if (of < n) {
        const struct spin_blend_splat &s = batch[mine].splat;

        sums = sums_of_row<absolute>(s, held.weight[of] + row * ROW, held.de[of] + row * ROW, g,
                                     row, s.u_px - (float)warp_x, s.v_px - (float)(warp_y + row));
    }
    add_rows<absolute>(&sums);
    if (of < n && row == 0)
        part[mine] = sums;
}

/* Runs the backward step for two splats of a batch and stores their terms in `held`; if `two` is
 * false, for the first splat only. The instructions for the two splats are independent and hide
 * each other's latency. `used` is the pixel's last contributor, relative to the batch. Returns
 * false and stores nothing if neither splat contributes to a pixel of the warp. */
static __device__ bool blend_two_back(const struct front *batch, const uint32_t i[TWO], bool two,
                                      int32_t used, int in_x, int in_y,
                                      struct spin_blend_pixel_adj *pixel, struct held *held,
                                      int n_held)
{
    int lane = (int)threadIdx.x % WARP;
    struct spin_blend_splat s[TWO];
    float power[TWO];
    bool counts[TWO];

    for (int k = 0; k < TWO; k++) {
        s[k] = batch[i[k]].splat;
        power[k] = spin_blend_power(&s[k], s[k].u_px - (float)in_x, s[k].v_px - (float)in_y);
        counts[k] = (used > (int32_t)i[k]) & spin_blend_counts(power[k], s[k].log2_opacity);
    }
    counts[1] &= two;
    if (!__any_sync(all_lanes, counts[0] | counts[1]))
        return false;
    for (int k = 0; k < TWO; k++) {
        struct spin_blend_pixel_adj after = *pixel;
        float w, e;

        spin_blend_pixel_adj(&s[k], power[k], &after, &w, &e);
        pixel->t = counts[k] ? after.t : pixel->t;
        pixel->s = counts[k] ? after.s : pixel->s;
        ((float *)held->weight[n_held + k])[lane] = counts[k] ? w : 0;
        ((float *)held->de[n_held + k])[lane] = counts[k] ? e : 0;
    }
    return true;
}

static __device__ uint32_t most_of_warp(uint32_t v)
{
    for (int by = WARP / 2; by > 0; by /= 2) {
        uint32_t other = __shfl_xor_sync(all_lanes, v, by);

        v = other > v ? other : v;
    }
    return v;
}

/* Shared memory of the backward pass. */
struct back_shared {
    struct front loaded[LOADED];
    struct held held[WARPS];
    float4 g[WARPS][3][WARP / 4];
    struct spin_blend_sums part[WARPS][BACK];
    uint32_t slot[LOADED], seen_by[WARPS], last_of[WARPS];
};

template <bool absolute>
static __device__ __forceinline__ void
blend_back(const struct picture &p, const float *final_transmittance,
           const int32_t *last_contributor, const float *d_image, struct spin_blend_sums *slots,
           struct back_shared &m)
{
    struct front *loaded = m.loaded;
    struct held *held = m.held;
    auto &g = m.g;
    auto &part = m.part;
    uint32_t *slot = m.slot, *seen_by = m.seen_by, *last_of = m.last_of;
    int me = (int)threadIdx.x, tile = (int)blockIdx.x, lane = me % WARP, warp = me / WARP;
    int tile_x = tile % p.cam.tiles_x, tile_y = tile / p.cam.tiles_x;
    int warp_x = warp % (SIDE / WARP_X) * WARP_X, warp_y = warp / (SIDE / WARP_X) * WARP_Y;
    int in_x = warp_x + lane % WARP_X, in_y = warp_y + lane / WARP_X; /* relative to the tile */
    int x = tile_x * SIDE + in_x, y = tile_y * SIDE + in_y;
    uint32_t first = p.start[tile], n = p.start[tile + 1] - first, last = 0, warp_last;
    uint32_t used = 0;
    struct spin_blend_pixel_adj pixel = {};

    if (x < p.cam.width && y < p.cam.height) {
        size_t plane = (size_t)p.cam.width * (size_t)p.cam.height;
        size_t at = (size_t)y * (size_t)p.cam.width + (size_t)x;

        used = (uint32_t)last_contributor[at];
        pixel.t = final_transmittance[at];
        for (size_t c = 0; c < 3; c++) {
            pixel.g[c] = d_image[c * plane + at];
            pixel.s += pixel.t * pixel.g[c] * background_of(p, at, c);
        }
    }
    for (int c = 0; c < 3; c++)
        ((float *)g[warp][c])[lane] = pixel.g[c];
    warp_last = most_of_warp(used);
    if (lane == 0)
        last_of[warp] = warp_last;
    __syncthreads();
    for (int w = 0; w < WARPS; w++)
        last = last_of[w] > last ? last_of[w] : last;
    /* Splats behind the last contributors of all pixels have no gradient: set their slots to zero.
     */
    for (uint32_t k = last + (uint32_t)me; k < n; k += PIXELS) {
        struct spin_blend_sums none = {};

        slots[slot_of(p.splat2d + p.lists[first + k], tile_x, tile_y)] = none;
    }
    for (uint32_t batches = (last + BACK - 1) / BACK; batches > 0; batches--) {
        uint32_t at = (batches - 1) * BACK, count = last - at < BACK ? last - at : (uint32_t)BACK;
        uint32_t in = at % LOADED, seen = 0, mine = 0;
        int n_held = 0;
        unsigned near;

        /* A group of batches is loaded when its last batch is reached, which is processed first,
         * since the pass runs from back to front. */
        if (in + BACK == LOADED || at + BACK >= last) {
            if ((uint32_t)me < in + count) {
                const struct spin_splat2d *s = p.splat2d + p.lists[first + at - in + (uint32_t)me];

                loaded[me] = make_front(s, tile_x * SIDE, tile_y * SIDE);
                slot[me] = (uint32_t)slot_of(s, tile_x, tile_y);
            }
            __syncthreads();
        }
        near = __ballot_sync(all_lanes, at + (uint32_t)lane < warp_last &&
                                            reaches_warp(&loaded[in + lane], warp_x, warp_y));
        while (near) {
            uint32_t i[TWO];
            bool two = (near & (near - 1)) != 0;

            i[0] = WARP - 1 - (uint32_t)__clz((int)near);
            near ^= 1u << i[0];
            i[1] = two ? WARP - 1 - (uint32_t)__clz((int)near) : i[0];
            near &= ~(1u << i[1]);
            if (!blend_two_back(&loaded[in], i, two, (int32_t)(used - at), in_x, in_y, &pixel,
                                &held[warp], n_held))
                continue;
            seen |= 1u << i[0] | 1u << i[1];
            mine = lane / WARP_Y == n_held ? i[0] : lane / WARP_Y == n_held + 1 ? i[1] : mine;
            n_held += two ? 2 : 1;
            if (n_held < HELD)
                continue;
            add_held<absolute>(held[warp], n_held, mine, &loaded[in], g[warp], warp_x, warp_y,
                               part[warp]);
            __syncwarp(all_lanes);
            n_held = 0;
        }
        if (n_held > 0)
            add_held<absolute>(held[warp], n_held, mine, &loaded[in], g[warp], warp_x, warp_y,
                               part[warp]);
        if (lane == 0)
            seen_by[warp] = seen;
        __syncthreads();
        for (uint32_t j = (uint32_t)me; j < count * VALUES; j += PIXELS) {
            uint32_t of = j / VALUES;
            float sum = 0;

            for (int w = 0; w < WARPS; w++)
                if (seen_by[w] >> of & 1)
                    sum += ((const float *)part[w])[j];
            ((float *)&slots[slot[in + of]])[j % VALUES] = sum;
        }
        __syncthreads();
    }
}

static __global__ void __launch_bounds__(PIXELS, 5)
    blend_back_kernel(struct picture p, const float *final_transmittance,
                      const int32_t *last_contributor, const float *d_image,
                      struct spin_blend_sums *slots)
{
    __shared__ struct back_shared shared;

    blend_back<false>(p, final_transmittance, last_contributor, d_image, slots, shared);
}

/* With absolute values, a thread needs more registers. */
static __global__ void __launch_bounds__(PIXELS, 4)
    blend_absolute_kernel(struct picture p, const float *final_transmittance,
                          const int32_t *last_contributor, const float *d_image,
                          struct spin_blend_sums *slots)
{
    __shared__ struct back_shared shared;

    blend_back<true>(p, final_transmittance, last_contributor, d_image, slots, shared);
}

/* Adds up the slots of each splat, and computes the gradient of the splat from these sums. */
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
        spin_blend_finish_absolute(&sum, &d.absolute_u_px, &d.absolute_v_px);
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

    auto *kernel = views->absolute ? blend_absolute_kernel : blend_back_kernel;

    if (!slots)
        return;
    cuda_clocked clocked(d, SPIN_OP_BLEND_BACK);
    for (int k = 0; k < views->n_views; k++) {
        const auto *view = &views->view[k];
        struct picture p = picture_of(views, k, splat2d, tiles);
        size_t at = (size_t)k * views->max_pixels;

        GPU_LAUNCH(gpu_of(d), kernel, (unsigned)(p.cam.tiles_x * p.cam.tiles_y), PIXELS, p,
                   final_transmittance + at, last_contributor + at, d_image + 3 * at, slots);
        GPU_EACH(gpu_of(d), view->n, reduce_kernel, view->n, splat2d + view->first, slots,
                 d_splat2d + view->first);
    }
}
