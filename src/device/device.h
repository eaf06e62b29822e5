/* The operations ("verbs") of training and rendering, and the devices that do them.
 *
 * Verbs take the whole step: all its frames and all its views. They are queued in order: nothing
 * has happened on return, except where it says "now". Structs and host arguments are copied by the
 * call, so they may be changed or freed afterwards. Verbs without a status cannot fail: sizes were
 * checked when the run was planned; what goes wrong all the same is reported by the next wait() or
 * download().
 *
 * A device owns its memory. Pointers to it are marked SPIN_DEV: the host passes them on and adds to
 * them, and does not follow them. All pointers below are device memory unless marked host. "="
 * overwrites,
 * "+=" accumulates.
 *
 * Attributes of a Gaussian travel as one row of SPIN_ATTR floats, in the order of the heads:
 *     scale [3]  rotation [4] (w,x,y,z)  sh [16][3]  opacity [1]
 * `raw` rows are head outputs, `attr` rows are finished (linear scale, unit quaternion, opacity
 * 0..1).
 *
 * Arrays [n] hold the splats of all frames of a batch, one frame after the other. Backward verbs
 * take `active`, an ascending list of the rows that have any gradient; compact arrays (d_raw, d_z,
 * d_x_u) have one row for each of the list, in its order, full ones have n rows. */
#pragma once

#include "spin.h"

/* Device memory: clang reports code that follows such a pointer (tests/lint/noderef.sh). To the CPU
 * device itself, and to the CUDA device, it is ordinary memory. */
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
    SPIN_ATTR_NARROW =
        12, /* without SH beyond the first coefficient: see struct spin_frame_batch */
    SPIN_RESIDUAL =
        11, /* own values of a splat: log scale [3], rotation [4], colour [3], opacity [1] */
    SPIN_TRACK = 3 + SPIN_RESIDUAL, /* values of a track: displacement [3], then as a residual */
    SPIN_MOTION = 5, /* of a track that is a 4D splat: velocity [3], time, 1 / standard deviation of
                        its bell */
    SPIN_TILE = 16,  /* pixels; part of the result, docs/method.md 4.2 */
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

/* Adam for a table of which a step touches little. Values go in lines of 16. A line that no splat
 * of the step needs is not updated: it keeps the number of the step of its last update, and the
 * updates that it missed are applied together when it is needed again (spin_adam_skip). Lines begin
 * with the first hashed level: levels before it are small, and take every step. */
enum { SPIN_LINE = 16 };
struct spin_lazy_adam { /* made by lazy_adam_enable(); the device keeps more behind it */
    float SPIN_DEV
        *last; /* [n_lines] step of a line's last update; done + 1 when this step needs it */
    size_t n_lines;
    int64_t done; /* steps that are over */
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
    float z_near;           /* splats at this depth or nearer are culled */
    bool antialias;         /* splats smaller than a pixel are drawn fainter, not only wider;
                               spin_camera_f32_from: no */
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

/* The splats of every tile of every view, front to back. Views have max_tiles + 1 places in
 * `start`. */
struct spin_tiles {
    uint64_t n_intersections; /* host; of all views, set by tile_count */
    uint32_t SPIN_DEV
        *intersections;       /* [n_intersections] splats, sorted by tile, then depth, then index */
    uint32_t SPIN_DEV *start; /* [n_views][max_tiles + 1] places in intersections */
};

/* A track is one Gaussian over the clip: it belongs to at most one splat of a frame, and its values
 * are added to those that this splat has of its own. */
#define SPIN_NO_TRACK UINT32_MAX
struct spin_tracks_f32 {
    size_t n;
    const float SPIN_DEV
        *values;              /* [SPIN_TRACK n] in groups: displacement [n][3], then as residuals */
    float SPIN_DEV *d_values; /* the same */
    /* [n][SPIN_MOTION], in the unit of a frame's t, or NULL: tracks are where they are, and are
     * seen whole. Splats of such tracks have no residual values of their own. */
    const float SPIN_DEV *motion;
};

/* The frames of a step. */
enum { SPIN_MAX_FRAMES = 8, SPIN_MAX_VIEWS = 32 };
struct spin_frame_batch {
    int n_frames;
    /* Rows of attributes have SPIN_ATTR_NARROW floats, the opacity last: on the CPU, without a
     * network, for one SH coefficient. */
    bool narrow;
    size_t n; /* splats of all frames */
    struct spin_frame_of_batch {
        size_t first, n;                /* its rows */
        float t;                        /* time, 0..1 */
        const float SPIN_DEV *means;    /* [n][3] */
        float SPIN_DEV *d_means;        /* [n][3] */
        const float SPIN_DEV *residual; /* [SPIN_RESIDUAL n], or NULL: see residual() */
        float SPIN_DEV *d_residual;     /* the same, or NULL: residuals are not trained */
        const float SPIN_DEV *sh; /* [n][sh_width], beside residuals, or NULL: see residual() */
        float SPIN_DEV *d_sh;     /* the same, or NULL: it is not trained */
        size_t sh_width;          /* 9, 24 or 45: of degree 1, 2 or 3 */
        float d_scale,
            d_opacity; /* slope of the loss by each scale and each opacity of an active splat */

        /* For tracks(). Of the splats, the first n_own_means have a position of their own, and the
         * first n_own_residual own residual values; the others have only what their track has. */
        const uint32_t SPIN_DEV *track;     /* [n] row of the tracks, or SPIN_NO_TRACK */
        const float SPIN_DEV *own_means;    /* [n_own_means][3] */
        const float SPIN_DEV *own_residual; /* [SPIN_RESIDUAL n_own_residual] in groups */
        size_t n_own_means, n_own_residual;
        const float SPIN_DEV
            *turn; /* [n_own_means][4] unit quaternions by which displacement and rotation of a
                    * track are turned here (math/turn.h); or NULL: they are not */

        /* For densify_stats(); or NULL. */
        float SPIN_DEV *gradient; /* [n] */
        uint32_t SPIN_DEV *seen;  /* [n] */
    } frame[SPIN_MAX_FRAMES];
};
/* Floats of a row of attributes. */
static inline size_t spin_attr_width(const struct spin_frame_batch *frames)
{
    return frames->narrow ? SPIN_ATTR_NARROW : SPIN_ATTR;
}

/* Rows of a frame batch that have a gradient. */
struct spin_active {
    uint32_t SPIN_DEV *row; /* [n] ascending */
    uint32_t SPIN_DEV *n;   /* [1] */
    size_t most;            /* rows there is room for: at least the frames' n */
};

/* The views of a step. Pictures of a view are planar [3][h][w] at its place in
 * [n_views][3][max_pixels]. */
struct spin_view_batch {
    int n_views;
    size_t max_pixels, max_tiles;
    float background[3];
    struct spin_view_of_batch {
        int frame;       /* that it shows, of the frame batch */
        size_t first, n; /* its rows in splat2d: one for every splat of the frame */
        struct spin_camera_f32 camera;
        float weight;       /* of its loss in the gradient */
        uint32_t image;     /* its photograph */
        int exposure, lens; /* rows of its camera, and of its camera's lens, among the exposures */
        int value;          /* its row in the values of loss() and measure() */
    } view[SPIN_MAX_VIEWS];
};

/* Photographs, by number, tightly packed: number k begins at k times the room for max_pixels. */
struct spin_images {
    const uint8_t SPIN_DEV *rgb8; /* [][h][w][3], a byte is 255 times the value; or NULL: */
    const float SPIN_DEV *f32;    /* [][3][h][w] */
    const uint8_t SPIN_DEV
        *mask; /* a bit a pixel, lowest first, rows of (max_pixels + 7) / 8; or NULL */
    size_t max_pixels;
    float mask_weight[2]; /* how often a pixel counts in loss() whose bit is 0, 1; without a mask:
                             once */
};

/* Values of one view. */
enum { SPIN_LOSS, SPIN_LOSS_L1, SPIN_LOSS_SSIM, SPIN_LOSS_VALUES };
enum {
    SPIN_MEASURE_SQUARES,  /* sum over all pixels and channels of the squared difference */
    SPIN_MEASURE_RED,      /* the same of one channel; green and blue follow */
    SPIN_MEASURE_SSIM = 4, /* mean */
    SPIN_MEASURE_OUTSIDE,  /* sum of squares where the mask is 0 ... */
    SPIN_MEASURE_INSIDE,   /* ... and 1 */
    SPIN_MEASURE_VALUES
};

/* Parameters that take a step of Adam together. step counts from 1. */
struct spin_param_group {
    float SPIN_DEV *p, *g, *m, *v; /* [n] */
    size_t n;
    double lr;
    int64_t step;
};

struct spin_device;

/* What the device's time goes to. */
enum {
    SPIN_OP_PIXELS, /* loading photographs: the host's */
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
    SPIN_OP_CLEAR, /* and copies within the device's memory */
    SPIN_OP_NONZERO_GRAD,
    SPIN_N_OPS
};
#define SPIN_OP_NAMES                                                                              \
    {                                                                                              \
        "pixels", "contract", "grid", "mlp", "activate", "project", "tile", "blend", "loss",       \
            "blend_back", "project_back", "activate_back", "mlp_back", "grid_back", "adam",        \
            "clear", "nonzero_grad"                                                                \
    }

/* Zero it to begin. */
struct spin_host_memory {
    void *at;
    size_t bytes;
    bool pinned; /* page-locked */
};

/* Numbers whose sums over all ranks take their place on each of them. */
struct spin_device_sum {
    void SPIN_DEV *at;
    size_t n;
    bool counts; /* unsigned numbers of 32 bits; else floats */
};
/* A connection between the cards of all ranks: the name that rank 0 makes for it. */
struct spin_link_name {
    char text[128];
};

struct spin_device_ops {
    const char *name; /* "cpu", "cuda" */
    /* Where it fails although there is a card, the description is not empty. */
    spin_status (*open)(struct spin_device *d, int n_threads);
    void (*close)(struct spin_device *d);

    /* Memory. reserve() gives zeroed, 64-byte aligned memory (now). */
    spin_status (*reserve)(struct spin_device *d, size_t bytes, void SPIN_DEV **out);
    void (*release)(struct spin_device *d, void SPIN_DEV *block); /* NULL: nothing */
    void (*zero)(struct spin_device *d, void SPIN_DEV *block, size_t bytes);
    void (*upload)(struct spin_device *d, void SPIN_DEV *to, const void *host, size_t bytes);
    /* Now: all that was queued before is done. */
    spin_status (*download)(struct spin_device *d, void *host, const void SPIN_DEV *from,
                            size_t bytes);
    spin_status (*wait)(struct spin_device *d);
    /* Host memory for bytes on their way to and from the device, 64-byte aligned (now). A card
     * copies to and from it without a copy of its own, as it is page-locked; where that cannot be
     * had it is ordinary memory, and so it is on the CPU. An upload from it is queued like a verb:
     * it must not change before the next wait() or download(). Fails only without memory. */
    spin_status (*host_reserve)(struct spin_device *d, size_t bytes, struct spin_host_memory *out);
    void (*host_release)(struct spin_device *d, struct spin_host_memory *memory);
    /* Where the host finds device memory; NULL: it cannot. */
    void *(*host_view)(struct spin_device *d, void SPIN_DEV *at);
    /* to [n][to_stride] = from [n][from_stride], the first width of each row. Any 4-byte values; to
     * and from are apart. */
    void (*copy_rows)(struct spin_device *d, size_t n, size_t width, const float SPIN_DEV *from,
                      size_t from_stride, float SPIN_DEV *to, size_t to_stride);
    /* Sums over ranks from card to card, without the host; all NULL in a build without it. ready:
     * whether it can be had here, and by what ("NCCL 2.28.9"). name: by rank 0 alone. link: all
     * ranks join, each with a card of its own (now). sum: all of the list, after what was queued
     * before; now. While it waits it calls listen(): when that fails, the link is given up, and its
     * failure is the verb's. close() gives up the link as well: before it, all ranks must know that
     * all have done their last sum. */
    spin_status (*link_ready)(struct spin_device *d, char about[32]);
    spin_status (*link_name)(struct spin_device *d, struct spin_link_name *out);
    spin_status (*link)(struct spin_device *d, const struct spin_link_name *name, int rank,
                        int n_ranks);
    spin_status (*sum)(struct spin_device *d, const struct spin_device_sum *sum, size_t n,
                       spin_status (*listen)(void));
    /* Bytes that could still be reserved (now). A card's 0: it does not say. */
    size_t (*memory_available)(struct spin_device *d);
    /* Seconds that the verbs of one op (SPIN_OP_...) took since the last call for it. */
    double (*clock)(struct spin_device *d, int op);

    /* ---- Tracks ---- */

    /* means [n][3] =, residual [SPIN_RESIDUAL n] = (each frame's at its first row): own values plus
     * those of the track, where that is at the frame's t and as much of it as is seen then. */
    void (*tracks)(struct spin_device *d, const struct spin_frame_batch *frames,
                   const struct spin_tracks_f32 *tracks, float SPIN_DEV *means,
                   float SPIN_DEV *residual);
    /* d_values += the frames' d_means and, where there is one, d_residual. */
    void (*tracks_back)(struct spin_device *d, const struct spin_frame_batch *frames,
                        const struct spin_tracks_f32 *tracks);

    /* ---- Network ---- */

    /* x_u [n][4] = contract(means), t */
    void (*contract)(struct spin_device *d, const struct spin_scene_transform *transform,
                     const struct spin_frame_batch *frames, float SPIN_DEV *x_u);
    /* d_means += adjoint of d_x_u[.][0..2] */
    void (*contract_back)(struct spin_device *d, const struct spin_scene_transform *transform,
                          const struct spin_frame_batch *frames, const struct spin_active *active,
                          const float SPIN_DEV *d_x_u);

    /* z [n][levels*features] = */
    void (*grid)(struct spin_device *d, const struct spin_grid *grid, const float SPIN_DEV *table,
                 size_t n, const float SPIN_DEV *x_u, float SPIN_DEV *z);
    /* d_table [rows][features] +=, d_x_u [active][4] = (d_x_u[.][3] = 0). d_x_u may be NULL. */
    void (*grid_back)(struct spin_device *d, const struct spin_grid *grid,
                      const float SPIN_DEV *table, const struct spin_active *active,
                      const float SPIN_DEV *x_u, const float SPIN_DEV *d_z, float SPIN_DEV *d_table,
                      float SPIN_DEV *d_x_u);

    /* raw [n][SPIN_ATTR] = heads(z [n][n_in]) */
    void (*mlp)(struct spin_device *d, const struct spin_heads *heads, const float SPIN_DEV *param,
                size_t n, const float SPIN_DEV *z, float SPIN_DEV *raw);
    /* d_param +=, d_z [active][n_in] =; activations are recomputed from z */
    void (*mlp_back)(struct spin_device *d, const struct spin_heads *heads,
                     const float SPIN_DEV *param, const struct spin_active *active,
                     const float SPIN_DEV *z, const float SPIN_DEV *d_raw, float SPIN_DEV *d_param,
                     float SPIN_DEV *d_z);

    /* raw [n][SPIN_ATTR] += explicit values of the splats; the colour is the first coefficient. A
     * frame's residual [SPIN_RESIDUAL n] is four groups: [n][3], [n][4], [n][3], [n]; its sh are
     * the coefficients beyond the first. Frames without are left alone. residual_set: raw =,
     * without a network; coefficients that no sh is for stay as they are. Back: d_residual +=, d_sh
     * += */
    void (*residual)(struct spin_device *d, const struct spin_frame_batch *frames,
                     float SPIN_DEV *raw);
    void (*residual_set)(struct spin_device *d, const struct spin_frame_batch *frames,
                         float SPIN_DEV *raw);
    void (*residual_back)(struct spin_device *d, const struct spin_frame_batch *frames,
                          const struct spin_active *active, const float SPIN_DEV *d_raw);

    /* attr [n][SPIN_ATTR] = finish(raw) */
    void (*activate)(struct spin_device *d, const struct spin_frame_batch *frames,
                     const float SPIN_DEV *raw, float SPIN_DEV *attr);
    /* d_raw [active][SPIN_ATTR] = from d_attr [n][SPIN_ATTR] */
    void (*activate_back)(struct spin_device *d, const struct spin_frame_batch *frames,
                          const struct spin_active *active, const float SPIN_DEV *raw,
                          const float SPIN_DEV *d_attr, float SPIN_DEV *d_raw);

    /* d_attr of active rows += the frame's d_scale (each of the three scales), d_opacity. */
    void (*regularise_back)(struct spin_device *d, const struct spin_frame_batch *frames,
                            const struct spin_active *active, float SPIN_DEV *d_attr);

    /* active = rows whose d_attr or d_means is not all zero (NaN counts). d_means may be NULL. */
    void (*nonzero_grad)(struct spin_device *d, const struct spin_frame_batch *frames,
                         const float SPIN_DEV *d_attr, const struct spin_active *active);

    /* ---- Rasteriser ---- */

    /* splat2d = ; sh_degree 0..3 */
    void (*project)(struct spin_device *d, const struct spin_view_batch *views,
                    const struct spin_frame_batch *frames, const float SPIN_DEV *attr,
                    int sh_degree, struct spin_splat2d SPIN_DEV *splat2d);
    /* d_attr [n][SPIN_ATTR] +=, d_means += */
    void (*project_back)(struct spin_device *d, const struct spin_view_batch *views,
                         const struct spin_frame_batch *frames, const float SPIN_DEV *attr,
                         int sh_degree, const struct spin_splat2d SPIN_DEV *splat2d,
                         const struct spin_splat2d_grad SPIN_DEV *d_splat2d,
                         float SPIN_DEV *d_attr);

    /* What densification goes by: for every splat that a view shows, its frame's gradient += the
     * length of the loss's gradient with respect to its centre in normalised device coordinates,
     * seen += 1. */
    void (*densify_stats)(struct spin_device *d, const struct spin_view_batch *views,
                          const struct spin_frame_batch *frames,
                          const struct spin_splat2d SPIN_DEV *splat2d,
                          const struct spin_splat2d_grad SPIN_DEV *d_splat2d);

    /* Sets first_intersection and tile_cull of every splat, and tiles->n_intersections (now); fails
     * where a view has more than SPIN_MAX_PAIRS. Then, with room for as many in
     * tiles->intersections, fill, which fails without memory. */
    spin_status (*tile_count)(struct spin_device *d, const struct spin_view_batch *views,
                              struct spin_splat2d SPIN_DEV *splat2d, struct spin_tiles *tiles);
    spin_status (*tile_fill)(struct spin_device *d, const struct spin_view_batch *views,
                             const struct spin_splat2d SPIN_DEV *splat2d,
                             const struct spin_tiles *tiles);

    /* image =, final_transmittance [n_views][max_pixels] =, last_contributor (the same) = (one past
     * the last contributor's place in its tile's list) */
    void (*blend)(struct spin_device *d, const struct spin_view_batch *views,
                  const struct spin_splat2d SPIN_DEV *splat2d, const struct spin_tiles *tiles,
                  float SPIN_DEV *image, float SPIN_DEV *final_transmittance,
                  int32_t SPIN_DEV *last_contributor);
    /* depth [n_views][2][max_pixels] =: along the cameras' axes, expected and median, math/blend.h
     */
    void (*depth)(struct spin_device *d, const struct spin_view_batch *views,
                  const struct spin_splat2d SPIN_DEV *splat2d, const struct spin_tiles *tiles,
                  float SPIN_DEV *depth);
    /* d_splat2d = */
    void (*blend_back)(struct spin_device *d, const struct spin_view_batch *views,
                       const struct spin_splat2d SPIN_DEV *splat2d, const struct spin_tiles *tiles,
                       const float SPIN_DEV *final_transmittance,
                       const int32_t SPIN_DEV *last_contributor, const float SPIN_DEV *d_image,
                       struct spin_splat2d_grad SPIN_DEV *d_splat2d);

    /* loss = (1 - lambda) L1 + lambda (1 - SSIM); d_image = weight * its gradient (NULL: none). L1
     * and SSIM are means over the pixels, each counted as often as the image's mask says (at least
     * 0, not all 0). values [view.value][SPIN_LOSS_VALUES] =, not times weight. */
    void (*loss)(struct spin_device *d, const struct spin_view_batch *views,
                 const struct spin_images *images, float lambda_dssim, const float SPIN_DEV *image,
                 double SPIN_DEV *values, float SPIN_DEV *d_image);
    /* values [view.value][SPIN_MEASURE_VALUES] = how far image is from the photograph; image is
     * clamped to 0..1 in place first. The mask weighs nothing here, it tells two regions apart. */
    void (*measure)(struct spin_device *d, const struct spin_view_batch *views,
                    const struct spin_images *images, float SPIN_DEV *image,
                    double SPIN_DEV *values);

    /* Cameras' looks, math/exposure.h, rows of SPIN_EXPOSURE floats: of a camera log gain r g b,
     * offset r g b; of a lens c1 r g b, c2 r g b. out may be image. Back: d_image changes in place,
     * d_exposure += */
    void (*exposure)(struct spin_device *d, const struct spin_view_batch *views,
                     const float SPIN_DEV *exposure, const float SPIN_DEV *image,
                     float SPIN_DEV *out);
    void (*exposure_back)(struct spin_device *d, const struct spin_view_batch *views,
                          const float SPIN_DEV *exposure, const float SPIN_DEV *image,
                          float SPIN_DEV *d_image, float SPIN_DEV *d_exposure);
    /* Subtract the mean of the first n rows from each. */
    void (*exposure_centre)(struct spin_device *d, size_t n, float SPIN_DEV *exposure);

    /* ---- Steps ---- */

    /* One step of Adam for all groups, math/adam.h: p -= ...; m, v updated; g is left zeroed. */
    void (*adam)(struct spin_device *d, int n_groups, const struct spin_param_group *group);
    /* *count += how many of the n values are NaN or infinite. */
    void (*not_finite)(struct spin_device *d, size_t n, const float SPIN_DEV *values,
                       uint32_t SPIN_DEV *count);

    /* The same for a table of which a step touches little; all NULL on a device that has not got
     * it. enable: of the group's arrays, for this many steps at most (now). grid: as grid(), after
     * the lines that these points need were brought to step done, and marked. step: with rate lr,
     * of the marked lines and of all levels before them. advance: a step was taken before the run
     * was resumed; only its rate is noted. flush: out [n] = p as after step done if every line had
     * taken every step. */
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
/* The verbs behind clock, in this order: every device declares and lists its own by these names. */
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

enum { SPIN_EXPOSURE = 6 }; /* floats of a row of exposures */

struct spin_device {
    const struct spin_device_ops *op;
    const char *path;     /* code path: "base", "v3", "v4"; results differ in the last bits */
    void *state;          /* the device's own */
    char description[64]; /* "cpu (avx-512, 2 threads)" */
    char card[40];        /* of a card: a number that no other card in the world has */
    int frames_at_once, views_at_once; /* that its caches and memory like best in one call */
    bool is_host;       /* its memory is the host's: what the plan needs is one sum */
    bool deterministic; /* the caller's wish, any time: sums in one order, or in whole numbers, so
                         * that the same calls give the same bits. The CPU does always. */
};

/* name: "auto" (cuda when there is one), "cpu", "cuda". The environment variable SPIN_CPU = base,
 * v3 or v4 picks the CPU's code path. */
spin_status spin_device_open(const char *name, int n_threads, struct spin_device *out);
void spin_device_close(struct spin_device *d);

/* A device that only counts: what is reserved on it has no memory, and no verb may be called, but
 * zero(), upload() and release() do nothing. So what a plan needs is what opening it reserves. */
struct spin_counting_device {
    struct spin_device device;
    struct spin_device_ops op;
    size_t bytes; /* reserved so far */
};
/* With frames and views at once, and what there is of lazy Adam, as the other. It needs no closing.
 */
void spin_device_count(struct spin_counting_device *c, const struct spin_device *as);
