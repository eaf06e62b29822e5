/* spin.h - the public header of spin4d, and a map of its source. spin_run.h declares the calls
 * behind the commands.
 *
 *     the commands  ->  one library  <-  importers and exporters, one file each
 *
 *   src/base      errors, memory, log and progress, threads, text; nothing about splats
 *   src/io        files, archives, npy, checkpoints, JSON and images, to and from arrays
 *   src/formats   splat formats of other programs: 3DGS PLY, compressed PLY, SPZ, SOG, .splat,
 *                 .ksplat, .splat4d, .4dgs, GLB
 *   src/scene     splats of a frame, data sets, clips, the *.spin bundle, plug-ins
 *   src/math      every formula once, with its derivative; headers that C and CUDA share
 *   src/device    the operations of the method, and the devices that run them
 *   src/model     the field (a network): layout, initial values, forward and backward passes
 *   src/render    views through the rasteriser; images of a bundle's frames
 *   src/train     the stages of a training: plan, frames, loop, output
 *   src/eval      metrics, dynamic regions, LPIPS, the report
 *   src/run       the calls of spin_run.h: import, retrain, evaluate, export, convert
 *   src/cmd       the commands: parse options, call the library, print
 *   importers     readers of foreign files: one plug-in per file, listed in importers.c
 *   exporters     writers of standard files: one plug-in per file, listed in exporters.c
 *                 (others can be loaded at run time: part 4 below and spin-plugin(7))
 *
 * docs/architecture.md follows a mean from import to export.
 *
 * Conventions: quaternions are w, x, y, z. Matrices are row-major. Cameras look along +z, with x
 * right and y down; w2c maps world to camera; the centre of the top-left pixel is (0.5, 0.5).
 * Images are planar [3][h][w] float, 0..1. Names of counts begin with n_; an index is a singular
 * noun, such as frame. An option field is 0 by default unless its comment says otherwise.
 *
 * Example: print the size of the first frame of a bundle.
 *
 *     struct spin_scene *scene = NULL;
 *     struct spin_splats splats = {0};
 *     if (spin_scene_open("ball.spin", &scene) != SPIN_OK ||
 *         spin_scene_read(scene, 0, SPIN_FROM_BEST, SPIN_COL_MEANS, &splats) != SPIN_OK) {
 *         fprintf(stderr, "%s\n", spin_last_error());
 *         return 1;
 *     }
 *     printf("%zu splats\n", splats.n);
 *     spin_splats_free(&splats);
 *     spin_scene_close(scene);
 */
#ifndef SPIN_H
#define SPIN_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>

#ifdef __cplusplus
extern "C" {
#endif

#if defined(__GNUC__)
#define SPIN_PRINTF(fmt, args) __attribute__((format(printf, fmt, args)))
#define SPIN_VISIBLE __attribute__((visibility("default")))
#else
#define SPIN_PRINTF(fmt, args)
#define SPIN_VISIBLE
#endif

#define SPIN_VERSION "0.1.0"

/* ---- 1. Status ------------------------------------------------------------------------------ */

/* Kinds of failure, by what a caller can do about them. A function that can fail returns one of
 * these and leaves a one-line error message, outermost context first, for spin_last_error(). */
typedef enum spin_status {
    SPIN_OK = 0,
    SPIN_E_USAGE,          /* invalid request: exit code 2 */
    SPIN_E_NOT_FOUND,      /* no such file, frame or name */
    SPIN_E_NOT_RECOGNISED, /* no importer recognises this input */
    SPIN_E_MALFORMED,      /* the file is corrupt or truncated */
    SPIN_E_UNSUPPORTED,    /* valid, but not supported by spin4d */
    SPIN_E_IO,             /* the file system or the operating system failed */
    SPIN_E_MEMORY,         /* out of memory */
    SPIN_E_DEVICE,         /* the accelerator failed */
    SPIN_E_CANCELLED       /* spin_cancel() was called: exit code 130 or 143 */
} spin_status;

/* The error message of this thread's last failure: one line without a full stop; "" if none. */
const char *spin_last_error(void);

/* Sets this thread's error message and returns `code`. The text is in lower case without a full
 * stop: what failed, where (file, array, line), why; names in 'quotes'. */
spin_status spin_fail(spin_status code, const char *fmt, ...) SPIN_PRINTF(2, 3);
/* Shorthands for the most frequent codes. */
#define spin_misuse(...) spin_fail(SPIN_E_USAGE, __VA_ARGS__)
#define spin_not_found(...) spin_fail(SPIN_E_NOT_FOUND, __VA_ARGS__)
#define spin_malformed(...) spin_fail(SPIN_E_MALFORMED, __VA_ARGS__)
#define spin_unsupported(...) spin_fail(SPIN_E_UNSUPPORTED, __VA_ARGS__)

/* Prefixes the error message with the formatted text and a colon, and returns `code`. If `code` is
 * SPIN_OK or SPIN_E_CANCELLED, the message stays unchanged. */
spin_status spin_fail_context(spin_status code, const char *fmt, ...) SPIN_PRINTF(2, 3);

/* Evaluates expr and, if it fails, returns its status from the calling function. */
#define SPIN_TRY(expr)                                                                             \
    do {                                                                                           \
        spin_status spin_try_ = (expr);                                                            \
        if (spin_try_ != SPIN_OK)                                                                  \
            return spin_try_;                                                                      \
    } while (0)

/* SPIN_TRY, with a prefix for the error message, see spin_fail_context(). */
#define SPIN_TRY_IN(expr, ...)                                                                     \
    do {                                                                                           \
        spin_status spin_try_ = (expr);                                                            \
        if (spin_try_ != SPIN_OK)                                                                  \
            return spin_fail_context(spin_try_, __VA_ARGS__);                                      \
    } while (0)

/* Assigns expr to the local variable `status` and, if it failed, jumps to the label `out`. */
#define SPIN_TRY_OUT(expr)                                                                         \
    do {                                                                                           \
        status = (expr);                                                                           \
        if (status != SPIN_OK)                                                                     \
            goto out;                                                                              \
    } while (0)

/* Prints "warning: ..." as one line on stderr. */
void spin_warn(const char *fmt, ...) SPIN_PRINTF(1, 2);

/* Verbosity of the library on stderr: -1 warnings only, 0 normal, 1 log lines per run, 2 per frame,
 * 3 per iteration, 4 per operation. */
void spin_set_verbosity(int level);

/* Makes running work stop at the next safe point. Async-signal-safe. */
void spin_cancel(void);

/* ---- 2. Splats of one frame ------------------------------------------------------------------ */

enum spin_column {
    SPIN_COL_MEANS = 1 << 0,           /* [n][3] centres, world units */
    SPIN_COL_QUATS = 1 << 1,           /* [n][4] w, x, y, z, unit length */
    SPIN_COL_LOG_SCALES = 1 << 2,      /* [n][3] natural log of the standard deviation */
    SPIN_COL_LOGIT_OPACITIES = 1 << 3, /* [n] before the sigmoid, finite */
    SPIN_COL_SH = 1 << 4,              /* [n][(sh_degree+1)^2][3] coefficients, channel last */
    SPIN_COL_RGB = 1 << 5,             /* [n][3] 0..1, colours of points without SH */
    SPIN_COL_ATTRIBUTES =              /* all columns of a Gaussian except its mean */
    SPIN_COL_QUATS | SPIN_COL_LOG_SCALES | SPIN_COL_LOGIT_OPACITIES | SPIN_COL_SH
};

/* A structure of arrays: each column is NULL or has n rows. The struct owns its memory. The caller
 * zeroes it first, calls spin_splats_reserve() as often as needed, and frees it at the end, also
 * after a failure. */
struct spin_splats {
    size_t n;               /* rows */
    size_t capacity;        /* rows that each allocated column can hold */
    int sh_degree;          /* degree of sh, 0..3 */
    bool antialias;         /* the splats are to be rendered with antialiasing */
    float *means;           /* [n][3] */
    float *quats;           /* [n][4] or NULL */
    float *log_scales;      /* [n][3] or NULL */
    float *logit_opacities; /* [n] or NULL */
    float *sh;              /* [n][(sh_degree+1)^2][3] or NULL */
    float *rgb;             /* [n][3] or NULL */
    bool mapped;            /* columns point into a mapped file: read-only, not owned */
    size_t held[6];         /* private: allocated bytes of each column */
};

/* Sets n and sh_degree, clears antialias, and allocates the requested columns for at least n rows.
 * Other columns that are already allocated grow to n rows too. Contents are not preserved. Fails
 * with SPIN_E_MEMORY, or SPIN_E_UNSUPPORTED if SH is requested with a degree outside 0..3. */
spin_status spin_splats_reserve(struct spin_splats *s, size_t n, unsigned columns, int sh_degree);
void spin_splats_free(struct spin_splats *s);
/* Copies the rows i of s with mark[i] not 0 to *out, with all columns except rgb. */
spin_status spin_splats_select(const struct spin_splats *s, const unsigned char *mark,
                               struct spin_splats *out);

/* 4D splats: each has a path and a window in time instead of a row in every frame. At time t, with
 * d = t - times[i], row i is a splat with
 *
 *     mean       centres + paths[0] d + paths[1] d^2 + paths[2] d^3
 *     rotation   quats + d spins, normalised
 *     scale      log_scales
 *     opacity    sigmoid(logit_opacities) w(t)
 *     colour     sh + cos(2 pi d / period) sh_cos[0] + cos(4 pi d / period) sh_cos[1]
 *
 * where w(t) = exp(-0.5 (d / sigmas)^2) is a Gaussian window. Terms of arrays that are NULL are
 * omitted. Three optional arrays change the window of a row, in this order:
 *
 *     If there are plateaus (lo, hi, sigma2), w is 1 from lo to hi. Before lo it falls like a
 *     Gaussian of standard deviation sigmas, after hi like one of sigma2.
 *     If there are gates (g), g + (1 - g) w replaces w.
 *     If there are cuts (first, end), w is 0 outside [first, end).
 *
 * All times are in the unit of the clip's frame times (struct spin_frame_info). A frame is a slice
 * of the 4D splats: the rows that are drawn at its time, in order.
 *
 * The struct owns its memory: zero it, call spin_splats_4d_reserve() once, fill the arrays, call
 * spin_splats_4d_finish(), and free it with spin_splats_4d_free(). */
struct spin_splats_4d {
    size_t n;
    int degree;           /* degree of the paths, which are polynomials: 0..3 */
    int sh_degree;        /* 0..3 */
    bool antialias;       /* the splats are to be rendered with antialiasing */
    double least_weight;  /* a row is not drawn at times at which its w is below this */
    double least_opacity; /* a row is not drawn at times at which its opacity is below this */
    double period;        /* period of the cosines of sh_cos */
    /* The training multiplied the screen-space covariance by these factors; 0: it did not. */
    double cov2d[2];
    float *centres;         /* [n][3] world units */
    float *times;           /* [n] */
    float *quats;           /* [n][4] w, x, y, z */
    float *log_scales;      /* [n][3] */
    float *logit_opacities; /* [n] */
    float *sigmas;          /* [n] standard deviation of w, above 0; SPIN_FOREVER: w is constant */
    float *sh;              /* [n][(sh_degree+1)^2][3] */
    float *paths;           /* [n][degree][3], or NULL if degree is 0 */
    float *spins;           /* [n][4] or NULL */
    float *plateaus;        /* [n][3] lo, hi, sigma2, or NULL */
    float *cuts;            /* [n][2] first, end, or NULL */
    float *gates;           /* [n] 0..1, or NULL */
    float *sh_cos;          /* [n][2][(sh_degree+1)^2][3] or NULL */
    double *spans;          /* private: [n][2] first and last time at which a row is drawn */
};
#define SPIN_FOREVER 3e38f

/* Optional arrays. The paths have no flag: they are allocated if degree is above 0. */
enum spin_splats_4d_part {
    SPIN_4D_SPINS = 1 << 0,
    SPIN_4D_PLATEAUS = 1 << 1,
    SPIN_4D_CUTS = 1 << 2,
    SPIN_4D_GATES = 1 << 3,
    SPIN_4D_SH_COS = 1 << 4
};
/* Sets n and the degrees, and allocates the arrays, filled with zeros: those that are always
 * present, the paths if degree is above 0, and the optional arrays of `parts`. */
spin_status spin_splats_4d_reserve(struct spin_splats_4d *s, size_t n, int degree, int sh_degree,
                                   unsigned parts);
void spin_splats_4d_free(struct spin_splats_4d *s);
/* The 4D splats as the splats of one frame, each at its centre with its full opacity. The result
 * borrows the arrays: do not free it. */
struct spin_splats spin_splats_of_4d(const struct spin_splats_4d *s);
/* Validates the rows; call it once all are filled. Drops rows with values that are not finite or
 * far out of range, with a rotation of length 0, or with a sigma that is not above 0. Keeps the
 * order of the others and normalises their quats. from: NULL, or [n], which receives the original
 * index of each remaining row. */
spin_status spin_splats_4d_finish(struct spin_splats_4d *s, size_t *n_dropped, size_t *from);
/* Fill the columns with the rows that are drawn at `time`. */
spin_status spin_splats_4d_slice(const struct spin_splats_4d *s, double time, unsigned columns,
                                 struct spin_splats *out);
/* Whether row i is drawn at `time`. */
bool spin_splats_4d_is_visible(const struct spin_splats_4d *s, size_t i, double time);
/* The window w(time) of row i. */
double spin_splats_4d_weight(const struct spin_splats_4d *s, size_t i, double time);
/* Counts the rows that are drawn at each of n times. */
spin_status spin_splats_4d_counts(const struct spin_splats_4d *s, const double *times, size_t n,
                                  size_t *counts);

/* ---- 3. Cameras and views -------------------------------------------------------------------- */

/* Depth of the near plane in 3DGS, world units. */
#define SPIN_NEAR 0.2

struct spin_camera {
    int width, height;     /* pixels */
    double fx, fy, cx, cy; /* pixels; centre of the top-left pixel is 0.5, 0.5 */
    double w2c[12];        /* [3][4], R | t: p_c = R p_w + t; R orthonormal, det +1 */
    double z_near;         /* splats at or in front of this depth are not drawn; 0: SPIN_NEAR */
};

/* One image of a data set. */
struct spin_view {
    struct spin_camera camera;
    int dataset_frame; /* index of the frame in the data set, from 0 */
    int number;        /* frame number from the file name, or -1 */
    double time;       /* in the data set's unit (panoptic: equals dataset_frame) */
    int camera_id;     /* the data set's number of the camera */
    bool test;         /* true: the view is held out from trainings, for measuring */
    char *path;        /* image file, absolute or relative to the working directory */
    char *mask;        /* image that is 0 outside the foreground; NULL: none */
};

/* All views of a data set, sorted by dataset_frame, then camera_id. */
struct spin_views {
    struct spin_view *view; /* [n] */
    size_t n, capacity;
    int n_dataset_frames;
    bool numbered;   /* every view has a frame number, which all views of a frame share */
    char notes[512]; /* for the user: one line for each assumption or loss; "" if none */
};

/* Appends a copy of v, with copies of path and mask. */
spin_status spin_views_add(struct spin_views *views, const struct spin_view *v);
void spin_views_free(struct spin_views *views);

/* ---- 4. Plug-ins ----------------------------------------------------------------------------- */

/* A plug-in may call the functions of parts 1 to 4 and of part 6; src/plugin.sym lists them. */

#define SPIN_PLUGIN_ABI 8

/* A sound track: a file in memory, which is stored and passed on without being decoded. */
struct spin_sound {
    char name[64];             /* name for users, without folder and extension */
    const char *type;          /* "wav", "opus", "vorbis", "m4a", "aac", "mp3" or "flac"; static */
    const unsigned char *data; /* NULL: there is no sound */
    size_t size;               /* bytes */
    /* Time of the clip, in seconds, at which the sound begins. If it is below 0, the sound is
     * played from its second -start on. */
    double start;
    double gain; /* factor of the amplitude, 0 or more */
};

/* One row of a plug-in's own options: `--key value`. The table ends with key == NULL. */
struct spin_plugin_option {
    const char *key; /* without the leading dashes */
    const char *arg; /* placeholder of the value in --help, NULL for a switch */
    const char *help;
    const char *fallback; /* default value, or NULL */
};

/* Values given by the user: NULL-terminated pairs of key and value; may be NULL. */
struct spin_plugin_values {
    const char *const *pairs;
};
/* The value of key, or fallback if it was not given. */
const char *spin_plugin_value(const struct spin_plugin_values *v, const char *key,
                              const char *fallback);

/* What probe() may examine of an input. */
struct spin_peek {
    const char *path;
    bool is_folder;
    /* The first 16384 bytes, or fewer if the file is shorter. For a folder, they are those of the
     * first of these files that exists: cfg_args, chkpnt*, deformation.pth, point_cloud.ply,
     * ckpts/ckpt_*.pt, ckpt_*.pt. */
    const unsigned char *head;
    size_t n_head;
    /* Member names, one per line, of a zip archive or of the params.npz of a folder; else "". */
    const char *tail_names;
    const char *const *names; /* folders: entries, sorted, at most 4096; NULL-terminated */
};

/* Filled by an importer's open(). Pointers belong to the importer until close(). */
struct spin_sequence_info {
    int n_frames;
    const double *times;     /* [n_frames] in the method's unit of time; NULL: 0, 1, 2, ... */
    const int *numbers;      /* [n_frames] frame numbers from file names; NULL: none */
    const size_t *counts;    /* [n_frames] rows of each frame; NULL: unknown until read */
    unsigned columns;        /* columns that frame() can fill */
    unsigned static_columns; /* the subset of `columns` that is equal in all frames */
    bool identity;           /* row i is the same Gaussian in every frame */
    int sh_degree;           /* -1: no SH */
    bool antialias;          /* the splats were trained with antialiasing */
    bool continuous;         /* can be sampled at any time in [time_first, time_last] */
    double time_first, time_last;
    int n_clip_frames; /* frames of the clip of a continuous method; 0: unknown */
    double fps;        /* frames per second of the clip; 0: unknown */
    /* For data sets without times: frame i of n is at i/n of the time span, not at i/(n-1). */
    bool half_open;
    /* The method's times are frame numbers: frame i of a data set is at time i, even if the data
     * set has other times. */
    bool counts_frames;
    char variant[128]; /* variant of the format, for --info */
    char notes[1024];  /* for the user: one line for each assumption or loss; "" if none */
    /* Coordinates that frame() has subtracted from all positions, which are too far from 0 for
     * floats; 0 for most runs. */
    double shift[3];
    /* The sound track, which starts relative to the source's first frame; NULL: none. */
    const struct spin_sound *sound;
};

struct spin_importer {
    int abi;              /* SPIN_PLUGIN_ABI */
    const char *name;     /* argument of --from */
    const char *summary;  /* one line for --list */
    const char *upstream; /* project and commit whose files the importer was written for */
    const struct spin_plugin_option *options;

    /* Confidence, 0..100, that this importer reads the input. Must not open files or allocate. */
    int (*probe)(const struct spin_peek *peek);

    /* Reading splats. open() reads only what is quick to read, and is NULL if the importer reads
     * data sets only. frame() calls spin_splats_reserve() and fills the requested columns of one
     * frame; `time` is for continuous methods only. The frames are requested in any order and
     * repeatedly, by one thread at a time. close() is also called after a failed open() that set
     * *self. */
    spin_status (*open)(const char *path, const struct spin_plugin_values *values, void **self,
                        struct spin_sequence_info *sequence);
    spin_status (*frame)(void *self, int frame, double time, unsigned columns,
                         struct spin_splats *out);
    void (*close)(void *self);

    /* The same input as 4D splats, after spin_splats_4d_finish(). The importer owns them until
     * close(). *out is NULL if this input contains none. NULL: the method never stores any. */
    spin_status (*splats_4d)(void *self, const struct spin_splats_4d **out);

    /* Append every view of the data set in folder `path`. NULL: the importer reads no data sets. */
    spin_status (*views)(const char *path, const struct spin_plugin_values *values,
                         struct spin_views *out);
};

struct spin_renderer;

/* Result of --check over all frames: differences between the files as read back and the bundle. */
struct spin_export_check {
    int frames; /* frames read back; 0: not checked */
    uint64_t splats;
    double bounds; /* largest difference of a side of a frame's bounding box, world units */
    double rms[6], largest[6]; /* mean, log scale, rotation (degrees), opacity, colour, SH */
    uint64_t sh_lost;          /* splats with an SH degree that the format cannot store */
    /* Largest displacement of a mean, in units of the splat's largest standard deviation; NaN:
     * unknown. */
    double place_sizes;
    /* Largest displacement of a mean, in pixels of the data set's images; NaN: unknown, or no splat
     * is visible to any camera. */
    double place_pixels;
    int rendered; /* number of the frame that was rendered from its file; -1: none */
    double psnr;  /* dB against the render of the bundle; infinite: identical; NaN: none */
};

/* Result of --decimate: the splats that were dropped, and the loss in quality. */
struct spin_decimated {
    /* Splats per frame on average, or splats of the clip if in_all is set. `before` excludes splats
     * that other options drop, and is 0 without --decimate. */
    double before, after;
    /* before and after count the splats of the clip, since these are 4D splats or filters drop
     * some of them in some frames only. */
    bool in_all;
    /* The splats were ranked by their contribution to the data set's views; otherwise by opacity
     * and size. */
    bool by_views;
    int n_pictures; /* images that were compared; 0: no splat is visible in any */
    double psnr;    /* dB over all compared images, kept splats against all; infinite: identical */
    int n_tries;    /* outputs written to reach a size; 0: no size was requested */
    uint64_t reached; /* bytes of the whole output, if a size was requested */
};

/* Why spin-export leaves out a splat. If several reasons apply, the first counts. */
enum spin_row_reason {
    SPIN_ROW_KEPT,
    /* The next four are options of spin-export. They keep a splat with a NaN or infinite
     * position. */
    SPIN_ROW_CROP,
    SPIN_ROW_MIN_VIEWS,
    SPIN_ROW_FLOATERS,
    SPIN_ROW_BACKDROP, /* --backdrop off */
    /* No viewer can draw the splat. */
    SPIN_ROW_NOT_FINITE,
    SPIN_ROW_NO_ROTATION, /* of length zero */
    SPIN_ROW_TOO_LARGE,   /* --max-scale */
    /* Options of spin-export. */
    SPIN_ROW_MIN_OPACITY,
    SPIN_ROW_DECIMATE,
    SPIN_ROW_REASONS
};

struct spin_export_report {
    int frames;
    double splats_mean;
    uint64_t bytes; /* 0: unknown */
    /* Splats left out, summed over all frames, or 4D splats: by reason, those that no viewer can
     * draw, and those that options other than --decimate and --max-scale drop. Exporters do not set
     * these. */
    uint64_t dropped[SPIN_ROW_REASONS];
    uint64_t left_out, filtered;
    /* Some frames keep different rows than the first frame. Not set by exporters. */
    bool rows_differ;
    struct spin_export_check check;
    struct spin_decimated decimated;
    uint64_t images; /* images rendered and written, by exporters that render; else 0 */
};

/* What an exporter receives before the first frame. All pointers are borrowed until end() or
 * abort(). */
struct spin_export_job {
    const char *output; /* as given by the user */
    bool force;         /* overwrite existing files */
    bool sync;          /* the value of `sync` for every struct spin_out */
    int n_frames;       /* frames to export */
    double fps;         /* 0: unknown */
    const char *source; /* name of the method that the clip was imported from */
    int sh_degree;      /* SH degree of the exported splats */
    bool antialias;     /* the splats are to be rendered with antialiasing */
    const struct spin_plugin_values *values;
    const struct spin_views *views; /* NULL if the data set is not available */
    const int *dataset_frame_of;    /* [n_frames] index of each frame in the data set, or -1 */
    struct spin_renderer *renderer; /* not NULL if the exporter sets needs_renderer */
    const float *background;        /* [3] */
    /* --background none: render images with alpha. Only set for exporters with `alpha`. */
    bool transparent;
    int n_threads; /* 0: all */
    /* Reads the source of a frame, for comparisons with the retrained splats. NULL unless the
     * bundle contains both. */
    spin_status (*source_frame)(void *source_of, int frame, struct spin_splats *out);
    void *source_of;
    int source_sh_degree;
    bool source_antialias;
    bool retrained; /* the attributes were retrained, not imported */
    /* [n_frames] number of splats of each frame, which may include splats that cannot be drawn;
     * NULL: unknown */
    const size_t *counts;
    bool counts_are_bounds; /* true: `counts` are upper bounds, since options drop further splats */
    /* The exporter increases `bytes` and `images` of the report, and sets `frames` if it exports
     * only some of them. left_out and rows_differ are final at end(). May be NULL. */
    struct spin_export_report *report;

    /* end() is to read back its files and to fill report->check. Only set for exporters with
     * `checks`. */
    bool check;
    /* Returns a frame, 0..n_frames-1, for checks and for exporters that need all frames in begin().
     * The splats stay valid until the next call of again() or frame(). */
    spin_status (*again)(void *context, int frame, const struct spin_splats **out);
    void *context;

    const double *times; /* [n_frames] time of each frame, in the source's unit */
    /* The clip as 4D splats, in the time unit of `times`, for exporters with splats_4d; NULL: the
     * clip consists of frames. */
    const struct spin_splats_4d *splats_4d;
    double stride; /* mean difference of consecutive frame numbers; 0 means 1 */

    /* The pairing of frames with the data set, for programs that import the output again. */
    const int *source_index; /* [n_frames] index of each frame in the source clip; NULL: unknown */
    int n_source_frames;     /* frames of the source clip */
    bool numbered;           /* frame numbers come from the source */
    const char *pair;        /* value of spin-import --pair; "" or NULL: not given */
    /* The data set's absolute folder, and the importer that reads it; NULL: none. */
    const char *data;
    const char *data_from;
    bool identity; /* row i is the same splat in every frame, unless rows_differ at end() */

    const int *numbers; /* [n_frames] number of each frame, see struct spin_frame_info */
    /* The sound track, which starts relative to the first exported frame; NULL: none. Only set for
     * exporters with `sound`, and together with `fps`. */
    const struct spin_sound *sound;
};

struct spin_frame_info {
    int number;  /* frame number in the source, or the index if the source has no numbers */
    double time; /* time of the frame, in the source's unit */
    size_t n;    /* number of splats, if known */
};

struct spin_exporter {
    int abi;
    const char *name, *summary;
    const struct spin_plugin_option *options;
    unsigned wants; /* required columns */
    bool checks;    /* the exporter supports job->check */
    /* Antialiasing is not lost: the output records whether its splats are to be rendered with
     * antialiasing, or consists of images, which are rendered that way. */
    bool antialias;
    /* The exporter accepts clips of 4D splats, in job->splats_4d; frame() is not called then. If
     * `frame` is NULL, it accepts only such clips. */
    bool splats_4d;
    bool needs_renderer; /* the exporter uses job->renderer */
    bool alpha;          /* the exporter supports job->transparent */
    bool looks_at_views; /* the exporter uses job->views; else the data set is not opened */
    /* Formats of sound that the exporter supports in job->sound, as in struct spin_sound: "wav
     * opus", or "all"; NULL: none. */
    const char *sound;

    /* Exactly one of end() and abort() follows a successful begin(). Files appear under their final
     * name only when complete. */
    spin_status (*begin)(const struct spin_export_job *job, void **self);
    spin_status (*frame)(void *self, int frame, const struct spin_frame_info *info,
                         const struct spin_splats *splats);
    spin_status (*end)(void *self);
    void (*abort)(void *self);
};

/* An output file that appears under its name only when complete. It is written in the same folder
 * under a unique name, path.tmp.*, which spin_out_commit() changes to `path` if all writes and the
 * close succeeded. Write with spin_out_write() or with stdio on `file`; spin_out_commit() detects
 * the errors of either. Exactly one of spin_out_commit() and spin_out_abandon() must follow, and
 * frees the struct.
 *
 * Set `sync` after opening if the output would take long to produce again: spin_out_commit() then
 * flushes the file to the disk (fsync) before renaming it. Without `sync`, a kill or a full disk
 * never leaves a partial file under the final name, but a power failure may. */
struct spin_out {
    FILE *file;
    char *path, *temporary;
    uint64_t bytes; /* written by spin_out_write() */
    bool sync;
    bool force; /* as passed to spin_out_open() */
};
/* Without force, fails with SPIN_E_IO if path exists ("... exists; use --force to overwrite"), even
 * as a dangling link, and spin_out_commit() does not replace a file that another process has
 * created in the meantime. Inputs are never replaced, not even with force. */
spin_status spin_out_open(const char *path, bool force, struct spin_out *out);
spin_status spin_out_write(struct spin_out *out, const void *data, size_t bytes);
spin_status spin_out_commit(struct spin_out *out);
void spin_out_abandon(struct spin_out *out);

/* Creates a folder and its missing parents, like mkdir -p. */
spin_status spin_folder_make(const char *path);

/* The object that a shared library built outside this tree defines as spin_plugin; spin-plugin(7)
 * is the guide. abi stays the first member in all versions. */
struct spin_plugin {
    int abi;                                      /* SPIN_PLUGIN_ABI */
    const struct spin_importer *const *importers; /* NULL-terminated; or NULL */
    const struct spin_exporter *const *exporters; /* NULL-terminated; or NULL */
};
extern SPIN_VISIBLE const struct spin_plugin spin_plugin;

/* The built-in importers and exporters, NULL-terminated, in alphabetical order. */
extern const struct spin_importer *const spin_importers[];
extern const struct spin_exporter *const spin_exporters[];

/* Loads the plug-ins of SPIN_PLUGIN_PATH, a list of shared objects and folders separated by colons.
 * No other place is searched. Only the first call of any of these three functions loads plug-ins.
 * Those that fail to load are skipped with a warning, except the one named `chosen`, whose error
 * the caller reports; NULL: warn about all. */
void spin_plugins_load(const char *chosen);
/* All importers and exporters, the built-in ones first, NULL-terminated. */
const struct spin_importer *const *spin_importer_list(void);
const struct spin_exporter *const *spin_exporter_list(void);

/* The shared object that defines this importer or exporter; NULL: it is built in. */
const char *spin_plugin_origin(const void *plugin);
/* The reason why the plug-in of this name, or the object name.so, failed to load; NULL if there was
 * no failure. */
const char *spin_plugin_fault(const char *name);

/* ---- 5. A clip: the *.spin bundle ------------------------------------------------------------ */

struct spin_scene;

enum spin_splat_source { SPIN_FROM_BEST, SPIN_FROM_SOURCE, SPIN_FROM_TRAINED, SPIN_FROM_REFINED };

spin_status spin_scene_open(const char *path, struct spin_scene **out);
void spin_scene_close(struct spin_scene *scene);
int spin_scene_n_frames(const struct spin_scene *scene);
const struct spin_frame_info *spin_scene_frame(const struct spin_scene *scene, int frame);
bool spin_scene_is_trained(const struct spin_scene *scene);
unsigned spin_scene_columns(const struct spin_scene *scene); /* columns of the source */
/* Fills the columns of a frame. BEST: from the retrained splats if there are any, else from the
 * refined splats if they have all attributes, else from the source. The three may differ in their
 * number of splats. SPIN_E_NOT_FOUND if the columns do not exist (positions only: run
 * spin-retrain). */
spin_status spin_scene_read(struct spin_scene *scene, int frame, enum spin_splat_source from,
                            unsigned columns, struct spin_splats *out);

/* ---- 6. Rendering ---------------------------------------------------------------------------- */

/* Renders one view of splats that have all attribute columns. image: [3][h][w]. */
spin_status spin_render(struct spin_renderer *r, const struct spin_splats *splats,
                        const struct spin_camera *camera, const float background[3], float *image);

/* Layers of the last rendered image; alpha and depth may be NULL. alpha: [h][w], 0..1, 1 minus the
 * transmittance of all splats. depth: [2][h][w], along the camera's axis in world units: the
 * expected depth (mean weighted by contribution), and the median depth, at which the transmittance
 * falls to a half. A depth of 0 means none. */
spin_status spin_render_layers(struct spin_renderer *r, float *alpha, float *depth);

/* For exporters that render. Loads an image into out, planar [3][h][w] float 0..1. If its size
 * differs from width x height, a box filter resizes it. Transparent pixels are blended over the
 * background; NULL: black. */
spin_status spin_image_load(const char *path, int width, int height, const float background[3],
                            float *out);
/* Saves an image as PNG. sync: see struct spin_out. */
spin_status spin_image_save(const char *path, int width, int height, const float *image, bool sync);

/* ---- 7. Calls and programs ------------------------------------------------------------------- */

/* Half-open range of frame numbers, --range A:B:STEP; {0} means all frames. */
struct spin_range {
    bool given;
    int first, last, step;
};

/* OUTER: test views whose camera is outside the cone that the training cameras span around the
 * subject, by more than 3 degrees. They show how well a clip extrapolates. */
enum spin_split { SPIN_SPLIT_TEST, SPIN_SPLIT_TRAIN, SPIN_SPLIT_ALL, SPIN_SPLIT_OUTER };

/* How an evaluation of dynamic regions selects dynamic pixels. */
enum spin_dynamic_from {
    SPIN_DYNAMIC_AUTO,   /* masks if every view has one, else images */
    SPIN_DYNAMIC_MASKS,  /* the data set's foreground masks */
    SPIN_DYNAMIC_IMAGES, /* pixels that differ from the median of their camera's images over time */
    SPIN_DYNAMIC_OFF
};

/* For programs: handle SIGBUS, which is raised by reading from a mapped file that another process
 * truncated. The handler prints one line that begins with `command` and names the file, removes
 * partial output, and ends the process with exit code 1. Without this call the signal ends the
 * process. */
void spin_catch_cut_files(const char *command);

/* The next four functions are for programs that MPI's mpirun starts as several processes, which
 * share the work of one call of spin_run.h; rank 0 returns the report. A process started without
 * mpirun is rank 0 of 1 and does not load MPI. */

/* The rank of this process, from its environment; -1: not started by mpirun. May be called before
 * spin_ranks_begin(). */
int spin_ranks_env_rank(void);
/* Joins the other ranks. Call this before the shared call, in the same thread. */
spin_status spin_ranks_begin(void);
/* Call this after the shared call, with its status. Returns that status, or the failure of another
 * rank. *speaks is set to whether this process has to print the report or the error. */
spin_status spin_ranks_end(spin_status status, bool *speaks);
/* Call this when everything is printed. If code is not 0, terminates the ranks that do not end by
 * themselves. */
void spin_ranks_exit(int code);

#ifdef __cplusplus
}
#endif
#endif
