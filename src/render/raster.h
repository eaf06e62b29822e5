/* Draw views and send gradients back: project, sort into tiles, blend, and the way back. */
#pragma once

#include "device/device.h"

struct spin_raster {
    struct spin_device *device;
    bool training;
    size_t capacity; /* splats of a view */
    size_t pixels, tiles_capacity, intersections_capacity;
    int views;                                    /* that are drawn together */
    struct spin_splat2d SPIN_DEV *splat2d;        /* [views][n] */
    struct spin_splat2d_grad SPIN_DEV *d_splat2d; /* [views][n] (training) */
    struct spin_tiles tiles;
    float SPIN_DEV *image;               /* [views][3][h][w] */
    float SPIN_DEV *final_transmittance; /* [views][h][w] */
    int32_t SPIN_DEV *last_contributor;  /* [views][h][w] */
    float SPIN_DEV *d_image;             /* [views][3][h][w] (training) */
};

/* Room for n splats a view and pictures of up to `pixels`, of `views` together (1 when 0); the
 * lists of intersections grow with what is seen. */
spin_status spin_raster_open(struct spin_raster *r, struct spin_device *device, size_t n,
                             size_t pixels, size_t tiles, int views, bool training);
void spin_raster_close(struct spin_raster *r);
/* Bytes that drawing a view of n splats takes besides, about: lists of intersections, and what the
 * device needs itself. */
size_t spin_raster_grows(size_t n, size_t pixels, bool training);

/* An empty batch of views for this raster; and one view more, of n splats of a frame of the batch,
 * or NULL when the batch is full. */
struct spin_view_batch spin_raster_batch(const struct spin_raster *r, const float background[3]);
struct spin_view_of_batch *spin_raster_add_view(const struct spin_raster *r,
                                                struct spin_view_batch *views, int frame, size_t n,
                                                const struct spin_camera *camera, bool antialias);

/* image = views of the splats. Fails only when there are too many pairs of splats and tiles. */
spin_status spin_raster_forward(struct spin_raster *r, const struct spin_view_batch *views,
                                const struct spin_frame_batch *frames, const float SPIN_DEV *attr,
                                int sh_degree);
/* From d_image: d_attr +=, d_means +=. Follows the forward pass of the same views. */
void spin_raster_backward(struct spin_raster *r, const struct spin_view_batch *views,
                          const struct spin_frame_batch *frames, const float SPIN_DEV *attr,
                          int sh_degree, float SPIN_DEV *d_attr);
