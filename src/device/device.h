/* The verbs of the method, and who can do them.
 *
 * A device owns its memory: what reserve() returns is touched only through the device. Ops take sizes
 * and pointers, return nothing and cannot fail: their inputs were checked when the plan was made. All
 * pointers below are device memory unless marked host. "=" overwrites, "+=" accumulates.
 *
 * Attributes of a Gaussian travel as one row of SPIN_ATTR floats, in the order of the heads:
 *     scale [3]  rotation [4] (w,x,y,z)  sh [16][3]  opacity [1]
 * `raw` rows are head outputs, `attr` rows are finished (linear scale, unit quaternion, opacity 0..1).
 *
 * Backward ops take `rows`: an ascending list of the n_rows splats that have any gradient; compact
 * arrays (d_raw, d_z, d_x_u) have n_rows rows in that order, full ones have n. */
#ifndef SPIN_DEVICE_DEVICE_H
#define SPIN_DEVICE_DEVICE_H

#include "spin.h"

enum {
    SPIN_ATTR_SCALE = 0,
    SPIN_ATTR_ROTATION = 3,
    SPIN_ATTR_SH = 7,
    SPIN_ATTR_OPACITY = 55,
    SPIN_ATTR = 56,
    SPIN_RESIDUAL =
        11, /* own values of a splat: log scale [3], rotation [4], colour [3], opacity [1] */
    SPIN_TILE = 16, /* pixels; part of the result, method.md 4.2 */
    SPIN_MAX_LEVELS = 32
};

/* The hash grid's geometry (host memory, passed by pointer, copied by the op if it must). */
struct spin_grid {
    int n_levels, n_features;             /* features per level: 1, 2, 4 or 8 */
    float scale[SPIN_MAX_LEVELS][4];      /* vertices sit at k / scale */
    uint32_t res[SPIN_MAX_LEVELS][4];     /* vertices per axis */
    uint32_t offset[SPIN_MAX_LEVELS + 1]; /* first row of a level; [n_levels] = all rows */
    uint8_t hashed[SPIN_MAX_LEVELS];      /* product of res exceeds the level's rows */
};

/* Adam for a table of which a step touches little. A line of 16 floats that no step needs is left
 * alone and stands at an older step; once it is needed, the steps that it missed are made up for
 * at once (spin_adam_skip). Lines begin with the first hashed level: the smaller ones before it
 * are touched everywhere and take every step. */
enum { SPIN_LINE = 16 };
struct spin_lazy_adam {
    float *last;  /* [lines] step a line stands at; done + 1 once the present step needs it */
    int64_t done; /* steps that are over */
    const float
        *skipped_step; /* host [done + 1][2], by the step a line stands at: spin_adam_skip's drift
                         * and tiny, up to step done */
    const float *moment_decay; /* host [done + 1][2], by the steps missed: .9^t, .999^t */
};
/* Level where lines begin; n_levels: there are none. */
static inline int spin_lazy_level(const struct spin_grid *grid)
{
    int level = 0;

    while (level < grid->n_levels && !grid->hashed[level])
        level++;
    return level;
}

/* Encoder input: ((p - centre) * inv_radius), contracted, to the unit cube; time goes last. */
struct spin_scene_transform {
    float centre[3], inv_radius;
    bool raw; /* not contracted: what lies outside the unit cube gets zeros (an ablation) */
};

/* Four heads, three Linear layers each, on the same z. Parameters of head k, at offset[k]:
 *     w1 [hidden][n_in]  b1 [hidden]  w2 [hidden][hidden]  b2 [hidden]  w3 [n_out][hidden]  b3 [n_out]
 * Order: scale (3), rotation (4), sh (48), opacity (1). n_in and hidden are multiples of 4. */
enum { SPIN_HEAD_SCALE, SPIN_HEAD_ROTATION, SPIN_HEAD_SH, SPIN_HEAD_OPACITY, SPIN_HEADS };
struct spin_heads {
    int n_in, hidden;
    int n_out[SPIN_HEADS];         /* 3 4 48 1 */
    size_t offset[SPIN_HEADS + 1]; /* floats; [SPIN_HEADS] = all */
    bool relu;                     /* ReLU instead of GELU (an ablation) */
};

/* A camera as the ops use it. */
struct spin_camera_f32 {
    int width, height, tiles_x, tiles_y;
    float fx, fy, cx, cy;
    float r[9], t[3];       /* w2c */
    float centre[3];        /* in the world */
    float limit_x, limit_y; /* 1.3 tan of the half field of view */
    bool
        antialias; /* splats smaller than a pixel are drawn fainter, not only wider; spin_camera_f32_from: no */
};
struct spin_camera_f32 spin_camera_f32_from(const struct spin_camera *camera);

/* One projected Gaussian: 64 bytes. radius 0 = culled, nothing else is then meaningful. */
struct spin_splat2d {
    float u_px, v_px; /* pixel centres at integers */
    float conic[3];   /* a b c of [a b; b c] */
    float opacity;
    float colour[3];
    float depth;
    int32_t radius_px;
    uint16_t x0, y0, x1, y1;     /* tiles, half open */
    uint32_t first_intersection; /* of its (splat, tile) pairs, splat-major: set by tile_count */
    uint32_t flags;       /* bit 0..2: colour channel clamped at 0; bit 3, 4: x, y clamped in J */
    uint8_t tile_cull[4]; /* set by tile_count: tiles at the left, top, right, bottom of the
                                  * rectangle where alpha is below 1/255 everywhere; they get no pair */
};

/* Its gradient. */
struct spin_splat2d_grad {
    float u_px, v_px, conic[3], opacity, colour[3];
    float spare[3];
};

/* A view has at most this many (splat, tile) pairs; lists of 1 GiB. */
#define SPIN_MAX_PAIRS ((uint64_t)1 << 28)

/* Where a view's lists live; one struct per view in flight. Sizes are the core's business. */
struct spin_tiles {
    uint32_t n_intersections; /* set by tile_count */
    uint32_t *intersections;  /* [n_pairs] splats, sorted by tile, then depth, then index */
    uint32_t *start;          /* [tiles_x * tiles_y + 1] */
};

struct spin_device;

struct spin_device_ops {
    const char *name; /* "cpu", "cuda" */
    spin_status (*open)(struct spin_device *d, int n_threads);
    void (*close)(struct spin_device *d);

    /* Memory. reserve() gives zeroed, 64-byte aligned memory. */
    spin_status (*reserve)(struct spin_device *d, size_t bytes, void **out);
    void (*release)(struct spin_device *d, void *block, size_t bytes);
    void (*upload)(struct spin_device *d, void *to, const void *host, size_t bytes);
    void (*download)(struct spin_device *d, void *host, const void *from, size_t bytes);
    void (*zero)(struct spin_device *d, void *block, size_t bytes);
    spin_status (*wait)(struct spin_device *d); /* also reports what went wrong before */
    size_t (*memory)(struct spin_device *d);    /* bytes that could still be reserved */

    /* x_u [n][4] = contract(pos_w [n][3]), t */
    void (*contract)(struct spin_device *d, const struct spin_scene_transform *transform, size_t n,
                     const float *pos_w, float t, float *x_u);
    /* d_pos_w[rows[i]] += adjoint of d_x_u[i][0..2] */
    void (*contract_back)(struct spin_device *d, const struct spin_scene_transform *transform,
                          size_t n_rows, const uint32_t *rows, const float *pos_w,
                          const float *d_x_u, float *d_pos_w);

    /* z [n][levels*features] = */
    void (*grid)(struct spin_device *d, const struct spin_grid *grid, const float *table, size_t n,
                 const float *x_u, float *z);
    /* d_table [rows][features] +=, d_x_u [n_rows][4] = (d_x_u[.][3] = 0). d_x_u may be NULL. */
    void (*grid_back)(struct spin_device *d, const struct spin_grid *grid, const float *table,
                      size_t n_rows, const uint32_t *rows, const float *x_u, const float *d_z,
                      float *d_table, float *d_x_u);

    /* raw [n][SPIN_ATTR] = heads(z [n][n_in]) */
    void (*mlp)(struct spin_device *d, const struct spin_heads *heads, const float *param, size_t n,
                const float *z, float *raw);
    /* d_param +=, d_z [n_rows][n_in] =; activations are recomputed from z */
    void (*mlp_back)(struct spin_device *d, const struct spin_heads *heads, const float *param,
                     size_t n_rows, const uint32_t *rows, const float *z, const float *d_raw,
                     float *d_param, float *d_z);

    /* raw [n][SPIN_ATTR] += a splat's own values, raw as well; the colour is the first coefficient.
     * own [SPIN_RESIDUAL n] is four groups: [n][3], [n][4], [n][3], [n]. Back: d_residual [SPIN_RESIDUAL n] += */
    void (*residual)(struct spin_device *d, size_t n, const float *residual, float *raw);
    void (*residual_back)(struct spin_device *d, size_t n, size_t n_rows, const uint32_t *rows,
                          const float *d_raw, float *d_residual);

    /* attr [n][SPIN_ATTR] = finish(raw) */
    void (*attr)(struct spin_device *d, size_t n, const float *raw, float *attr);
    /* d_raw [n_rows][SPIN_ATTR] = from d_attr [n][SPIN_ATTR] */
    void (*activate_back)(struct spin_device *d, size_t n_rows, const uint32_t *rows,
                          const float *raw, const float *d_attr, float *d_raw);

    /* d_attr [rows] += the gradient of d_scale (sum of the three scales) + d_opacity opacity. */
    void (*regularise_back)(struct spin_device *d, size_t n_rows, const uint32_t *rows,
                            float d_scale, float d_opacity, float *d_attr);

    /* splat2d [n] = ; sh_degree 0..3 */
    void (*project)(struct spin_device *d, const struct spin_camera_f32 *cam, size_t n,
                    const float *pos_w, const float *attr, int sh_degree,
                    struct spin_splat2d *splat2d);
    /* d_attr [n][SPIN_ATTR] +=, d_pos_w [n][3] += */
    void (*project_back)(struct spin_device *d, const struct spin_camera_f32 *cam, size_t n,
                         const float *pos_w, const float *attr, int sh_degree,
                         const struct spin_splat2d *splat2d,
                         const struct spin_splat2d_grad *d_splat2d, float *d_attr, float *d_pos_w);

    /* Sets first_intersection of every splat and tiles->n_intersections, and fails where these are more than
     * SPIN_MAX_PAIRS; then, with tiles->pairs large enough, fills. */
    spin_status (*tile_count)(struct spin_device *d, const struct spin_camera_f32 *cam, size_t n,
                              struct spin_splat2d *splat2d, struct spin_tiles *tiles);
    spin_status (*tile_fill)(struct spin_device *d, const struct spin_camera_f32 *cam, size_t n,
                             const struct spin_splat2d *splat2d, struct spin_tiles *tiles);

    /* image [3][h][w] =, final_t [h][w] =, n_used [h][w] = (one past the last contributor's place in
     * its tile's list) */
    void (*blend)(struct spin_device *d, const struct spin_camera_f32 *cam,
                  const struct spin_splat2d *splat2d, const struct spin_tiles *tiles,
                  const float background[3] /* host */, float *image, float *final_transmittance,
                  int32_t *last_contributor);
    /* d_splat2d [n] = */
    void (*blend_back)(struct spin_device *d, const struct spin_camera_f32 *cam, size_t n,
                       const struct spin_splat2d *splat2d, const struct spin_tiles *tiles,
                       const float background[3] /* host */, const float *final_transmittance,
                       const int32_t *last_contributor, const float *d_image,
                       struct spin_splat2d_grad *d_splat2d);

    /* loss = (1 - lambda) L1 + lambda (1 - SSIM); d_image = weight * its gradient (NULL: none). L1 and
     * SSIM are means over the pixels, each counted as often as pixel_weight [h][w] says (at least 0, not
     * all 0; NULL: 1). The three numbers come back on the host: values[0] loss, [1] L1, [2] SSIM, not
     * times weight. */
    void (*loss)(struct spin_device *d, int width, int height, const float *image,
                 const float *truth, const float *pixel_weight, float lambda_dssim, float weight,
                 double values[3] /* host */, float *d_image);

    /* A camera's gain and offset, math/exposure.h: out [3][n_pixels] = exp(tint[c]) image + tint[3 + c].
     * Back: d_image is scaled in place, d_exposure [6] +=. */
    void (*exposure)(struct spin_device *d, size_t n_pixels, const float *exposure,
                     const float *image, float *out);
    void (*exposure_back)(struct spin_device *d, size_t n_pixels, const float *exposure,
                          const float *image, float *d_image, float *d_exposure);

    /* rows [<= n] = ascending indices of splats whose d_attr or d_pos_w row is not all zero. Returns
     * their count (host). */
    size_t (*active)(struct spin_device *d, size_t n, const float *d_attr, const float *d_pos_w,
                     uint32_t *rows);

    /* One Adam step, math/adam.h: p -= ...; m, v updated; g is left zeroed. step counts from 1. */
    void (*adam)(struct spin_device *d, size_t n, float *p, float *g, float *m, float *v, double lr,
                 int64_t step);

    /* The same for a lazy table of n floats. lazy_grid is grid, after it has brought the lines that
     * these points need to step done and marked them; adam_lazy takes step done + 1 with the
     * marked lines and with all levels before them; settle: out [n] = p as it would be after step
     * done if no line had been left alone. */
    void (*lazy_grid)(struct spin_device *d, const struct spin_grid *grid,
                      const struct spin_lazy_adam *lazy, float *p, float *m, float *v, size_t n,
                      const float *x_u, float *z);
    void (*lazy_adam)(struct spin_device *d, const struct spin_grid *grid,
                      const struct spin_lazy_adam *lazy, size_t n, float *p, float *g, float *m,
                      float *v, double lr);
    void (*lazy_flush)(struct spin_device *d, const struct spin_grid *grid,
                       const struct spin_lazy_adam *lazy, size_t n, const float *p, const float *m,
                       const float *v, float *out);
};

struct spin_device {
    const struct spin_device_ops *op;
    const char *path;     /* code path: "base", "v3", "v4"; results differ in the last bits */
    void *state;          /* the device's own */
    char description[64]; /* "cpu (avx-512, 2 threads)" */
    double seconds[24];   /* reserved for the trace, by the core */
};

/* name: "auto" (cuda when there is one), "cpu", "cuda". The environment variable SPIN_CPU = base, v3 or
 * v4 picks the CPU's code path. */
spin_status spin_device_open(const char *name, int n_threads, struct spin_device *out);
void spin_device_close(struct spin_device *d);

#endif
