/* One view through the rasteriser. The only sum whose size is not known beforehand is the list of
 * (splat, tile) pairs: it is counted, then memory is reserved, then it is filled. */
#include "render/raster.h"

#include <string.h>

#include "base/err.h"
#include "device/clock.h"

static spin_status take(struct spin_device *d, size_t bytes, void *out)
{
    return d->op->reserve(d, bytes, (void **)out);
}

static const size_t pair_gradient = 12 * 4; /* bytes of a pair's share of the gradient */

/* Whether the lists of this view may grow: the system gives more than it has, and kills later. */
static spin_status check_pairs(const struct spin_raster *r)
{
    size_t pair = sizeof *r->tiles.intersections + (r->training ? pair_gradient : 0);
    size_t needed = r->tiles.n_intersections * pair, free_bytes = r->device->op->memory(r->device);

    if (needed <= free_bytes)
        return SPIN_OK;
    return spin_fail(
        SPIN_E_MEMORY,
        "cannot draw a view: its %u pairs of splats and tiles need %.1f GB and %.1f GB "
        "are free: the splats are too large, or the image is",
        r->tiles.n_intersections, (double)needed / 1e9, (double)free_bytes / 1e9);
}

size_t spin_raster_bytes(size_t n, size_t pixels, bool training)
{
    size_t splat = sizeof(struct spin_splat2d) + 6 * 4 * 2; /* and about six pairs, twice */
    size_t pixel = 5 * 4;

    if (training) {
        splat += sizeof(struct spin_splat2d_grad) + 6 * pair_gradient;
        pixel += 7 * 4 + 15 * 4; /* truth, gradient, weights, and the loss's bands */
    }
    return n * splat + pixels * pixel;
}

spin_status spin_raster_open(struct spin_raster *r, struct spin_device *device, size_t n,
                             size_t pixels, size_t tiles, bool training)
{
    spin_status status;

    memset(r, 0, sizeof *r);
    r->device = device;
    r->training = training;
    r->capacity = n;
    r->pixels = pixels;
    r->tiles_capacity = tiles;
    SPIN_TRY_OUT(take(device, n * sizeof *r->splat2d, &r->splat2d));
    SPIN_TRY_OUT(take(device, (tiles + 1) * sizeof *r->tiles.start, &r->tiles.start));
    SPIN_TRY_OUT(take(device, 3 * pixels * sizeof(float), &r->image));
    SPIN_TRY_OUT(take(device, pixels * sizeof(float), &r->final_transmittance));
    SPIN_TRY_OUT(take(device, pixels * sizeof(int32_t), &r->last_contributor));
    if (training) {
        SPIN_TRY_OUT(take(device, n * sizeof *r->d_splat2d, &r->d_splat2d));
        SPIN_TRY_OUT(take(device, 3 * pixels * sizeof(float), &r->truth));
        SPIN_TRY_OUT(take(device, 3 * pixels * sizeof(float), &r->d_image));
        SPIN_TRY_OUT(take(device, pixels * sizeof(float), &r->weight));
    }
    return SPIN_OK;
out:
    spin_raster_close(r);
    return status;
}

void spin_raster_close(struct spin_raster *r)
{
    struct spin_device *d = r->device;

    if (!d)
        return;
    d->op->release(d, r->splat2d, r->capacity * sizeof *r->splat2d);
    d->op->release(d, r->tiles.start, (r->tiles_capacity + 1) * sizeof *r->tiles.start);
    d->op->release(d, r->image, 3 * r->pixels * sizeof(float));
    d->op->release(d, r->final_transmittance, r->pixels * sizeof(float));
    d->op->release(d, r->last_contributor, r->pixels * sizeof(int32_t));
    d->op->release(d, r->d_splat2d, r->capacity * sizeof *r->d_splat2d);
    d->op->release(d, r->truth, 3 * r->pixels * sizeof(float));
    d->op->release(d, r->d_image, 3 * r->pixels * sizeof(float));
    d->op->release(d, r->weight, r->pixels * sizeof(float));
    d->op->release(d, r->tiles.intersections,
                   r->intersections_capacity * sizeof *r->tiles.intersections);
    memset(r, 0, sizeof *r);
}

spin_status spin_raster_forward(struct spin_raster *r, const struct spin_camera_f32 *cam, size_t n,
                                const float *pos_w, const float *attr, int sh_degree,
                                const float background[3])
{
    struct spin_device *d = r->device;
    spin_status status;

    SPIN_TIMED(d, SPIN_OP_PROJECT, d->op->project(d, cam, n, pos_w, attr, sh_degree, r->splat2d));
    SPIN_TIMED(d, SPIN_OP_TILE, status = d->op->tile_count(d, cam, n, r->splat2d, &r->tiles));
    SPIN_TRY(status);
    if (r->tiles.n_intersections > r->intersections_capacity) {
        size_t capacity = r->tiles.n_intersections + r->tiles.n_intersections / 2;

        SPIN_TRY(check_pairs(r));
        d->op->release(d, r->tiles.intersections,
                       r->intersections_capacity * sizeof *r->tiles.intersections);
        r->tiles.intersections = NULL;
        r->intersections_capacity = 0;
        SPIN_TRY(take(d, capacity * sizeof *r->tiles.intersections, &r->tiles.intersections));
        r->intersections_capacity = capacity;
    }
    SPIN_TIMED(d, SPIN_OP_TILE, status = d->op->tile_fill(d, cam, n, r->splat2d, &r->tiles));
    SPIN_TRY(status);
    SPIN_TIMED(d, SPIN_OP_BLEND,
               d->op->blend(d, cam, r->splat2d, &r->tiles, background, r->image,
                            r->final_transmittance, r->last_contributor));
    return SPIN_OK;
}

void spin_raster_backward(struct spin_raster *r, const struct spin_camera_f32 *cam, size_t n,
                          const float *pos_w, const float *attr, int sh_degree,
                          const float background[3], float *d_attr, float *d_pos_w)
{
    struct spin_device *d = r->device;

    SPIN_TIMED(d, SPIN_OP_BLEND_BACK,
               d->op->blend_back(d, cam, n, r->splat2d, &r->tiles, background,
                                 r->final_transmittance, r->last_contributor, r->d_image,
                                 r->d_splat2d));
    SPIN_TIMED(d, SPIN_OP_PROJECT_BACK,
               d->op->project_back(d, cam, n, pos_w, attr, sh_degree, r->splat2d, r->d_splat2d,
                                   d_attr, d_pos_w));
}
