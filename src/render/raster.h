/* Renders views: projects splats, sorts them into tiles and blends them. The backward pass computes
 * the gradients of blending and projection. */
#pragma once

#include "device/device.h"

struct spin_raster {
    struct spin_device *device;
    bool training;
    size_t capacity; /* largest number of splats per view */
    size_t pixels, tiles_capacity, intersections_capacity;
    int views;                                    /* largest number of views rendered at once */
    struct spin_splat2d SPIN_DEV *splat2d;        /* [views][n] */
    struct spin_splat2d_grad SPIN_DEV *d_splat2d; /* [views][n] (training) */
    struct spin_tiles tiles;
    float SPIN_DEV *image;               /* [views][3][h][w] */
    float SPIN_DEV *final_transmittance; /* [views][h][w] */
    int32_t SPIN_DEV *last_contributor;  /* [views][h][w] */
    float SPIN_DEV *d_image;             /* [views][3][h][w] (training) */
};

/* Reserves memory for rendering `views` views at once (0 means 1), each with up to n splats,
 * `pixels` pixels and `tiles` tiles. The list of intersections, that is, of (splat, tile) pairs,
 * grows on demand. training: also reserves memory for gradients. */
spin_status spin_raster_open(struct spin_raster *r, struct spin_device *device, size_t n,
                             size_t pixels, size_t tiles, int views, bool training);
void spin_raster_close(struct spin_raster *r);
/* Estimates the memory, in bytes, that rendering a view of n splats needs in addition to what
 * spin_raster_open() reserves: the list of intersections, and buffers of the device. */
size_t spin_raster_grows(size_t n, size_t pixels, bool training);

/* Creates an empty batch of views. */
struct spin_view_batch spin_raster_batch(const struct spin_raster *r, const float background[3]);
/* Adds a view to the batch; frame is an index in the frame batch, and n the number of splats of
 * this frame. Returns NULL if the batch is full. */
struct spin_view_of_batch *spin_raster_add_view(const struct spin_raster *r,
                                                struct spin_view_batch *views, int frame, size_t n,
                                                const struct spin_camera *camera, bool antialias);

/* Renders the views into r->image. Fails only if the list of intersections does not fit into
 * memory. */
spin_status spin_raster_forward(struct spin_raster *r, const struct spin_view_batch *views,
                                const struct spin_frame_batch *frames, const float SPIN_DEV *attr,
                                int sh_degree);
/* Propagates r->d_image, the gradient with respect to the image, back: adds to d_attr, and to
 * d_means of the frames. Requires a preceding spin_raster_forward() of the same views. */
void spin_raster_backward(struct spin_raster *r, const struct spin_view_batch *views,
                          const struct spin_frame_batch *frames, const float SPIN_DEV *attr,
                          int sh_degree, float SPIN_DEV *d_attr);
