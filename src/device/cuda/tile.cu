/* Lists the splats of every tile, front to back: sorts the splats by depth, writes their (splat,
 * tile) pairs in this order, and sorts the pairs by tile. The sorts are stable. A tile in which the
 * alpha of a splat is below 1/255 everywhere gets no pair, even if it is inside the splat's
 * rectangle. */
#include "device/cuda/cuda.h"
#include "device/pairs.h"
#include "math/blend.h"
#include "math/tile.h"

static __device__ uint8_t byte_of(int v) { return (uint8_t)(v > 255 ? 255 : v); }

/* Numbers the splats of all views, one view after the other: the splats of view k have the numbers
 * [at[k], at[k + 1]), and start at index first[k] in splat2d. */
struct all_views {
    int n;
    size_t at[SPIN_MAX_VIEWS + 1], first[SPIN_MAX_VIEWS];
};

static struct all_views all_of(const struct spin_view_batch *views)
{
    struct all_views all = {};

    all.n = views->n_views;
    for (int k = 0; k < all.n; k++) {
        all.first[k] = views->view[k].first;
        all.at[k + 1] = all.at[k] + views->view[k].n;
    }
    return all;
}

/* Returns the view to which splat number i of all views belongs. */
static __device__ int view_of(const struct all_views &all, size_t i)
{
    int k = 0;

    while (i >= all.at[k + 1])
        k++;
    return k;
}

/* Sets tile_cull of each splat, and count [n + 1] to the number of pairs of each splat, followed by
 * 0. */
static __global__ void cull_kernel(struct all_views all, struct spin_splat2d *splat2d,
                                   uint64_t *count)
{
    size_t i = GPU_INDEX();
    int view;
    struct spin_splat2d s, *to;

    if (i == all.at[all.n])
        count[i] = 0;
    if (i >= all.at[all.n])
        return;
    view = view_of(all, i);
    to = splat2d + all.first[view] + (i - all.at[view]);
    s = *to;
    for (int k = 0; k < 4; k++)
        s.tile_cull[k] = 0;
    if (s.radius_px > 0) {
        float a = s.conic[0], b = s.conic[1], c = s.conic[2], reach_x, reach_y;
        float log2_opacity = spin_blend_scale(&a, &b, &c, s.opacity);
        int x0 = s.x0, y0 = s.y0, x1 = s.x1, y1 = s.y1;

        spin_blend_reach(a, b, c, log2_opacity, &reach_x, &reach_y);
        spin_tile_narrow(s.u_px, reach_x, &x0, &x1);
        spin_tile_narrow(s.v_px, reach_y, &y0, &y1);
        s.tile_cull[0] = byte_of(x0 - s.x0);
        s.tile_cull[1] = byte_of(y0 - s.y0);
        s.tile_cull[2] = byte_of(s.x1 - x1);
        s.tile_cull[3] = byte_of(s.y1 - y1);
    }
    for (int k = 0; k < 4; k++)
        to->tile_cull[k] = s.tile_cull[k];
    count[i] = spin_pair_count(spin_pair_rect(&s));
}

/* Sets first_intersection of each splat, counted from the start of its view, and pairs [views] to
 * the number of pairs of each view. before [n + 1] contains the exclusive prefix sums of the
 * counts. */
static __global__ void first_kernel(struct all_views all, const uint64_t *before,
                                    struct spin_splat2d *splat2d, uint64_t *pairs)
{
    size_t i = GPU_INDEX();

    if (i < (size_t)all.n)
        pairs[i] = before[all.at[i + 1]] - before[all.at[i]];
    if (i < all.at[all.n]) {
        int view = view_of(all, i);

        splat2d[all.first[view] + (i - all.at[view])].first_intersection =
            (uint32_t)(before[i] - before[all.at[view]]);
    }
}

/* Counts the pairs of each view, and waits until the numbers are in host memory, pairs [views]. */
static spin_status count_pairs(struct spin_device *d, const struct spin_view_batch *views,
                               struct spin_splat2d *splat2d, uint64_t *pairs)
{
    struct all_views all = all_of(views);
    size_t n = all.at[all.n], most = n > SPIN_MAX_VIEWS ? n : (size_t)SPIN_MAX_VIEWS;
    uint64_t *count = (uint64_t *)cuda_scratch(d, CUDA_SCRATCH_TILE,
                                               (2 * (n + 1) + SPIN_MAX_VIEWS) * sizeof *count);
    uint64_t *before = count + n + 1, *pairs_here = before + n + 1;

    if (!count)
        return d->op->wait(d);
    GPU_EACH(gpu_of(d), n + 1, cull_kernel, all, splat2d, count);
    if (!cuda_scan(d, count, before, n + 1))
        return d->op->wait(d);
    GPU_EACH(gpu_of(d), most, first_kernel, all, before, splat2d, pairs_here);
    return d->op->download(d, pairs, pairs_here, (size_t)all.n * sizeof *pairs);
}

spin_status cuda_tile_count(struct spin_device *d, const struct spin_view_batch *views,
                            struct spin_splat2d *splat2d, struct spin_tiles *tiles)
{
    uint64_t sum = 0, *pairs = cuda_of(d)->view_pairs;
    cuda_clocked clocked(d, SPIN_OP_TILE);

    tiles->n_intersections = 0;
    SPIN_TRY(count_pairs(d, views, splat2d, pairs));
    for (int k = 0; k < views->n_views; k++) {
        SPIN_TRY(cuda_pairs_fit(pairs[k], sum));
        sum += pairs[k];
    }
    tiles->n_intersections = sum;
    return SPIN_OK;
}

/* ---- Filling --------------------------------------------------------------------------------- */

static __global__ void depth_kernel(size_t n, const struct spin_splat2d *splat2d, uint32_t *key,
                                    uint32_t *splat)
{
    size_t i = GPU_INDEX();

    if (i >= n)
        return;
    key[i] = spin_depth_key(splat2d[i].depth);
    splat[i] = (uint32_t)i;
}

static __global__ void count_kernel(size_t n, const struct spin_splat2d *splat2d,
                                    const uint32_t *order, uint64_t *count)
{
    size_t i = GPU_INDEX();

    if (i < n)
        count[i] = spin_pair_count(spin_pair_rect(&splat2d[order[i]]));
}

/* Writes the tile and the splat of all pairs, in the order of depth. */
static __global__ void pairs_kernel(size_t n, int tiles_x, const struct spin_splat2d *splat2d,
                                    const uint32_t *order, const uint64_t *before, uint32_t *tile,
                                    uint32_t *splat)
{
    size_t i = GPU_INDEX(), at;
    struct spin_pair_rect r;

    if (i >= n)
        return;
    at = before[i];
    r = spin_pair_rect(&splat2d[order[i]]);
    for (int y = r.y0; y < r.y1; y++)
        for (int x = r.x0; x < r.x1; x++, at++) {
            tile[at] = (uint32_t)(y * tiles_x + x);
            splat[at] = order[i];
        }
}

/* Computes start [n_tiles + 1]: start[i] is `first` plus the index of the first pair whose tile is
 * i or greater. */
static __global__ void start_kernel(size_t n_tiles, const uint32_t *tile, size_t n_pairs,
                                    uint32_t first, uint32_t *start)
{
    size_t i = GPU_INDEX(), low = 0, high = n_pairs;

    if (i > n_tiles)
        return;
    while (low < high) {
        size_t middle = (low + high) / 2;

        if (tile[middle] < i)
            low = middle + 1;
        else
            high = middle;
    }
    start[i] = first + (uint32_t)low;
}

static int bits_of(size_t most)
{
    int bits = 1;

    while (most >> bits)
        bits++;
    return bits;
}

/* Fills the lists of one view. The scratch memory contains four 32-bit and two 64-bit arrays [n]
 * for the splats, then three 32-bit arrays [pairs]. */
static spin_status fill_view(struct spin_device *d, const spin_view_batch::spin_view_of_batch *view,
                             const struct spin_splat2d *splat2d, size_t pairs, uint32_t first,
                             uint32_t *lists, uint32_t *start)
{
    size_t n = view->n, n_tiles = (size_t)view->camera.tiles_x * (size_t)view->camera.tiles_y;
    size_t splats = cuda_round_up(n * sizeof(uint32_t)),
           places = cuda_round_up(n * sizeof(uint64_t));
    size_t rooms = cuda_round_up(pairs * sizeof(uint32_t));
    char *at = (char *)cuda_scratch(d, CUDA_SCRATCH_TILE, 4 * splats + 2 * places + 3 * rooms);
    uint32_t *key = (uint32_t *)at, *sorted_key = (uint32_t *)(at + splats);
    uint32_t *splat = (uint32_t *)(at + 2 * splats), *order = (uint32_t *)(at + 3 * splats);
    uint64_t *count = (uint64_t *)(at + 4 * splats),
             *before = (uint64_t *)(at + 4 * splats + places);
    uint32_t *tile = (uint32_t *)(at + 4 * splats + 2 * places);
    uint32_t *sorted_tile = tile + rooms / sizeof *tile,
             *of_pair = sorted_tile + rooms / sizeof *tile;

    if (!at)
        return d->op->wait(d);
    GPU_EACH(gpu_of(d), n, depth_kernel, n, splat2d, key, splat);
    if (!cuda_sort(d, key, sorted_key, splat, order, n, 32))
        return d->op->wait(d);
    GPU_EACH(gpu_of(d), n, count_kernel, n, splat2d, order, count);
    if (!cuda_scan(d, count, before, n))
        return d->op->wait(d);
    GPU_EACH(gpu_of(d), n, pairs_kernel, n, view->camera.tiles_x, splat2d, order, before, tile,
             of_pair);
    if (!cuda_sort(d, tile, sorted_tile, of_pair, lists + first, pairs, bits_of(n_tiles)))
        return d->op->wait(d);
    GPU_EACH(gpu_of(d), n_tiles + 1, start_kernel, n_tiles, sorted_tile, pairs, first, start);
    return SPIN_OK;
}

spin_status cuda_tile_fill(struct spin_device *d, const struct spin_view_batch *views,
                           const struct spin_splat2d *splat2d, const struct spin_tiles *tiles)
{
    uint32_t first = 0;
    spin_status status = SPIN_OK;

    cuda_clocked clocked(d, SPIN_OP_TILE);
    for (int k = 0; k < views->n_views && status == SPIN_OK; k++) {
        const auto *view = &views->view[k];
        uint64_t pairs = cuda_of(d)->view_pairs[k];

        status = fill_view(d, view, splat2d + view->first, pairs, first, tiles->intersections,
                           tiles->start + (size_t)k * (views->max_tiles + 1));
        first += (uint32_t)pairs;
    }
    return status;
}
