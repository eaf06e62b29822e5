/* The CPU device. Every file of this folder is compiled once per code path (SPIN_CPU_PATH = base, v3,
 * v4 on x86-64; base alone elsewhere, where it is NEON on Arm), with the compiler's flags for it;
 * device.c picks one at run time. SPIN_CPU(name) is a name of this path. */
#ifndef SPIN_DEVICE_CPU_CPU_H
#define SPIN_DEVICE_CPU_CPU_H

#include "base/mem.h"
#include "base/pool.h"
#include "device/device.h"

#define SPIN_CPU_JOIN2(path, name) spin_cpu_##path##_##name
#define SPIN_CPU_JOIN(path, name) SPIN_CPU_JOIN2(path, name)
#define SPIN_CPU(name) SPIN_CPU_JOIN(SPIN_CPU_PATH, name)

/* Scratch of the ops, grown when needed and kept. A failed growth inside an op ends the process with a
 * message: ops cannot fail, and their sizes were part of the plan. */
enum spin_cpu_scratch {
    SPIN_SCRATCH_GRID,
    SPIN_SCRATCH_MLP,
    SPIN_SCRATCH_TILE,
    SPIN_SCRATCH_TILE_KEYS,
    SPIN_SCRATCH_BLEND,
    SPIN_SCRATCH_LOSS,
    SPIN_SCRATCH_ACTIVE,
    SPIN_SCRATCHES
};

struct spin_cpu {
    struct spin_pool *pool;
    struct spin_scratch scratch[SPIN_SCRATCHES];
    char no_memory[128]; /* why an op could not; "": all could */
};

/* 64-byte aligned, contents undefined. NULL without memory: the op leaves its results as they are, and
 * the next wait() reports it. */
void *SPIN_CPU(scratch_need)(struct spin_device *d, enum spin_cpu_scratch which, size_t bytes);
#define spin_cpu_scratch_need SPIN_CPU(scratch_need)
spin_status SPIN_CPU(wait)(struct spin_device *d);

static inline struct spin_pool *spin_cpu_pool(struct spin_device *d)
{
    return ((struct spin_cpu *)d->state)->pool;
}

/* grid.c */
void SPIN_CPU(contract)(struct spin_device *d, const struct spin_scene_transform *transform,
                        size_t n, const float *pos_w, float t, float *x_u);
void SPIN_CPU(contract_back)(struct spin_device *d, const struct spin_scene_transform *transform,
                             size_t n_rows, const uint32_t *rows, const float *pos_w,
                             const float *d_x_u, float *d_pos_w);
void SPIN_CPU(grid)(struct spin_device *d, const struct spin_grid *grid, const float *table,
                    size_t n, const float *x_u, float *z);
void SPIN_CPU(lazy_grid)(struct spin_device *d, const struct spin_grid *grid,
                         const struct spin_lazy_adam *lazy, float *p, float *m, float *v, size_t n,
                         const float *x_u, float *z);
void SPIN_CPU(grid_back)(struct spin_device *d, const struct spin_grid *grid, const float *table,
                         size_t n_rows, const uint32_t *rows, const float *x_u, const float *d_z,
                         float *d_table, float *d_x_u);
/* mlp.c */
void SPIN_CPU(mlp)(struct spin_device *d, const struct spin_heads *heads, const float *param,
                   size_t n, const float *z, float *raw);
void SPIN_CPU(mlp_back)(struct spin_device *d, const struct spin_heads *heads, const float *param,
                        size_t n_rows, const uint32_t *rows, const float *z, const float *d_raw,
                        float *d_param, float *d_z);
/* attr.c */
void SPIN_CPU(attr)(struct spin_device *d, size_t n, const float *raw, float *attr);
void SPIN_CPU(activate_back)(struct spin_device *d, size_t n_rows, const uint32_t *rows,
                             const float *raw, const float *d_attr, float *d_raw);
void SPIN_CPU(regularise_back)(struct spin_device *d, size_t n_rows, const uint32_t *rows,
                               float d_scale, float d_opacity, float *d_attr);
size_t SPIN_CPU(active)(struct spin_device *d, size_t n, const float *d_attr, const float *d_pos_w,
                        uint32_t *rows);
/* adam.c */
void SPIN_CPU(adam)(struct spin_device *d, size_t n, float *p, float *g, float *m, float *v,
                    double lr, int64_t step);
void SPIN_CPU(lazy_adam)(struct spin_device *d, const struct spin_grid *grid,
                         const struct spin_lazy_adam *lazy, size_t n, float *p, float *g, float *m,
                         float *v, double lr);
void SPIN_CPU(lazy_flush)(struct spin_device *d, const struct spin_grid *grid,
                          const struct spin_lazy_adam *lazy, size_t n, const float *p,
                          const float *m, const float *v, float *out);
/* project.c */
void SPIN_CPU(project)(struct spin_device *d, const struct spin_camera_f32 *cam, size_t n,
                       const float *pos_w, const float *attr, int sh_degree,
                       struct spin_splat2d *splat2d);
void SPIN_CPU(project_back)(struct spin_device *d, const struct spin_camera_f32 *cam, size_t n,
                            const float *pos_w, const float *attr, int sh_degree,
                            const struct spin_splat2d *splat2d,
                            const struct spin_splat2d_grad *d_splat2d, float *d_attr,
                            float *d_pos_w);
/* tile.c */
spin_status SPIN_CPU(tile_count)(struct spin_device *d, const struct spin_camera_f32 *cam, size_t n,
                                 struct spin_splat2d *splat2d, struct spin_tiles *tiles);
spin_status SPIN_CPU(tile_fill)(struct spin_device *d, const struct spin_camera_f32 *cam, size_t n,
                                const struct spin_splat2d *splat2d, struct spin_tiles *tiles);
/* blend.c */
void SPIN_CPU(blend)(struct spin_device *d, const struct spin_camera_f32 *cam,
                     const struct spin_splat2d *splat2d, const struct spin_tiles *tiles,
                     const float background[3], float *image, float *final_transmittance,
                     int32_t *last_contributor);
void SPIN_CPU(blend_back)(struct spin_device *d, const struct spin_camera_f32 *cam, size_t n,
                          const struct spin_splat2d *splat2d, const struct spin_tiles *tiles,
                          const float background[3], const float *final_transmittance,
                          const int32_t *last_contributor, const float *d_image,
                          struct spin_splat2d_grad *d_splat2d);
/* loss.c */
void SPIN_CPU(loss)(struct spin_device *d, int width, int height, const float *image,
                    const float *truth, const float *pixel_weight, float lambda_dssim, float weight,
                    double values[3], float *d_image);

/* own.c */
void SPIN_CPU(residual)(struct spin_device *d, size_t n, const float *residual, float *raw);
void SPIN_CPU(residual_back)(struct spin_device *d, size_t n, size_t n_rows, const uint32_t *rows,
                             const float *d_raw, float *d_residual);
/* tint.c */
void SPIN_CPU(exposure)(struct spin_device *d, size_t n_pixels, const float *exposure,
                        const float *image, float *out);
void SPIN_CPU(exposure_back)(struct spin_device *d, size_t n_pixels, const float *exposure,
                             const float *image, float *d_image, float *d_exposure);

#endif
