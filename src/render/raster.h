/* Renders views and propagates gradients back: project, sort into tiles, blend, and their
 * adjoints. */
#pragma once

#include "device/device.h"

struct spin_raster {
    struct spin_device *device;
    bool training;
    size_t capacity; /* splats per view */
    size_t pixels, tiles_capacity, intersections_capacity;
    int views;                                    /* rendered together */
    struct spin_splat2d SPIN_DEV *splat2d;        /* [views][n] */
    struct spin_splat2d_grad SPIN_DEV *d_splat2d; /* [views][n] (training) */
    struct spin_tiles tiles;
    float SPIN_DEV *image;               /* [views][3][h][w] */
    float SPIN_DEV *final_transmittance; /* [views][h][w] */
    int32_t SPIN_DEV *last_contributor;  /* [views][h][w] */
    float SPIN_DEV *d_image;             /* [views][3][h][w] (training) */
};

/* Reserves memory for `views` views at once (0: 1) of n splats and up to `pixels` pixels each. The
 * lists of intersections grow on demand. */
spin_status spin_raster_open(struct spin_raster *r, struct spin_device *device, size_t n,
                             size_t pixels, size_t tiles, int views, bool training);
void spin_raster_close(struct spin_raster *r);
/* Estimates the bytes that rendering a view of n splats needs in addition: lists of intersections
 * and buffers of the device. */
size_t spin_raster_grows(size_t n, size_t pixels, bool training);

/* Creates an empty batch of views for this raster; and adds a view of n splats of a frame. Returns
 * NULL if the batch is full. */
struct spin_view_batch spin_raster_batch(const struct spin_raster *r, const float background[3]);
struct spin_view_of_batch *spin_raster_add_view(const struct spin_raster *r,
                                                struct spin_view_batch *views, int frame, size_t n,
                                                const struct spin_camera *camera, bool antialias);

/* Renders the views into image. Fails only if the splat-tile pairs do not fit into memory. */
spin_status spin_raster_forward(struct spin_raster *r, const struct spin_view_batch *views,
                                const struct spin_frame_batch *frames, const float SPIN_DEV *attr,
                                int sh_degree);
/* Adds to d_attr and d_means the gradients that follow from d_image. Call it after
 * spin_raster_forward() of the same views. */
void spin_raster_backward(struct spin_raster *r, const struct spin_view_batch *views,
                          const struct spin_frame_batch *frames, const float SPIN_DEV *attr,
                          int sh_degree, float SPIN_DEV *d_attr);
