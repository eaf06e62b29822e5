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
 * pointer arithmetic, but never dereferences them. All pointers below point to device memory unless
 * marked host.
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
    /* Motion of a track that is a 4D splat: its velocity [3], the centre in time of its Gaussian
       window, and 1 / sigma of that window. */
    SPIN_MOTION = 5,
    /* Side of a tile in pixels. Another size changes the results, see docs/method.md 4.2. */
    SPIN_TILE = 16,
    SPIN_MAX_LEVELS = 32
};

/* Geometry of the hash grid (host memory; verbs copy it if they need it later). */
struct spin_grid {
    /* number of levels; number of features per level: 1, 2, 4 or 8 */
    int n_levels, n_features;
    /* for each axis: vertex k is at the coordinate k / scale */
    float scale[SPIN_MAX_LEVELS][4];
    uint32_t res[SPIN_MAX_LEVELS][4];     /* number of vertices on each axis */
    uint32_t offset[SPIN_MAX_LEVELS + 1]; /* first row of each level; [n_levels]: number of rows */
    /* 1 if a level has more vertices than rows, so that vertices share rows by hashing */
    uint8_t hashed[SPIN_MAX_LEVELS];
};

/* Lazy Adam, for a large hash table of which an iteration reads only a small part. The table is
 * divided into lines of 16 values. Lines that no splat of the iteration reads are not updated. For
 * each line the number of its last Adam step is stored, and when the line is read again, all the
 * steps that it missed are applied at once (spin_adam_skip). Lines begin at the first hashed level,
 * since the dense levels before it are small and are updated in every step. */
enum { SPIN_LINE = 16 };
/* The state of lazy Adam for one table. It is created by lazy_adam_enable(), and the device appends
 * private data. */
struct spin_lazy_adam {
    /* [n_lines] last Adam step of each line, or done + 1 if the current step updates the line */
    float SPIN_DEV *last;
    size_t n_lines;
    int64_t done; /* number of completed steps */
};
/* Returns the first level that is divided into lines; n_levels if there is none. */
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
    /* For an ablation: true omits the contraction, and points outside the unit cube get features of
     * 0. */
    bool raw;
};

/* Four heads of three linear layers each, which all have the same input z. The parameters of head k
 * begin at offset[k]:
 *     w1 [hidden][n_in]  b1 [hidden]  w2 [hidden][hidden]  b2 [hidden]
 *     w3 [n_out][hidden]  b3 [n_out]
 * n_in and hidden are multiples of 4. */
enum { SPIN_HEAD_SCALE, SPIN_HEAD_ROTATION, SPIN_HEAD_SH, SPIN_HEAD_OPACITY, SPIN_HEADS };
struct spin_heads {
    int n_in, hidden;
    int n_out[SPIN_HEADS]; /* numbers of outputs: 3, 4, 48 and 1 */
    /* offsets in floats; offset[SPIN_HEADS] is the number of all parameters */
    size_t offset[SPIN_HEADS + 1];
    bool relu; /* for an ablation: true uses ReLU instead of GELU */
};

/* A camera in the form that the verbs use. */
struct spin_camera_f32 {
    int width, height, tiles_x, tiles_y;
    float fx, fy, cx, cy;
    float r[9], t[3]; /* rotation and translation from world to camera */
    float centre[3];  /* camera centre in world coordinates */
    /* limits of x/z and y/z in the Jacobian: 1.3 times the tangent of half the field of view */
    float limit_x, limit_y;
    float z_near; /* splats at this depth or nearer are not drawn */
    /* True: the opacity of splats smaller than a pixel is reduced by the factor by which the
     * dilation increases their area. spin_camera_f32_from() sets this to false. */
    bool antialias;
};
struct spin_camera_f32 spin_camera_f32_from(const struct spin_camera *camera);

/* A projected splat, in 64 bytes. If radius_px is 0, the splat is not drawn, and all other members
 * are undefined. */
struct spin_splat2d {
    /* Screen position of the splat's centre; integer coordinates are pixel centres. */
    float u_px, v_px;
    float conic[3]; /* elements a, b, c of the inverse covariance [a b; b c] */
    float opacity;
    float colour[3];
    float depth;
    int32_t radius_px;
    uint16_t x0, y0, x1, y1; /* rectangle of tiles: columns [x0, x1), rows [y0, y1) */
    /* Index that the splat's first (splat, tile) pair has if the pairs of the view are ordered by
     * splat. Set by tile_count(). */
    uint32_t first_intersection;
    /* Bit c of bits 0 to 2: colour channel c was clamped at 0. Bits 3 and 4: x or y was clamped in
     * the Jacobian. */
    uint32_t flags;
    /* Numbers of columns or rows of tiles at the left, top, right and bottom of the rectangle that
     * get no pair, since the splat's alpha is below 1/255 everywhere in them. Set by tile_count().
     */
    uint8_t tile_cull[4];
};

/* The gradient of a projected Gaussian. */
struct spin_splat2d_grad {
    float u_px, v_px, conic[3], opacity, colour[3];
    /* The sums over the pixels of the absolute values of the pixels' contributions to u_px and to
     * v_px; 0 unless the batch of views asks for them. */
    float absolute_u_px, absolute_v_px;
    float spare;
};

/* Maximum number of (splat, tile) pairs of one view, whose list occupies 1 GiB. */
#define SPIN_MAX_PAIRS ((uint64_t)1 << 28)

/* The list of splats of every tile of every view, front to back. */
struct spin_tiles {
    /* in host memory: number of pairs of all views, set by tile_count() */
    uint64_t n_intersections;
    /* [n_intersections] splat of each pair; pairs are sorted by tile, then depth, then index of the
     * splat. */
    uint32_t SPIN_DEV *intersections;
    uint32_t SPIN_DEV *start; /* [n_views][max_tiles + 1] indices into intersections */
};

/* A track belongs to at most one splat of each frame. The values of the track are added to the
 * splat's own values. */
#define SPIN_NO_TRACK UINT32_MAX
struct spin_tracks_f32 {
    size_t n;
    /* [SPIN_TRACK n], stored in groups: displacement [n][3], then the groups that residual()
     * describes. */
    const float SPIN_DEV *values;
    float SPIN_DEV *d_values; /* gradient, in the layout of `values` */
    /* [n][SPIN_MOTION], in the time unit of a frame's t. If this is NULL, the tracks have neither
     * motion nor a Gaussian window. Splats of tracks with motion have no residual values of their
     * own. */
    const float SPIN_DEV *motion;
};

/* The frames of an iteration. */
enum { SPIN_MAX_FRAMES = 8, SPIN_MAX_VIEWS = 32 };
struct spin_frame_batch {
    int n_frames;
    /* True: rows of attributes have only SPIN_ATTR_NARROW floats, with the opacity last. This is
     * possible only on the CPU, without a field, and with a single SH coefficient. */
    bool narrow;
    size_t n; /* number of splats of all frames */
    struct spin_frame_of_batch {
        /* first row and number of rows of the frame in arrays of all frames */
        size_t first, n;
        float t;                     /* time, 0..1 */
        const float SPIN_DEV *means; /* [n][3] */
        float SPIN_DEV *d_means;     /* gradient, in the layout of `means` */
        /* [SPIN_RESIDUAL n] residual values in the layout of residual(); NULL: none */
        const float SPIN_DEV *residual;
        /* gradient in the same layout; NULL: residual values are not trained */
        float SPIN_DEV *d_residual;
        /* [n][sh_width] SH coefficients beyond the first, which residual() adds; NULL: none */
        const float SPIN_DEV *sh;
        float SPIN_DEV *d_sh; /* gradient in the same layout; NULL: `sh` is not trained */
        size_t sh_width;      /* 9, 24 or 45: SH degree 1, 2 or 3 */
        /* The following members are for tracks(). The first n_own_means splats have positions of
         * their own, and the first n_own_residual splats have residual values of their own; the
         * other splats use only the values of their track. */
        const uint32_t SPIN_DEV *track;     /* [n] index of each splat's track, or SPIN_NO_TRACK */
        const float SPIN_DEV *own_means;    /* [n_own_means][3] */
        const float SPIN_DEV *own_residual; /* [SPIN_RESIDUAL n_own_residual], in groups */
        size_t n_own_means, n_own_residual;
        /* [n_own_means][4] unit quaternions, each of which rotates the displacement and the
         * rotation that a splat gets from its track (math/quat.h); NULL: no rotation. */
        const float SPIN_DEV *turn;

        /* The following members are for densify_stats() and may be NULL. */
        /* [n] sum over views of the length of the gradient of each splat's screen position */
        float SPIN_DEV *gradient;
        uint32_t SPIN_DEV *seen; /* [n] number of views in which each splat is visible */
    } frame[SPIN_MAX_FRAMES];
};
/* Returns the number of floats in a row of attributes. */
static inline size_t spin_attr_width(const struct spin_frame_batch *frames)
{
    return frames->narrow ? SPIN_ATTR_NARROW : SPIN_ATTR;
}

/* The active rows of a frame batch: those with a nonzero gradient. */
struct spin_active {
    uint32_t SPIN_DEV *row; /* [n] indices of the active rows, ascending */
    uint32_t SPIN_DEV *n;   /* [1] number of rows */
    /* capacity of `row`, at least the number of splats of the frame batch */
    size_t most;
};

/* The views of an iteration. In arrays [n_views][3][max_pixels], the image of view k begins at
 * element [k] and is planar, [3][h][w]. */
struct spin_view_batch {
    int n_views;
    size_t max_pixels, max_tiles;
    float background[3];
    /* true: blend_back() sets absolute_u_px and absolute_v_px, and densify_stats() uses them. In
     * u_px and v_px, the contributions of pixels cancel out if a splat is too large for the detail
     * that it covers. */
    bool absolute;
    struct spin_view_of_batch {
        int frame; /* index of the view's frame in the frame batch */
        /* First row and number of rows of the view in splat2d, which has one row for every splat of
         * the frame. */
        size_t first, n;
        struct spin_camera_f32 camera;
        float weight;   /* factor by which the gradient of this view's loss is multiplied */
        uint32_t image; /* index of the input image in struct spin_images */
        /* [h][w] Known alpha of the input image: 0 if unknown, otherwise 1 + 254 alpha, rounded.
         * NULL: unknown everywhere. Where alpha is known, blend() adds `background_change` to the
         * background, and loss() composites the input image over the changed background. */
        const uint8_t SPIN_DEV *matte;
        float background_change[3];
        int exposure, lens; /* rows of the camera and of its lens in the exposure parameters */
        int value;          /* row of the view in the values of loss() and measure() */
    } view[SPIN_MAX_VIEWS];
};

/* The input images. Each occupies the memory of max_pixels pixels, so image k begins k * max_pixels
 * pixels after the first image. Rows have no padding. */
struct spin_images {
    const uint8_t SPIN_DEV *rgb8; /* [][h][w][3], 255 times the value; NULL: f32 is used */
    const float SPIN_DEV *f32;    /* [][3][h][w], used if rgb8 is NULL */
    /* A mask for each image, with one bit per pixel, lowest bit first, in (max_pixels + 7) / 8
     * bytes; NULL: there are no masks. */
    const uint8_t SPIN_DEV *mask;
    size_t max_pixels;
    /* mask_weight[b] is the weight in loss() of a pixel whose mask bit is b. Without a mask all
     * weights are 1. */
    float mask_weight[2];
};

/* The values that loss() computes for one view: the loss and its parts. */
enum { SPIN_LOSS, SPIN_LOSS_L1, SPIN_LOSS_SSIM, SPIN_LOSS_VALUES };
/* The values that measure() computes for one view. */
enum {
    SPIN_MEASURE_SQUARES,  /* sum of squared differences over all pixels and channels */
    SPIN_MEASURE_RED,      /* the same sum for red; green and blue follow */
    SPIN_MEASURE_SSIM = 4, /* mean SSIM */
    SPIN_MEASURE_OUTSIDE,  /* sum of squared differences over pixels whose mask bit is 0 */
    SPIN_MEASURE_INSIDE,   /* sum of squared differences over pixels whose mask bit is 1 */
    SPIN_MEASURE_VALUES
};

/* A group of parameters p with their gradients g, the moments m and v of Adam, and the number of
 * the Adam step, counted from 1. */
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
    SPIN_OP_CLEAR, /* setting to zero, and copying within device memory */
    SPIN_OP_NONZERO_GRAD,
    SPIN_N_OPS
};
#define SPIN_OP_NAMES                                                                              \
    {                                                                                              \
        "pixels", "contract", "grid", "mlp", "activate", "project", "tile", "blend", "loss",       \
            "blend_back", "project_back", "activate_back", "mlp_back", "grid_back", "adam",        \
            "clear", "nonzero_grad"                                                                \
    }

/* Host memory from host_reserve(). The caller initialises the struct to zero. */
struct spin_host_memory {
    void *at;
    size_t bytes;
    bool pinned; /* whether the memory is page-locked */
};

struct spin_device_ops {
    const char *name; /* "cpu", "cuda" */
    /* Opens the device. After a failure, d->description is empty if no GPU is present. */
    spin_status (*open)(struct spin_device *d, int n_threads);
    void (*close)(struct spin_device *d);

    /* ---- Memory ---- */

    /* Returns zeroed, 64-byte aligned memory (now). */
    spin_status (*reserve)(struct spin_device *d, size_t bytes, void SPIN_DEV **out);
    void (*release)(struct spin_device *d, void SPIN_DEV *block); /* NULL is allowed */
    void (*zero)(struct spin_device *d, void SPIN_DEV *block, size_t bytes);
    void (*upload)(struct spin_device *d, void SPIN_DEV *to, const void *host, size_t bytes);
    /* Waits for all verbs that were queued before, then copies device memory to the host (now). */
    spin_status (*download)(struct spin_device *d, void *host, const void SPIN_DEV *from,
                            size_t bytes);
    /* Waits for all verbs that were queued before (now). */
    spin_status (*wait)(struct spin_device *d);
    /* Reserves host memory for transfers to and from the device, 64-byte aligned (now). For a GPU
     * the memory is page-locked if possible, which avoids a staging copy. upload() may return
     * before it has copied such memory, so the contents must not change before the next wait() or
     * download(). Fails only if out of memory. */
    spin_status (*host_reserve)(struct spin_device *d, size_t bytes, struct spin_host_memory *out);
    void (*host_release)(struct spin_device *d, struct spin_host_memory *memory);
    /* Returns the host address of device memory; NULL if the host cannot access it. */
    void *(*host_view)(struct spin_device *d, void SPIN_DEV *at);
    /* Copies the first `width` values of each row of `from` [n][from_stride] to `to`
     * [n][to_stride]. The values may be of any 4-byte type; `to` and `from` must not overlap. */
    void (*copy_rows)(struct spin_device *d, size_t n, size_t width, const float SPIN_DEV *from,
                      size_t from_stride, float SPIN_DEV *to, size_t to_stride);
    /* Returns the number of bytes that can still be reserved (now). A GPU that does not report its
     * memory returns 0. */
    size_t (*memory_available)(struct spin_device *d);
    /* Returns the seconds spent in the verbs of operation `op` (SPIN_OP_...) since the last call
     * for this operation. */
    double (*clock)(struct spin_device *d, int op);

    /* ---- Tracks ---- */

    /* Sets means [n][3] and residual [SPIN_RESIDUAL n] to the sum of each splat's own values and
     * those of its track. At the frame's time t, the motion of the track displaces the mean, and
     * the Gaussian window of the track reduces the opacity. In `residual` the block of each frame
     * starts at the frame's first row. */
    void (*tracks)(struct spin_device *d, const struct spin_frame_batch *frames,
                   const struct spin_tracks_f32 *tracks, float SPIN_DEV *means,
                   float SPIN_DEV *residual);
    /* The adjoint of tracks(): adds d_means and, unless NULL, d_residual of all frames to d_values.
     */
    void (*tracks_back)(struct spin_device *d, const struct spin_frame_batch *frames,
                        const struct spin_tracks_f32 *tracks);

    /* ---- Field ---- */

    /* Sets x_u [n][4] to the means, contracted to the unit cube, and the time t of the frame. */
    void (*contract)(struct spin_device *d, const struct spin_scene_transform *transform,
                     const struct spin_frame_batch *frames, float SPIN_DEV *x_u);
    /* The adjoint of contract(): adds to d_means the gradient that follows from d_x_u[.][0..2]. */
    void (*contract_back)(struct spin_device *d, const struct spin_scene_transform *transform,
                          const struct spin_frame_batch *frames, const struct spin_active *active,
                          const float SPIN_DEV *d_x_u);

    /* Sets z [n][levels * features] to the features of the table, interpolated at x_u. */
    void (*grid)(struct spin_device *d, const struct spin_grid *grid, const float SPIN_DEV *table,
                 size_t n, const float SPIN_DEV *x_u, float SPIN_DEV *z);
    /* The adjoint of grid(): adds to d_table [rows][features] and, unless d_x_u is NULL, sets d_x_u
     * [active][4], with d_x_u[.][3] = 0. */
    void (*grid_back)(struct spin_device *d, const struct spin_grid *grid,
                      const float SPIN_DEV *table, const struct spin_active *active,
                      const float SPIN_DEV *x_u, const float SPIN_DEV *d_z, float SPIN_DEV *d_table,
                      float SPIN_DEV *d_x_u);

    /* Sets raw [n][SPIN_ATTR] to the outputs of the heads for the inputs z [n][n_in]. */
    void (*mlp)(struct spin_device *d, const struct spin_heads *heads, const float SPIN_DEV *param,
                size_t n, const float SPIN_DEV *z, float SPIN_DEV *raw);
    /* The adjoint of mlp(): adds to d_param and sets d_z [active][n_in]. Activations are recomputed
     * from z. */
    void (*mlp_back)(struct spin_device *d, const struct spin_heads *heads,
                     const float SPIN_DEV *param, const struct spin_active *active,
                     const float SPIN_DEV *z, const float SPIN_DEV *d_raw, float SPIN_DEV *d_param,
                     float SPIN_DEV *d_z);

    /* residual() adds the residual values and sh of each frame to raw [n][SPIN_ATTR]. The residual
     * values [SPIN_RESIDUAL n] consist of four groups: log scale [n][3], rotation [n][4], first SH
     * coefficient [n][3], opacity [n]; sh contains further SH coefficients. The rows of a frame
     * whose residual is NULL stay unchanged. residual_set() is for splats without a field: it sets
     * `raw` to these values instead; SH coefficients beyond those of sh stay unchanged.
     * residual_back() is the adjoint, which adds to d_residual and d_sh. */
    void (*residual)(struct spin_device *d, const struct spin_frame_batch *frames,
                     float SPIN_DEV *raw);
    void (*residual_set)(struct spin_device *d, const struct spin_frame_batch *frames,
                         float SPIN_DEV *raw);
    void (*residual_back)(struct spin_device *d, const struct spin_frame_batch *frames,
                          const struct spin_active *active, const float SPIN_DEV *d_raw);

    /* Sets attr [n][SPIN_ATTR] to the activated `raw`. */
    void (*activate)(struct spin_device *d, const struct spin_frame_batch *frames,
                     const float SPIN_DEV *raw, float SPIN_DEV *attr);
    /* The adjoint of activate(): sets d_raw [active][SPIN_ATTR], given d_attr [n][SPIN_ATTR]. */
    void (*activate_back)(struct spin_device *d, const struct spin_frame_batch *frames,
                          const struct spin_active *active, const float SPIN_DEV *raw,
                          const float SPIN_DEV *d_attr, float SPIN_DEV *d_raw);

    /* Sets `active` to the rows that have a nonzero value in d_attr or in the frame's d_means,
     * which may be NULL. NaN counts as nonzero. */
    void (*nonzero_grad)(struct spin_device *d, const struct spin_frame_batch *frames,
                         const float SPIN_DEV *d_attr, const struct spin_active *active);

    /* ---- Rasteriser ---- */

    /* Sets splat2d to the projections of the splats of each view. sh_degree is 0..3. */
    void (*project)(struct spin_device *d, const struct spin_view_batch *views,
                    const struct spin_frame_batch *frames, const float SPIN_DEV *attr,
                    int sh_degree, struct spin_splat2d SPIN_DEV *splat2d);
    /* The adjoint of project(): adds to d_attr [n][SPIN_ATTR] and to d_means of the frames. */
    void (*project_back)(struct spin_device *d, const struct spin_view_batch *views,
                         const struct spin_frame_batch *frames, const float SPIN_DEV *attr,
                         int sh_degree, const struct spin_splat2d SPIN_DEV *splat2d,
                         const struct spin_splat2d_grad SPIN_DEV *d_splat2d,
                         float SPIN_DEV *d_attr);

    /* Updates the statistics for densification. For every splat that is visible in a view, adds to
     * `gradient` of its frame the length of the gradient of the loss with respect to the splat's
     * centre in normalised device coordinates, and adds 1 to `seen`. If views->absolute, the
     * gradient is that of absolute_u_px and absolute_v_px. */
    void (*densify_stats)(struct spin_device *d, const struct spin_view_batch *views,
                          const struct spin_frame_batch *frames,
                          const struct spin_splat2d SPIN_DEV *splat2d,
                          const struct spin_splat2d_grad SPIN_DEV *d_splat2d);

    /* tile_count() sets first_intersection and tile_cull of every splat, and tiles->n_intersections
     * (now). It fails if a view has more than SPIN_MAX_PAIRS pairs. The caller then provides
     * tiles->intersections with a capacity of n_intersections, and tile_fill() fills this list.
     * tile_fill() fails only if out of memory. */
    spin_status (*tile_count)(struct spin_device *d, const struct spin_view_batch *views,
                              struct spin_splat2d SPIN_DEV *splat2d, struct spin_tiles *tiles);
    spin_status (*tile_fill)(struct spin_device *d, const struct spin_view_batch *views,
                             const struct spin_splat2d SPIN_DEV *splat2d,
                             const struct spin_tiles *tiles);

    /* Sets image, final_transmittance [n_views][max_pixels], and last_contributor, of the same
     * shape: 1 plus the index of the last splat that contributes to the pixel, in the list of its
     * tile; 0 if no splat contributes. */
    void (*blend)(struct spin_device *d, const struct spin_view_batch *views,
                  const struct spin_splat2d SPIN_DEV *splat2d, const struct spin_tiles *tiles,
                  float SPIN_DEV *image, float SPIN_DEV *final_transmittance,
                  int32_t SPIN_DEV *last_contributor);
    /* Sets depth [n_views][2][max_pixels] to the expected and the median depth along the camera
     * axis (math/blend.h). */
    void (*depth)(struct spin_device *d, const struct spin_view_batch *views,
                  const struct spin_splat2d SPIN_DEV *splat2d, const struct spin_tiles *tiles,
                  float SPIN_DEV *depth);
    /* The adjoint of blend(): sets d_splat2d, given d_image. */
    void (*blend_back)(struct spin_device *d, const struct spin_view_batch *views,
                       const struct spin_splat2d SPIN_DEV *splat2d, const struct spin_tiles *tiles,
                       const float SPIN_DEV *final_transmittance,
                       const int32_t SPIN_DEV *last_contributor, const float SPIN_DEV *d_image,
                       struct spin_splat2d_grad SPIN_DEV *d_splat2d);

    /* Sets values [view.value][SPIN_LOSS_VALUES] to the loss and its parts and, unless d_image is
     * NULL, d_image to view.weight times the gradient of the loss. The loss is (1 - lambda) L1 +
     * lambda (1 - SSIM), where L1 and SSIM are means over the pixels, weighted by
     * images->mask_weight. The weights are at least 0 and not all 0. */
    void (*loss)(struct spin_device *d, const struct spin_view_batch *views,
                 const struct spin_images *images, float lambda_dssim, const float SPIN_DEV *image,
                 double SPIN_DEV *values, float SPIN_DEV *d_image);
    /* Sets values [view.value][SPIN_MEASURE_VALUES] to the differences of `image` from the input
     * image. `image` is first clamped to 0..1 in place. The mask only selects the pixels of
     * SPIN_MEASURE_OUTSIDE and SPIN_MEASURE_INSIDE; it is not a weight. */
    void (*measure)(struct spin_device *d, const struct spin_view_batch *views,
                    const struct spin_images *images, float SPIN_DEV *image,
                    double SPIN_DEV *values);

    /* exposure() applies the exposure of each camera and the falloff of its lens to `image` and
     * writes the result to `out`, which may be `image` (math/exposure.h). The parameters are rows
     * of SPIN_EXPOSURE floats, in the order r, g, b: log gain [3] and offset [3] for a camera, c1
     * [3] and c2 [3] for a lens. exposure_back() is the adjoint: it updates d_image in place and
     * adds to d_exposure. */
    void (*exposure)(struct spin_device *d, const struct spin_view_batch *views,
                     const float SPIN_DEV *exposure, const float SPIN_DEV *image,
                     float SPIN_DEV *out);
    void (*exposure_back)(struct spin_device *d, const struct spin_view_batch *views,
                          const float SPIN_DEV *exposure, const float SPIN_DEV *image,
                          float SPIN_DEV *d_image, float SPIN_DEV *d_exposure);
    /* Subtracts the mean of the first n rows from each of these rows, so that the mean exposure
     * stays neutral. */
    void (*exposure_centre)(struct spin_device *d, size_t n, float SPIN_DEV *exposure);

    /* ---- Optimiser ---- */

    /* Takes one Adam step for all groups (math/adam.h): updates p, m and v, and sets g to zero. */
    void (*adam)(struct spin_device *d, int n_groups, const struct spin_param_group *group);
    /* Adds to *count the number of values that are NaN or infinite. */
    void (*not_finite)(struct spin_device *d, size_t n, const float SPIN_DEV *values,
                       uint32_t SPIN_DEV *count);

    /* Lazy Adam, see struct spin_lazy_adam. The functions are NULL on a device without it.
     *     enable:  creates lazy Adam for the arrays of the group, for at most `steps` steps (now)
     *     grid:    like grid(), but first applies the missed steps up to `done` to the lines that
     *              the points need, and marks these lines for the next step
     *     step:    takes an Adam step with rate lr, for the marked lines and the dense levels
     *     advance: records the rate of a step that was taken before the training was resumed
     *     flush:   sets out [n] to p as if every line had taken every step up to `done` */
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
/* The members of spin_device_ops after `clock`, in this order. Every device uses this list to
 * declare its functions, which have these names, and to fill its table. */
#define SPIN_DEVICE_VERBS(verb)                                                                    \
    verb(tracks) verb(tracks_back) verb(contract) verb(contract_back) verb(grid) verb(grid_back)   \
    verb(mlp) verb(mlp_back) verb(residual) verb(residual_set) verb(residual_back)                 \
    verb(activate) verb(activate_back) verb(nonzero_grad) verb(project)      \
    verb(project_back) verb(densify_stats) verb(tile_count) verb(tile_fill) verb(blend)            \
    verb(depth) verb(blend_back) verb(loss) verb(measure) verb(exposure) verb(exposure_back)       \
    verb(exposure_centre) verb(adam) verb(not_finite) verb(lazy_adam_enable)                       \
    verb(lazy_adam_close) verb(lazy_adam_grid) verb(lazy_adam_step) verb(lazy_adam_advance)        \
    verb(lazy_adam_flush)
/* clang-format on */

enum { SPIN_EXPOSURE = 6 }; /* number of floats in a row of exposure parameters */

struct spin_device {
    const struct spin_device_ops *op;
    /* SIMD path of the CPU: "base", "v3" or "v4", whose results differ in the last bits; "cuda" on
     * a GPU */
    const char *path;
    void *state;          /* private to the device */
    char description[64]; /* "cpu (avx-512, 2 threads)" */
    /* numbers of frames and views to put into one batch, for the best use of the device's caches */
    int frames_at_once, views_at_once;
    /* true: device memory is host memory, so a plan adds up the memory for device and host */
    bool is_host;
    /* The caller may set this at any time. True: sums are computed in a fixed order or in integers,
     * so that the same calls give the same bits. The CPU always does so. */
    bool deterministic;
};

/* Opens the device called `name`: "cpu", "cuda", or "auto" for cuda if that is available, else cpu.
 * The environment variable SPIN_CPU, which may be base, v3 or v4, selects the SIMD path of the CPU.
 */
spin_status spin_device_open(const char *name, int n_threads, struct spin_device *out);
void spin_device_close(struct spin_device *d);

/* A device that only counts the bytes that are reserved on it, and has no memory: a plan opens its
 * structures on this device to compute the memory that they need. Only reserve(), release(),
 * zero(), upload(), lazy_adam_enable() and lazy_adam_close() may be called. */
struct spin_counting_device {
    struct spin_device device;
    struct spin_device_ops op;
    size_t bytes; /* number of bytes reserved so far */
};
/* Initialises a counting device. It has the batch sizes of device `as`, and supports lazy Adam if
 * `as` does. A counting device need not be closed. */
void spin_device_count(struct spin_counting_device *c, const struct spin_device *as);
