/* The interface of the devices (CPU and CUDA): operations ("verbs") for training and rendering, and
 * device memory.
 *
 * A verb processes a whole batch: all frames and all views of an iteration. Verbs are queued in
 * order and return before they have run, unless their comment says "now". Structs and host
 * arguments are copied by the call, so the caller may change or free them afterwards. Verbs that
 * return no status are not expected to fail, since sizes were checked when the run was planned; if
 * one fails nevertheless, the next wait() or download() reports the error.
 *
 * A device owns its memory. Pointers to it are marked SPIN_DEV: the host passes them on and does
 * pointer arithmetic, but never dereferences them. All pointers below are device memory unless
 * marked host. "=" overwrites, "+=" accumulates.
 *
 * The attributes of a Gaussian are one row of SPIN_ATTR floats, in the order of the heads:
 *     scale [3]  rotation [4] (w,x,y,z)  sh [16][3]  opacity [1]
 * `raw` rows are head outputs, `attr` rows are activated (linear scale, unit quaternion, opacity
 * 0..1).
 *
 * Arrays [n] contain the splats of all frames of a batch, one frame after the other. Most backward
 * verbs have an argument `active`, an ascending list of the rows with a nonzero gradient. Compact
 * arrays (d_raw, d_z, d_x_u) have one row per entry of this list, in the same order; full arrays
 * have n rows. */
#pragma once

#include "spin.h"

/* Marks pointers to device memory. Clang warns where the host dereferences such a pointer
 * (tests/lint/noderef.sh). Within the sources of a device SPIN_DEV is empty. */
#if defined(__clang__) && !defined(SPIN_CPU_PATH) && !defined(__CUDACC__) && !defined(SPIN_EMU)
#define SPIN_DEV __attribute__((noderef))
#else
#define SPIN_DEV
#endif

enum {
    SPIN_ATTR_SCALE = 0,
    SPIN_ATTR_ROTATION = 3,
    SPIN_ATTR_SH = 7,
    SPIN_ATTR_OPACITY = 55,
    SPIN_ATTR = 56,
    /* Width of a row with only the first SH coefficient, see `narrow` of struct
     * spin_frame_batch. */
    SPIN_ATTR_NARROW = 12,
    /* Values of a residual: log scale [3], rotation [4], colour [3], opacity [1]. */
    SPIN_RESIDUAL = 11,
    /* Values of a track: displacement [3], then those of a residual. */
    SPIN_TRACK = 3 + SPIN_RESIDUAL,
    /* Motion of a track that is a 4D splat: velocity [3], and of its Gaussian window the centre
     * in time and 1 / sigma. */
    SPIN_MOTION = 5,
    /* Side of a tile in pixels. Another size changes the results, see docs/method.md 4.2. */
    SPIN_TILE = 16,
    SPIN_MAX_LEVELS = 32
};

/* Geometry of the hash grid (host memory; verbs copy it if they need it later). */
struct spin_grid {
    int n_levels, n_features;             /* features per level: 1, 2, 4 or 8 */
    float scale[SPIN_MAX_LEVELS][4];      /* vertex k of an axis is at the coordinate k / scale */
    uint32_t res[SPIN_MAX_LEVELS][4];     /* number of vertices per axis */
    uint32_t offset[SPIN_MAX_LEVELS + 1]; /* first row of each level; [n_levels]: number of rows */
    uint8_t hashed[SPIN_MAX_LEVELS];      /* 1 if a level has more vertices than rows */
};

/* Lazy Adam, for a large hash table of which an iteration reads only a small part. The table is
 * divided into lines of 16 values. Lines that no splat of the iteration reads are not updated. For
 * each line the number of its last Adam step is stored, and when the line is read again, all the
 * steps that it missed are applied at once (spin_adam_skip). Lines begin at the first hashed level,
 * since the dense levels before it are small and are updated in every step. */
enum { SPIN_LINE = 16 };
/* Created by lazy_adam_enable(); the device appends private data. */
struct spin_lazy_adam {
    /* [n_lines] last Adam step of each line, or done + 1 if the current step updates the line */
    float SPIN_DEV *last;
    size_t n_lines;
    int64_t done; /* number of completed steps */
};
/* The first level that is divided into lines; n_levels if there is none. */
static inline int spin_lazy_level(const struct spin_grid *grid)
{
    int level = 0;

    while (level < grid->n_levels && !grid->hashed[level])
        level++;
    return level;
}

/* Maps a position p to the encoder's input: (p - centre) * inv_radius, contracted to the unit cube.
 * The time is appended as the last coordinate. */
struct spin_scene_transform {
    float centre[3], inv_radius;
    bool raw; /* an ablation: no contraction; points outside the unit cube get zero features */
};

/* Four heads of three linear layers each, which all have the same input z. The parameters of head k
 * begin at offset[k]:
 *     w1 [hidden][n_in]  b1 [hidden]  w2 [hidden][hidden]  b2 [hidden]
 *     w3 [n_out][hidden]  b3 [n_out]
 * n_in and hidden are multiples of 4. */
enum { SPIN_HEAD_SCALE, SPIN_HEAD_ROTATION, SPIN_HEAD_SH, SPIN_HEAD_OPACITY, SPIN_HEADS };
struct spin_heads {
    int n_in, hidden;
    int n_out[SPIN_HEADS];         /* number of outputs: 3 4 48 1 */
    size_t offset[SPIN_HEADS + 1]; /* floats; [SPIN_HEADS] = total */
    bool relu;                     /* an ablation: ReLU instead of GELU */
};

/* A camera in the form that the verbs use. */
struct spin_camera_f32 {
    int width, height, tiles_x, tiles_y;
    float fx, fy, cx, cy;
    float r[9], t[3];       /* w2c */
    float centre[3];        /* camera centre in world coordinates */
    float limit_x, limit_y; /* 1.3 times the tangent of half the field of view */
    float z_near;           /* splats at this depth or nearer are culled */
    /* Antialiasing: reduce the opacity of splats smaller than a pixel by the factor by which the
     * dilation increases their area. spin_camera_f32_from() sets false. */
    bool antialias;
};
struct spin_camera_f32 spin_camera_f32_from(const struct spin_camera *camera);

/* One projected Gaussian: 64 bytes. radius_px 0 = culled; all other fields are then undefined. */
struct spin_splat2d {
    float u_px, v_px; /* integer coordinates are pixel centres */
    float conic[3];   /* elements a, b, c of the inverse covariance [a b; b c] */
    float opacity;
    float colour[3];
    float depth;
    int32_t radius_px;
    uint16_t x0, y0, x1, y1; /* rectangle of tiles, half open */
    /* Index of the splat's first (splat, tile) pair, if the pairs of the view are ordered by splat.
     * Set by tile_count. */
    uint32_t first_intersection;
    /* bits 0..2: this colour channel was clamped at 0; bits 3, 4: x, y was clamped in the
     * Jacobian */
    uint32_t flags;
    /* Numbers of columns and rows of tiles at the left, top, right and bottom of the rectangle that
     * get no pair, since alpha is below 1/255 everywhere. Set by tile_count. */
    uint8_t tile_cull[4];
};

/* The gradient of a projected Gaussian. */
struct spin_splat2d_grad {
    float u_px, v_px, conic[3], opacity, colour[3];
    float spare[3];
};

/* Largest number of (splat, tile) pairs of one view; their list takes 1 GiB. */
#define SPIN_MAX_PAIRS ((uint64_t)1 << 28)

/* The list of splats of every tile of every view, front to back. */
struct spin_tiles {
    uint64_t n_intersections; /* host; total of all views, set by tile_count */
    /* [n_intersections] splats, sorted by tile, then depth, then index */
    uint32_t SPIN_DEV *intersections;
    uint32_t SPIN_DEV *start; /* [n_views][max_tiles + 1] indices into intersections */
};

/* A track belongs to at most one splat of each frame. The values of the track are added to the
 * splat's own values. */
#define SPIN_NO_TRACK UINT32_MAX
struct spin_tracks_f32 {
    size_t n;
    /* [SPIN_TRACK n] in groups: displacement [n][3], then the groups of residual(). */
    const float SPIN_DEV *values;
    float SPIN_DEV *d_values; /* same layout as values */
    /* [n][SPIN_MOTION], in the unit of a frame's t. NULL: the tracks have neither motion nor a
     * Gaussian window. Splats of tracks with motion have no residual values of their own. */
    const float SPIN_DEV *motion;
};

/* The frames of an iteration. */
enum { SPIN_MAX_FRAMES = 8, SPIN_MAX_VIEWS = 32 };
struct spin_frame_batch {
    int n_frames;
    /* Rows of attributes have only SPIN_ATTR_NARROW floats, with the opacity last. Only possible
     * on the CPU, without a field, and with a single SH coefficient. */
    bool narrow;
    size_t n; /* splats of all frames */
    struct spin_frame_of_batch {
        size_t first, n;             /* rows of the frame in the arrays [n]: first, number */
        float t;                     /* time, 0..1 */
        const float SPIN_DEV *means; /* [n][3] */
        float SPIN_DEV *d_means;     /* same layout as means */
        /* [SPIN_RESIDUAL n], or NULL: see residual() */
        const float SPIN_DEV *residual;
        float SPIN_DEV *d_residual; /* same layout, or NULL: residuals are not trained */
        /* [n][sh_width] SH coefficients beyond the first, or NULL: see residual() */
        const float SPIN_DEV *sh;
        float SPIN_DEV *d_sh; /* same layout, or NULL: sh is not trained */
        size_t sh_width;      /* 9, 24 or 45: SH degree 1, 2 or 3 */
        /* For regularise_back(): derivatives of the loss with respect to each of the three scales
         * and to the opacity of an active splat. */
        float d_scale, d_opacity;

        /* For tracks(). The first n_own_means splats have positions of their own, and the first
         * n_own_residual have residual values of their own; the other splats use only the values of
         * their track. */
        const uint32_t SPIN_DEV *track;     /* [n] index of a track, or SPIN_NO_TRACK */
        const float SPIN_DEV *own_means;    /* [n_own_means][3] */
        const float SPIN_DEV *own_residual; /* [SPIN_RESIDUAL n_own_residual] in groups */
        size_t n_own_means, n_own_residual;
        /* [n_own_means][4] unit quaternions that rotate the displacement and rotation of each
         * splat's track (math/turn.h); NULL: no rotation */
        const float SPIN_DEV *turn;

        /* For densify_stats(); may be NULL. */
        float SPIN_DEV *gradient; /* [n] sum of gradient lengths */
        uint32_t SPIN_DEV *seen;  /* [n] number of views */
    } frame[SPIN_MAX_FRAMES];
};
/* Number of floats in a row of attributes. */
static inline size_t spin_attr_width(const struct spin_frame_batch *frames)
{
    return frames->narrow ? SPIN_ATTR_NARROW : SPIN_ATTR;
}

/* Rows of a frame batch with a nonzero gradient. */
struct spin_active {
    uint32_t SPIN_DEV *row; /* [n] ascending */
    uint32_t SPIN_DEV *n;   /* [1] number of rows */
    size_t most;            /* capacity of `row`: at least the n of the frame batch */
};

/* The views of an iteration. In arrays [n_views][3][max_pixels] the image of view k is planar,
 * [3][h][w], and begins at [k]. */
struct spin_view_batch {
    int n_views;
    size_t max_pixels, max_tiles;
    float background[3];
    struct spin_view_of_batch {
        int frame; /* index in the frame batch */
        /* Rows of the view in splat2d, one for every splat of the frame: first, number. */
        size_t first, n;
        struct spin_camera_f32 camera;
        float weight;       /* factor of this view's loss in the gradient */
        uint32_t image;     /* index of the input image in struct spin_images */
        int exposure, lens; /* rows of the camera and of its lens in the exposure parameters */
        int value;          /* row of the view in the values of loss() and measure() */
    } view[SPIN_MAX_VIEWS];
};

/* Input images. Image k begins at k times the size of an image of max_pixels pixels, and its rows
 * have no padding. */
struct spin_images {
    const uint8_t SPIN_DEV *rgb8; /* [][h][w][3], bytes of 255 times the value; NULL: see f32 */
    const float SPIN_DEV *f32;    /* [][3][h][w], used if rgb8 is NULL */
    /* One bit per pixel, lowest bit first, (max_pixels + 7) / 8 bytes per image; or NULL. */
    const uint8_t SPIN_DEV *mask;
    size_t max_pixels;
    /* mask_weight[b] is the weight in loss() of a pixel whose mask bit is b. Without a mask all
     * weights are 1. */
    float mask_weight[2];
};

/* Values of one view from loss(). */
enum { SPIN_LOSS, SPIN_LOSS_L1, SPIN_LOSS_SSIM, SPIN_LOSS_VALUES };
/* Values of one view from measure(). */
enum {
    SPIN_MEASURE_SQUARES,  /* sum of squared differences over all pixels and channels */
    SPIN_MEASURE_RED,      /* the same sum for the red channel; the next two: green and blue */
    SPIN_MEASURE_SSIM = 4, /* mean SSIM */
    SPIN_MEASURE_OUTSIDE,  /* sum of squared differences over pixels whose mask bit is 0 */
    SPIN_MEASURE_INSIDE,   /* sum of squared differences over pixels whose mask bit is 1 */
    SPIN_MEASURE_VALUES
};

/* Parameters p, their gradients g, and Adam's moments m and v. step counts from 1. */
struct spin_param_group {
    float SPIN_DEV *p, *g, *m, *v; /* [n] */
    size_t n;
    double lr;
    int64_t step;
};

struct spin_device;

/* Operations whose time the device measures separately, see clock(). */
enum {
    SPIN_OP_PIXELS, /* loading of images, on the host */
    SPIN_OP_CONTRACT,
    SPIN_OP_GRID,
    SPIN_OP_MLP,
    SPIN_OP_ACTIVATE,
    SPIN_OP_PROJECT,
    SPIN_OP_TILE,
    SPIN_OP_BLEND,
    SPIN_OP_LOSS,
    SPIN_OP_BLEND_BACK,
    SPIN_OP_PROJECT_BACK,
    SPIN_OP_ACTIVATE_BACK,
    SPIN_OP_MLP_BACK,
    SPIN_OP_GRID_BACK,
    SPIN_OP_ADAM,
    SPIN_OP_CLEAR, /* also copies within device memory */
    SPIN_OP_NONZERO_GRAD,
    SPIN_N_OPS
};
#define SPIN_OP_NAMES                                                                              \
    {                                                                                              \
        "pixels", "contract", "grid", "mlp", "activate", "project", "tile", "blend", "loss",       \
            "blend_back", "project_back", "activate_back", "mlp_back", "grid_back", "adam",        \
            "clear", "nonzero_grad"                                                                \
    }

/* Memory from host_reserve(). Initialise the struct to zero. */
struct spin_host_memory {
    void *at;
    size_t bytes;
    bool pinned; /* page-locked */
};

/* An array to all-reduce in place. */
struct spin_device_sum {
    void SPIN_DEV *at;
    size_t n;
    bool counts; /* the elements are uint32_t; false: float */
};
/* Identifies an all-reduce link between the GPUs of all ranks; created by rank 0. */
struct spin_link_name {
    char text[128];
};

struct spin_device_ops {
    const char *name; /* "cpu", "cuda" */
    /* After a failure, d->description is empty unless a GPU is present. */
    spin_status (*open)(struct spin_device *d, int n_threads);
    void (*close)(struct spin_device *d);

    /* ---- Memory ---- */

    /* Returns zeroed, 64-byte aligned memory (now). */
    spin_status (*reserve)(struct spin_device *d, size_t bytes, void SPIN_DEV **out);
    void (*release)(struct spin_device *d, void SPIN_DEV *block); /* NULL is allowed */
    void (*zero)(struct spin_device *d, void SPIN_DEV *block, size_t bytes);
    void (*upload)(struct spin_device *d, void SPIN_DEV *to, const void *host, size_t bytes);
    /* Waits for all verbs queued before, then copies (now). */
    spin_status (*download)(struct spin_device *d, void *host, const void SPIN_DEV *from,
                            size_t bytes);
    /* Waits for all verbs queued before (now). */
    spin_status (*wait)(struct spin_device *d);
    /* Reserves host memory for transfers to and from the device, 64-byte aligned (now). For a GPU
     * the memory is page-locked if possible, which avoids a staging copy. upload() does not copy
     * from such memory before it returns: the contents must not change before the next wait() or
     * download(). Fails only if out of memory. */
    spin_status (*host_reserve)(struct spin_device *d, size_t bytes, struct spin_host_memory *out);
    void (*host_release)(struct spin_device *d, struct spin_host_memory *memory);
    /* Host address of device memory; NULL: the host cannot access it. */
    void *(*host_view)(struct spin_device *d, void SPIN_DEV *at);
    /* to [n][to_stride] = from [n][from_stride], the first width values of each row. Any 4-byte
     * values; `to` and `from` must not overlap. */
    void (*copy_rows)(struct spin_device *d, size_t n, size_t width, const float SPIN_DEV *from,
                      size_t from_stride, float SPIN_DEV *to, size_t to_stride);
    /* All-reduce between the GPUs of all ranks, without the host. The four functions are NULL in a
     * build without NCCL.
     *
     * link_ready() fails if no link is possible here; about: the library ("NCCL 2.28.9").
     * link_name() creates the name of a link and is called by rank 0 only. All ranks call link() to
     * join, each with a GPU of its own (now). sum() all-reduces every array of the list after the
     * verbs queued before (now). While sum() waits, it calls listen(); if listen() fails, the link
     * is closed and sum() returns the error of listen(). close() also closes the link, and may only
     * be called when all ranks have finished their last sum(). */
    spin_status (*link_ready)(struct spin_device *d, char about[32]);
    spin_status (*link_name)(struct spin_device *d, struct spin_link_name *out);
    spin_status (*link)(struct spin_device *d, const struct spin_link_name *name, int rank,
                        int n_ranks);
    spin_status (*sum)(struct spin_device *d, const struct spin_device_sum *sum, size_t n,
                       spin_status (*listen)(void));
    /* Bytes that can still be reserved (now). 0 from a GPU means that it did not report its
     * memory. */
    size_t (*memory_available)(struct spin_device *d);
    /* Seconds spent in the verbs of one operation (SPIN_OP_...) since the last call for this
     * operation. */
    double (*clock)(struct spin_device *d, int op);

    /* ---- Tracks ---- */

    /* means [n][3] =, residual [SPIN_RESIDUAL n] = the splat's own values plus those of the track.
     * The motion of the track displaces the mean, and its Gaussian window fades the opacity, by the
     * frame's t. In residual the block of each frame starts at the frame's first row. */
    void (*tracks)(struct spin_device *d, const struct spin_frame_batch *frames,
                   const struct spin_tracks_f32 *tracks, float SPIN_DEV *means,
                   float SPIN_DEV *residual);
    /* d_values += the frames' d_means and, unless NULL, d_residual. */
    void (*tracks_back)(struct spin_device *d, const struct spin_frame_batch *frames,
                        const struct spin_tracks_f32 *tracks);

    /* ---- Field ---- */

    /* x_u [n][4] = contract(means), t */
    void (*contract)(struct spin_device *d, const struct spin_scene_transform *transform,
                     const struct spin_frame_batch *frames, float SPIN_DEV *x_u);
    /* d_means += adjoint of contract(), from d_x_u[.][0..2] */
    void (*contract_back)(struct spin_device *d, const struct spin_scene_transform *transform,
                          const struct spin_frame_batch *frames, const struct spin_active *active,
                          const float SPIN_DEV *d_x_u);

    /* z [n][levels * features] = the features of the table, interpolated at x_u */
    void (*grid)(struct spin_device *d, const struct spin_grid *grid, const float SPIN_DEV *table,
                 size_t n, const float SPIN_DEV *x_u, float SPIN_DEV *z);
    /* d_table [rows][features] += and d_x_u [active][4] = adjoint of grid(), with d_x_u[.][3] = 0.
     * d_x_u may be NULL. */
    void (*grid_back)(struct spin_device *d, const struct spin_grid *grid,
                      const float SPIN_DEV *table, const struct spin_active *active,
                      const float SPIN_DEV *x_u, const float SPIN_DEV *d_z, float SPIN_DEV *d_table,
                      float SPIN_DEV *d_x_u);

    /* raw [n][SPIN_ATTR] = heads(z [n][n_in]) */
    void (*mlp)(struct spin_device *d, const struct spin_heads *heads, const float SPIN_DEV *param,
                size_t n, const float SPIN_DEV *z, float SPIN_DEV *raw);
    /* d_param += and d_z [active][n_in] = adjoint of mlp(). Activations are recomputed from z. */
    void (*mlp_back)(struct spin_device *d, const struct spin_heads *heads,
                     const float SPIN_DEV *param, const struct spin_active *active,
                     const float SPIN_DEV *z, const float SPIN_DEV *d_raw, float SPIN_DEV *d_param,
                     float SPIN_DEV *d_z);

    /* residual: raw [n][SPIN_ATTR] += the residual and sh of each frame. The residual
     * [SPIN_RESIDUAL n] consists of four groups: log scale [n][3], rotation [n][4], first SH
     * coefficient [n][3], opacity [n]; sh contains further SH coefficients. Frames whose residual
     * is NULL are unchanged.
     * residual_set: raw = the same values, without a field; SH coefficients beyond those of sh are
     * unchanged.
     * residual_back: d_residual +=, d_sh +=. */
    void (*residual)(struct spin_device *d, const struct spin_frame_batch *frames,
                     float SPIN_DEV *raw);
    void (*residual_set)(struct spin_device *d, const struct spin_frame_batch *frames,
                         float SPIN_DEV *raw);
    void (*residual_back)(struct spin_device *d, const struct spin_frame_batch *frames,
                          const struct spin_active *active, const float SPIN_DEV *d_raw);

    /* attr [n][SPIN_ATTR] = activate(raw) */
    void (*activate)(struct spin_device *d, const struct spin_frame_batch *frames,
                     const float SPIN_DEV *raw, float SPIN_DEV *attr);
    /* d_raw [active][SPIN_ATTR] = adjoint of d_attr [n][SPIN_ATTR] */
    void (*activate_back)(struct spin_device *d, const struct spin_frame_batch *frames,
                          const struct spin_active *active, const float SPIN_DEV *raw,
                          const float SPIN_DEV *d_attr, float SPIN_DEV *d_raw);

    /* d_attr of active rows += the frame's d_scale, for each of the three scales, and d_opacity */
    void (*regularise_back)(struct spin_device *d, const struct spin_frame_batch *frames,
                            const struct spin_active *active, float SPIN_DEV *d_attr);

    /* active = rows whose d_attr or d_means is not all zero (NaN counts as nonzero). d_means may be
     * NULL. */
    void (*nonzero_grad)(struct spin_device *d, const struct spin_frame_batch *frames,
                         const float SPIN_DEV *d_attr, const struct spin_active *active);

    /* ---- Rasteriser ---- */

    /* splat2d = the projections of the splats of each view; sh_degree: 0..3 */
    void (*project)(struct spin_device *d, const struct spin_view_batch *views,
                    const struct spin_frame_batch *frames, const float SPIN_DEV *attr,
                    int sh_degree, struct spin_splat2d SPIN_DEV *splat2d);
    /* d_attr [n][SPIN_ATTR] += and d_means += adjoint of project() */
    void (*project_back)(struct spin_device *d, const struct spin_view_batch *views,
                         const struct spin_frame_batch *frames, const float SPIN_DEV *attr,
                         int sh_degree, const struct spin_splat2d SPIN_DEV *splat2d,
                         const struct spin_splat2d_grad SPIN_DEV *d_splat2d,
                         float SPIN_DEV *d_attr);

    /* Statistics for densification: for every splat visible in a view, gradient of its frame += the
     * length of the gradient of the loss with respect to its centre in normalised device
     * coordinates, and seen += 1. */
    void (*densify_stats)(struct spin_device *d, const struct spin_view_batch *views,
                          const struct spin_frame_batch *frames,
                          const struct spin_splat2d SPIN_DEV *splat2d,
                          const struct spin_splat2d_grad SPIN_DEV *d_splat2d);

    /* tile_count sets first_intersection and tile_cull of every splat, and tiles->n_intersections
     * (now); it fails if a view has more than SPIN_MAX_PAIRS pairs. The caller then provides
     * tiles->intersections with this capacity, and tile_fill fills the list; it fails only if out
     * of memory. */
    spin_status (*tile_count)(struct spin_device *d, const struct spin_view_batch *views,
                              struct spin_splat2d SPIN_DEV *splat2d, struct spin_tiles *tiles);
    spin_status (*tile_fill)(struct spin_device *d, const struct spin_view_batch *views,
                             const struct spin_splat2d SPIN_DEV *splat2d,
                             const struct spin_tiles *tiles);

    /* image =, final_transmittance [n_views][max_pixels] =, last_contributor (same shape) = 1 + the
     * index of the pixel's last contributor in the list of the tile */
    void (*blend)(struct spin_device *d, const struct spin_view_batch *views,
                  const struct spin_splat2d SPIN_DEV *splat2d, const struct spin_tiles *tiles,
                  float SPIN_DEV *image, float SPIN_DEV *final_transmittance,
                  int32_t SPIN_DEV *last_contributor);
    /* depth [n_views][2][max_pixels] =: expected and median depth along the camera axis,
     * math/blend.h */
    void (*depth)(struct spin_device *d, const struct spin_view_batch *views,
                  const struct spin_splat2d SPIN_DEV *splat2d, const struct spin_tiles *tiles,
                  float SPIN_DEV *depth);
    /* d_splat2d = adjoint of blend(), from d_image */
    void (*blend_back)(struct spin_device *d, const struct spin_view_batch *views,
                       const struct spin_splat2d SPIN_DEV *splat2d, const struct spin_tiles *tiles,
                       const float SPIN_DEV *final_transmittance,
                       const int32_t SPIN_DEV *last_contributor, const float SPIN_DEV *d_image,
                       struct spin_splat2d_grad SPIN_DEV *d_splat2d);

    /* values [view.value][SPIN_LOSS_VALUES] = the loss and its parts; d_image = view.weight times
     * the gradient of the loss (d_image may be NULL). The loss is (1 - lambda) L1 + lambda
     * (1 - SSIM), where L1 and SSIM are means over the pixels, weighted by images->mask_weight. The
     * weights are at least 0 and not all 0. */
    void (*loss)(struct spin_device *d, const struct spin_view_batch *views,
                 const struct spin_images *images, float lambda_dssim, const float SPIN_DEV *image,
                 double SPIN_DEV *values, float SPIN_DEV *d_image);
    /* values [view.value][SPIN_MEASURE_VALUES] = the differences of image from the input image;
     * image is first clamped to 0..1 in place. The mask only selects the pixels of
     * SPIN_MEASURE_OUTSIDE and SPIN_MEASURE_INSIDE; it is not a weight. */
    void (*measure)(struct spin_device *d, const struct spin_view_batch *views,
                    const struct spin_images *images, float SPIN_DEV *image,
                    double SPIN_DEV *values);

    /* Applies exposure and lens falloff of the cameras (math/exposure.h): out = f(image), where out
     * may be image. The parameters are rows of SPIN_EXPOSURE floats. For a camera these are log
     * gain r g b and offset r g b, for a lens c1 r g b and c2 r g b.
     * exposure_back: d_image is updated in place, d_exposure +=. */
    void (*exposure)(struct spin_device *d, const struct spin_view_batch *views,
                     const float SPIN_DEV *exposure, const float SPIN_DEV *image,
                     float SPIN_DEV *out);
    void (*exposure_back)(struct spin_device *d, const struct spin_view_batch *views,
                          const float SPIN_DEV *exposure, const float SPIN_DEV *image,
                          float SPIN_DEV *d_image, float SPIN_DEV *d_exposure);
    /* Subtracts the mean of the first n rows from each of these rows. */
    void (*exposure_centre)(struct spin_device *d, size_t n, float SPIN_DEV *exposure);

    /* ---- Optimiser ---- */

    /* One Adam step for all groups, math/adam.h: updates p, m and v, and sets g to zero. */
    void (*adam)(struct spin_device *d, int n_groups, const struct spin_param_group *group);
    /* *count += the number of values that are NaN or infinite */
    void (*not_finite)(struct spin_device *d, size_t n, const float SPIN_DEV *values,
                       uint32_t SPIN_DEV *count);

    /* Lazy Adam, see struct spin_lazy_adam. The functions are NULL on a device without it.
     *     enable:  creates lazy Adam for the arrays of the group, for at most `steps` steps (now)
     *     grid:    like grid(), but first applies the missed steps up to `done` to the lines that
     *              the points need, and marks these lines for the next step
     *     step:    an Adam step with rate lr, for the marked lines and the dense levels
     *     advance: records the rate of a step that was taken before the training was resumed
     *     flush:   out [n] = p as if every line had taken every step up to `done` */
    spin_status (*lazy_adam_enable)(struct spin_device *d, const struct spin_grid *grid,
                                    const struct spin_param_group *table, int64_t steps,
                                    struct spin_lazy_adam **out);
    void (*lazy_adam_close)(struct spin_device *d, struct spin_lazy_adam *lazy);
    void (*lazy_adam_grid)(struct spin_device *d, struct spin_lazy_adam *lazy, size_t n,
                           const float SPIN_DEV *x_u, float SPIN_DEV *z);
    void (*lazy_adam_step)(struct spin_device *d, struct spin_lazy_adam *lazy, double lr);
    void (*lazy_adam_advance)(struct spin_device *d, struct spin_lazy_adam *lazy, double lr);
    void (*lazy_adam_flush)(struct spin_device *d, struct spin_lazy_adam *lazy,
                            float SPIN_DEV *out);
};

/* clang-format off */
/* The members of spin_device_ops after clock, in this order. Every device uses this list to declare
 * its functions, which have the same names, and to fill its table. */
#define SPIN_DEVICE_VERBS(verb)                                                                    \
    verb(tracks) verb(tracks_back) verb(contract) verb(contract_back) verb(grid) verb(grid_back)   \
    verb(mlp) verb(mlp_back) verb(residual) verb(residual_set) verb(residual_back)                 \
    verb(activate) verb(activate_back) verb(regularise_back) verb(nonzero_grad) verb(project)      \
    verb(project_back) verb(densify_stats) verb(tile_count) verb(tile_fill) verb(blend)            \
    verb(depth) verb(blend_back) verb(loss) verb(measure) verb(exposure) verb(exposure_back)       \
    verb(exposure_centre) verb(adam) verb(not_finite) verb(lazy_adam_enable)                       \
    verb(lazy_adam_close) verb(lazy_adam_grid) verb(lazy_adam_step) verb(lazy_adam_advance)        \
    verb(lazy_adam_flush)
/* clang-format on */

enum { SPIN_EXPOSURE = 6 }; /* floats in a row of exposure parameters */

struct spin_device {
    const struct spin_device_ops *op;
    const char *path;     /* SIMD path: "base", "v3", "v4"; results differ in the last bits */
    void *state;          /* private to the device */
    char description[64]; /* "cpu (avx-512, 2 threads)" */
    char card[40];        /* a unique id of the GPU */
    int frames_at_once, views_at_once; /* batch size that suits the device's caches and memory */
    bool is_host; /* device memory is host memory, so the plan adds both requirements up */
    /* Set by the caller at any time: compute sums in a fixed order or in integers, so that the same
     * calls give the same bits. The CPU is always deterministic. */
    bool deterministic;
};

/* name: "auto" (cuda if available, else cpu), "cpu", "cuda". The environment variable SPIN_CPU =
 * base, v3 or v4 selects the CPU's SIMD path. */
spin_status spin_device_open(const char *name, int n_threads, struct spin_device *out);
void spin_device_close(struct spin_device *d);

/* A device that only counts the bytes that are reserved on it, and has no memory: a plan opens its
 * structures on this device to compute the memory that they need. Only reserve(), release(),
 * zero(), upload(), lazy_adam_enable() and lazy_adam_close() may be called. */
struct spin_counting_device {
    struct spin_device device;
    struct spin_device_ops op;
    size_t bytes; /* reserved so far */
};
/* Initialises a counting device with the batch sizes and the lazy Adam of device `as`. It need not
 * be closed. */
void spin_device_count(struct spin_counting_device *c, const struct spin_device *as);
