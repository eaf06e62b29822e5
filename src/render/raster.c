/* Renders views with the device's rasteriser. The sizes of all buffers are known beforehand, except
 * that of the list of intersections, that is, of (splat, tile) pairs: the device counts the pairs,
 * the host reads the count and reserves memory, then the device fills the list. */
#include "render/raster.h"

#include <string.h>

#include "base/text.h"

/* An array of struct spin_raster. The list of these arrays serves both to reserve and to release
 * them. */
struct piece {
    void SPIN_DEV **at;
    size_t bytes;
    bool training; /* true if only the backward pass needs the array */
};
enum { N_PIECES = 7 };

static void list_pieces(struct spin_raster *r, struct piece piece[N_PIECES])
{
    size_t views = (size_t)r->views, splats = views * r->capacity, pixels = views * r->pixels;
    const struct piece all[N_PIECES] = {
        {(void SPIN_DEV **)&r->splat2d, splats * sizeof *r->splat2d, false},
        {(void SPIN_DEV **)&r->tiles.start,
         views * (r->tiles_capacity + 1) * sizeof *r->tiles.start, false},
        {(void SPIN_DEV **)&r->image, 3 * pixels * sizeof(float), false},
        {(void SPIN_DEV **)&r->final_transmittance, pixels * sizeof(float), false},
        {(void SPIN_DEV **)&r->last_contributor, pixels * sizeof(int32_t), false},
        {(void SPIN_DEV **)&r->d_splat2d, splats * sizeof *r->d_splat2d, true},
        {(void SPIN_DEV **)&r->d_image, 3 * pixels * sizeof(float), true},
    };

    memcpy(piece, all, sizeof all);
}

static const size_t pair_gradient = 12 * 4; /* bytes of gradients per (splat, tile) pair */

/* Fails if the list of pairs exceeds the free memory. Without this check, the allocation would
 * succeed because the system overcommits memory, and the process would be killed later. */
static spin_status check_pairs(const struct spin_raster *r)
{
    size_t pair = sizeof *r->tiles.intersections + (r->training ? pair_gradient : 0);
    size_t needed = r->tiles.n_intersections * pair;
    size_t available = r->device->op->memory_available(r->device);
    char needs[32], has[32];

    if (needed <= available || (available == 0 && !r->device->is_host))
        return SPIN_OK;
    return spin_fail(SPIN_E_MEMORY,
                     "cannot render a view: its %llu pairs of splats and tiles need %s, but %s are "
                     "free; render smaller images, or check the scales of the splats",
                     (unsigned long long)r->tiles.n_intersections, spin_text_bytes(needed, needs),
                     spin_text_bytes(available, has));
}

size_t spin_raster_grows(size_t n, size_t pixels, bool training)
{
    /* A splat is in about six pairs. Each pair needs 4 bytes in the list and 4 in buffers of the
     * device. During training, the loss also needs 16 floats per pixel. */
    size_t splat = 6 * 4 * 2;

    return training ? n * (splat + 6 * pair_gradient) + pixels * 16 * 4 : n * splat;
}

spin_status spin_raster_open(struct spin_raster *r, struct spin_device *device, size_t n,
                             size_t pixels, size_t tiles, int views, bool training)
{
    struct piece piece[N_PIECES];
    spin_status status = SPIN_OK;

    memset(r, 0, sizeof *r);
    r->device = device;
    r->training = training;
    r->capacity = n;
    r->pixels = pixels;
    r->tiles_capacity = tiles;
    r->views = views > 0 ? views : 1;
    list_pieces(r, piece);
    for (int i = 0; i < N_PIECES; i++)
        if (training || !piece[i].training)
            SPIN_TRY_OUT(device->op->reserve(device, piece[i].bytes, piece[i].at));
out:
    if (status != SPIN_OK)
        spin_raster_close(r);
    return status;
}

static void release_intersections(struct spin_raster *r)
{
    r->device->op->release(r->device, r->tiles.intersections);
    r->tiles.intersections = NULL;
    r->intersections_capacity = 0;
}

void spin_raster_close(struct spin_raster *r)
{
    struct piece piece[N_PIECES];

    if (!r->device)
        return;
    list_pieces(r, piece);
    for (int i = 0; i < N_PIECES; i++)
        r->device->op->release(r->device, *piece[i].at);
    release_intersections(r);
    memset(r, 0, sizeof *r);
}

struct spin_view_batch spin_raster_batch(const struct spin_raster *r, const float background[3])
{
    struct spin_view_batch views = {.max_pixels = r->pixels, .max_tiles = r->tiles_capacity};

    memcpy(views.background, background, sizeof views.background);
    return views;
}

struct spin_view_of_batch *spin_raster_add_view(const struct spin_raster *r,
                                                struct spin_view_batch *views, int frame, size_t n,
                                                const struct spin_camera *camera, bool antialias)
{
    struct spin_view_of_batch *view = &views->view[views->n_views];
    const struct spin_view_of_batch *last = view - 1;

    if (views->n_views >= r->views || views->n_views >= SPIN_MAX_VIEWS)
        return NULL;
    memset(view, 0, sizeof *view);
    view->frame = frame;
    view->first = views->n_views > 0 ? last->first + last->n : 0;
    view->n = n;
    view->camera = spin_camera_f32_from(camera);
    view->camera.antialias = antialias;
    views->n_views++;
    return view;
}

static spin_status reserve_intersections(struct spin_raster *r)
{
    size_t capacity = r->tiles.n_intersections + r->tiles.n_intersections / 2;

    if (r->tiles.n_intersections <= r->intersections_capacity)
        return SPIN_OK;
    SPIN_TRY(check_pairs(r));
    release_intersections(r);
    SPIN_TRY(r->device->op->reserve(r->device, capacity * sizeof *r->tiles.intersections,
                                    (void SPIN_DEV **)&r->tiles.intersections));
    r->intersections_capacity = capacity;
    return SPIN_OK;
}

spin_status spin_raster_forward(struct spin_raster *r, const struct spin_view_batch *views,
                                const struct spin_frame_batch *frames, const float SPIN_DEV *attr,
                                int sh_degree)
{
    struct spin_device *d = r->device;

    d->op->project(d, views, frames, attr, sh_degree, r->splat2d);
    SPIN_TRY(d->op->tile_count(d, views, r->splat2d, &r->tiles));
    SPIN_TRY(reserve_intersections(r));
    SPIN_TRY(d->op->tile_fill(d, views, r->splat2d, &r->tiles));
    d->op->blend(d, views, r->splat2d, &r->tiles, r->image, r->final_transmittance,
                 r->last_contributor);
    return SPIN_OK;
}

void spin_raster_backward(struct spin_raster *r, const struct spin_view_batch *views,
                          const struct spin_frame_batch *frames, const float SPIN_DEV *attr,
                          int sh_degree, float SPIN_DEV *d_attr)
{
    struct spin_device *d = r->device;

    d->op->blend_back(d, views, r->splat2d, &r->tiles, r->final_transmittance, r->last_contributor,
                      r->d_image, r->d_splat2d);
    d->op->project_back(d, views, frames, attr, sh_degree, r->splat2d, r->d_splat2d, d_attr);
}
