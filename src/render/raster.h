/* Render one view and send gradients back: project, tile, blend, and the way back. */
#ifndef SPIN_RENDER_RASTER_H
#define SPIN_RENDER_RASTER_H

#include "device/device.h"

struct spin_raster {
    struct spin_device *device;
    bool training;
    size_t capacity, pixels, tiles_capacity, intersections_capacity;
    struct spin_splat2d *splat2d;        /* [n] */
    struct spin_splat2d_grad *d_splat2d; /* [n] (training) */
    struct spin_tiles tiles;
    float *image;               /* [3][h][w] */
    float *final_transmittance; /* [h][w] */
    int32_t *last_contributor;  /* [h][w] */
    float *truth, *d_image;     /* [3][h][w] (training) */
    float *weight;              /* [h][w] (training) */
};

/* Room for n splats and pictures of `pixels`; the lists of pairs grow with what is seen. */
spin_status spin_raster_open(struct spin_raster *r, struct spin_device *device, size_t n,
                             size_t pixels, size_t tiles, bool training);
void spin_raster_close(struct spin_raster *r);
size_t spin_raster_bytes(size_t n, size_t pixels, bool training);

/* image = view of the splats. Fails only when it has too many pairs of splats and tiles. */
spin_status spin_raster_forward(struct spin_raster *r, const struct spin_camera_f32 *cam, size_t n,
                                const float *pos_w, const float *attr, int sh_degree,
                                const float background[3]);
/* From d_image: d_attr +=, d_pos_w +=. Follows the forward pass of the same view. */
void spin_raster_backward(struct spin_raster *r, const struct spin_camera_f32 *cam, size_t n,
                          const float *pos_w, const float *attr, int sh_degree,
                          const float background[3], float *d_attr, float *d_pos_w);

#endif
