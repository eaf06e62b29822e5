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
 * Images are planar [3][h][w] float, 0..1. Counts are named n_*, an index has a singular name. The
 * default of an option field is zero unless its comment says otherwise.
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

/* Set the error message and return code. The text is in lower case without a full stop: what
 * failed, where (file, array, line), why; names in 'quotes'. */
spin_status spin_fail(spin_status code, const char *fmt, ...) SPIN_PRINTF(2, 3);
/* Shorthands for the most frequent codes. */
#define spin_misuse(...) spin_fail(SPIN_E_USAGE, __VA_ARGS__)
#define spin_not_found(...) spin_fail(SPIN_E_NOT_FOUND, __VA_ARGS__)
#define spin_malformed(...) spin_fail(SPIN_E_MALFORMED, __VA_ARGS__)
#define spin_unsupported(...) spin_fail(SPIN_E_UNSUPPORTED, __VA_ARGS__)

/* Prefix the error message with "text: " and return code. SPIN_OK and SPIN_E_CANCELLED are returned
 * as they are. */
spin_status spin_fail_context(spin_status code, const char *fmt, ...) SPIN_PRINTF(2, 3);

/* Return the status of expr from this function if it fails. */
#define SPIN_TRY(expr)                                                                             \
    do {                                                                                           \
        spin_status spin_try_ = (expr);                                                            \
        if (spin_try_ != SPIN_OK)                                                                  \
            return spin_try_;                                                                      \
    } while (0)

/* The same, prefixing the error message with "text: ". */
#define SPIN_TRY_IN(expr, ...)                                                                     \
    do {                                                                                           \
        spin_status spin_try_ = (expr);                                                            \
        if (spin_try_ != SPIN_OK)                                                                  \
            return spin_fail_context(spin_try_, __VA_ARGS__);                                      \
    } while (0)

/* Jump to out: with status set if expr fails. Requires a local `spin_status status`. */
#define SPIN_TRY_OUT(expr)                                                                         \
    do {                                                                                           \
        status = (expr);                                                                           \
        if (status != SPIN_OK)                                                                     \
            goto out;                                                                              \
    } while (0)

/* Print "warning: ..." as one line on stderr. */
void spin_warn(const char *fmt, ...) SPIN_PRINTF(1, 2);

/* Verbosity of the library on stderr: -1 warnings only, 0 normal, up to 4: 1 logs each run ... 4
 * each operation. */
void spin_set_verbosity(int level);

/* Ask running work to stop at the next safe point. Async-signal-safe. */
void spin_cancel(void);

/* ---- 2. Splats of one frame ------------------------------------------------------------------ */

enum spin_column {
    SPIN_COL_MEANS = 1 << 0,           /* [n][3] centres, world units */
    SPIN_COL_QUATS = 1 << 1,           /* [n][4] w, x, y, z, unit length */
    SPIN_COL_LOG_SCALES = 1 << 2,      /* [n][3] natural log of the standard deviation */
    SPIN_COL_LOGIT_OPACITIES = 1 << 3, /* [n] before the sigmoid, finite */
    SPIN_COL_SH = 1 << 4,              /* [n][(sh_degree+1)^2][3] coefficients, channel last */
    SPIN_COL_RGB = 1 << 5,             /* [n][3] 0..1, for points with a plain colour */
    SPIN_COL_ATTRIBUTES =              /* all that a Gaussian needs besides its mean */
    SPIN_COL_QUATS | SPIN_COL_LOG_SCALES | SPIN_COL_LOGIT_OPACITIES | SPIN_COL_SH
};

/* A structure of arrays: each column is NULL or has n rows. The struct owns its memory: zero it,
 * call spin_splats_reserve() as often as needed, free it once. */
struct spin_splats {
    size_t n;               /* rows */
    size_t capacity;        /* rows that each allocated column can hold */
    int sh_degree;          /* degree of sh, 0..3 */
    bool antialias;         /* to be rendered with antialiasing */
    float *means;           /* [n][3] */
    float *quats;           /* [n][4] or NULL */
    float *log_scales;      /* [n][3] or NULL */
    float *logit_opacities; /* [n] or NULL */
    float *sh;              /* [n][(sh_degree+1)^2][3] or NULL */
    float *rgb;             /* [n][3] or NULL */
    bool mapped;            /* columns point into a mapped file: read-only, not owned */
    size_t held[6];         /* private: allocated bytes of each column */
};

/* Set n and sh_degree, clear antialias, and allocate the wanted columns for at least n rows; other
 * columns stay allocated if they were. Contents are not preserved. Fails with SPIN_E_MEMORY. */
spin_status spin_splats_reserve(struct spin_splats *s, size_t n, unsigned columns, int sh_degree);
void spin_splats_free(struct spin_splats *s);
/* Copy the rows of s whose mark is 1 to *out, with all columns except rgb. */
spin_status spin_splats_take(const struct spin_splats *s, const unsigned char *mark,
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
 * where w(t) = exp(-0.5 (d / sigmas)^2), a Gaussian window. With a plateau lo, hi, sigma2, w is 1
 * from lo to hi, falls as a Gaussian of sigmas before lo and as one of sigma2 after hi. With a gate
 * g it is g + (1 - g) w; with cuts first, end it is 0 outside [first, end). Times are in the unit
 * of the clip's frame times (struct spin_frame_info).
 *
 * Terms of arrays that are NULL are omitted. A frame is a slice: the rows that are drawn at its
 * time, in order. The struct owns its memory: zero it, reserve once, fill it, settle, free. */
struct spin_splats_4d {
    size_t n;
    int degree;           /* of the paths, as polynomials: 0..3 */
    int sh_degree;        /* 0..3 */
    bool antialias;       /* to be rendered with antialiasing */
    double least_weight;  /* rows whose w(t) is below this are not drawn, */
    double least_opacity; /* nor those whose opacity at t is below this */
    double period;        /* of the cosines with sh_cos */
    /* Factors on the screen-space covariance that the model was trained with; 0: none. */
    double cov2d[2];
    float *centres;         /* [n][3] world units */
    float *times;           /* [n] */
    float *quats;           /* [n][4] w, x, y, z */
    float *log_scales;      /* [n][3] */
    float *logit_opacities; /* [n] */
    float *sigmas;          /* [n] above 0; SPIN_FOREVER: w does not fall */
    float *sh;              /* [n][(sh_degree+1)^2][3] */
    float *paths;           /* [n][degree][3] or NULL where degree is 0 */
    float *spins;           /* [n][4] or NULL */
    float *plateaus;        /* [n][3] lo, hi, sigma2, or NULL */
    float *cuts;            /* [n][2] first, end, or NULL */
    float *gates;           /* [n] 0..1, or NULL */
    float *sh_cos;          /* [n][2][(sh_degree+1)^2][3] or NULL */
    double *spans;          /* private: [n][2] first and last time at which a row is drawn */
};
#define SPIN_FOREVER 3e38f

enum spin_splats_4d_part { /* optional arrays, except paths */
                           SPIN_4D_SPINS = 1 << 0,
                           SPIN_4D_PLATEAUS = 1 << 1,
                           SPIN_4D_CUTS = 1 << 2,
                           SPIN_4D_GATES = 1 << 3,
                           SPIN_4D_SH_COS = 1 << 4
};
/* Set n and the degrees, and allocate all arrays, filled with zeros. */
spin_status spin_splats_4d_reserve(struct spin_splats_4d *s, size_t n, int degree, int sh_degree,
                                   unsigned parts);
void spin_splats_4d_free(struct spin_splats_4d *s);
/* A view of the 4D splats as those of one frame, each at its centre. Borrows the arrays: do not
 * free it. */
struct spin_splats spin_splats_of_4d(const struct spin_splats_4d *s);
/* Call when all rows are filled: drops rows whose values are not finite or far out of range, or
 * whose rotation is zero or sigma not above 0; keeps the order of the others and normalises their
 * quats. from: NULL, or [n], receives the original index of each remaining row. */
spin_status spin_splats_4d_settle(struct spin_splats_4d *s, size_t *n_dropped, size_t *from);
/* Fill the columns with the rows that are drawn at `time`. */
spin_status spin_splats_4d_slice(const struct spin_splats_4d *s, double time, unsigned columns,
                                 struct spin_splats *out);
/* Whether row i is drawn at `time`; its w(time). */
bool spin_splats_4d_shows(const struct spin_splats_4d *s, size_t i, double time);
double spin_splats_4d_weight(const struct spin_splats_4d *s, size_t i, double time);
/* For each of n times, the number of rows drawn. */
spin_status spin_splats_4d_counts(const struct spin_splats_4d *s, const double *times, size_t n,
                                  size_t *counts);

/* ---- 3. Cameras and views -------------------------------------------------------------------- */

/* Near plane of 3DGS, world units. */
#define SPIN_NEAR 0.2

struct spin_camera {
    int width, height;     /* pixels */
    double fx, fy, cx, cy; /* pixels; centre of the top-left pixel is 0.5, 0.5 */
    double w2c[12];        /* [3][4], p_c = R p_w + t; R orthonormal, det +1 */
    double z_near;         /* splats at or in front of this depth are not drawn; 0: SPIN_NEAR */
};

/* One image of a data set. */
struct spin_view {
    struct spin_camera camera;
    int dataset_frame; /* index of the frame in the data set, from 0 */
    int number;        /* frame number from the file name, or -1 */
    double time;       /* in the data set's unit (panoptic: equals dataset_frame) */
    int camera_id;     /* the data set's number of the camera */
    bool test;         /* held out */
    char *path;        /* image file, absolute or relative to the working directory */
    char *mask;        /* image that is 0 outside the foreground; NULL: none */
};

/* All views of a data set, sorted by dataset_frame, then camera_id. */
struct spin_views {
    struct spin_view *view; /* [n] */
    size_t n, capacity;
    int n_dataset_frames;
    bool numbered;   /* every view has a frame number, the same for all views of a frame */
    char notes[512]; /* lines about guesses and losses, for the user; "" */
};

/* Append a copy of v (path and mask are copied). */
spin_status spin_views_add(struct spin_views *views, const struct spin_view *v);
void spin_views_free(struct spin_views *views);

/* ---- 4. Plug-ins ----------------------------------------------------------------------------- */

/* A plug-in may call the functions of parts 1 to 4 and of part 6; src/plugin.sym lists them. */

#define SPIN_PLUGIN_ABI 7

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

/* All that probe() can examine of an input. */
struct spin_peek {
    const char *path;
    bool is_folder;
    /* First bytes, at most 16384, of a file; for a folder, of the first that exists of cfg_args,
     * chkpnt*, deformation.pth and point_cloud.ply. */
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
    unsigned columns;        /* that frame() can fill */
    unsigned static_columns; /* those of `columns` that are equal in all frames */
    bool identity;           /* row i is the same Gaussian in every frame */
    int sh_degree;           /* -1: no SH */
    bool antialias;          /* the splats were trained with antialiasing */
    bool continuous;         /* can be sampled at any time in [time_first, time_last] */
    double time_first, time_last;
    int n_clip_frames;  /* frames of the clip of a continuous method; 0: unknown */
    double fps;         /* frames per second of the clip; 0: unknown */
    bool half_open;     /* for data sets without times: frame i of n is at i/n of the time span, not
                           i/(n-1) */
    bool counts_frames; /* time t is frame t: frame i of a data set is at i, whatever its own times
                         */
    char variant[128];  /* variant of the format, for --info */
    char notes[1024];   /* lines about guesses and losses, for the user; "" */
};

struct spin_importer {
    int abi;              /* SPIN_PLUGIN_ABI */
    const char *name;     /* argument of --from */
    const char *summary;  /* one line for --list */
    const char *upstream; /* project and commit whose files the importer was written for */
    const struct spin_plugin_option *options;

    /* Confidence, 0..100, that this importer reads the input. Must not open files or allocate. */
    int (*probe)(const struct spin_peek *peek);

    /* Splats. open() reads only what is quick to read; frame() fills the wanted columns of one
     * frame, after spin_splats_reserve(). `time` is used by continuous methods only. frame() may be
     * called in any order and repeatedly, by one thread at a time. close() also follows a failed
     * open() that had set *self. NULL open: the importer reads data sets only. */
    spin_status (*open)(const char *path, const struct spin_plugin_values *values, void **self,
                        struct spin_sequence_info *sequence);
    spin_status (*frame)(void *self, int frame, double time, unsigned columns,
                         struct spin_splats *out);
    void (*close)(void *self);

    /* The same input as 4D splats, for methods that store these: settled, and owned by the importer
     * until close(). *out is NULL if this input has none. */
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
    /* The same in pixels of the data set's images; NaN: no camera sees a splat, or unknown. */
    double place_pixels;
    int rendered; /* number of the frame that was rendered from its file; -1: none */
    double psnr;  /* dB against the render of the bundle; infinite: identical; NaN: none */
};

/* Result of --decimate: the splats that were dropped, and the loss in quality. */
struct spin_decimated {
    /* Splats per frame on average, or of the clip if in_all; `before` excludes those that other
     * options drop. before is 0 without --decimate. */
    double before, after;
    /* The counts are of the clip: its rows are 4D splats, or filters drop some of them in some
     * frames only. */
    bool in_all;
    /* Splats were ranked by their contribution to the cameras of the data set; else by opacity and
     * size. */
    bool by_views;
    int n_pictures;   /* images that were compared; 0: no splat is visible in any */
    double psnr;      /* dB over all compared images, against all splats; infinite: identical */
    int n_tries;      /* outputs written to reach a size; 0: no size was requested */
    uint64_t reached; /* bytes of the whole output, if a size was requested */
};

/* Why spin-export leaves out a splat. If several reasons apply, the first counts. */
enum spin_row_reason {
    SPIN_ROW_KEPT,
    /* Options of that name. A splat with a NaN or infinite position passes these four. */
    SPIN_ROW_CROP,
    SPIN_ROW_MIN_VIEWS,
    SPIN_ROW_FLOATERS,
    SPIN_ROW_BACKDROP, /* --backdrop off */
    /* No viewer can draw the splat. */
    SPIN_ROW_NOT_FINITE,
    SPIN_ROW_NO_ROTATION, /* of length zero */
    SPIN_ROW_TOO_LARGE,   /* --max-scale */
    /* Options of that name. */
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
    struct spin_export_check check;
    struct spin_decimated decimated;
    uint64_t images; /* images rendered and written, by exporters that render; else 0 */
};

/* What an exporter receives before the first frame. All pointers are borrowed until end() or
 * abort(). */
struct spin_export_job {
    const char *output; /* as given by the user */
    bool force;         /* overwrite existing files */
    bool sync;          /* for every struct spin_out */
    int n_frames;       /* to be exported */
    double fps;         /* 0: unknown */
    const char *source; /* name of the method that the clip was imported from */
    int sh_degree;      /* of the exported splats */
    bool antialias;     /* the splats are to be rendered with antialiasing */
    const struct spin_plugin_values *values;
    const struct spin_views *views; /* NULL if the data set is not available */
    const int *dataset_frame_of;    /* [n_frames] index of each frame in the data set, or -1 */
    struct spin_renderer *renderer; /* not NULL if the exporter sets needs_renderer */
    const float *background;        /* [3] */
    bool transparent; /* --background none: render with alpha; refused for exporters without `alpha`
                       */
    int n_threads;    /* 0: all */
    /* Reads the same frame as it was imported, if the bundle has both source and retrained splats,
     * for comparisons; else NULL. */
    spin_status (*source_frame)(void *source_of, int frame, struct spin_splats *out);
    void *source_of;
    int source_sh_degree;
    bool source_antialias;
    bool retrained; /* the attributes were retrained, not imported */
    /* [n_frames] splats of each frame, or somewhat more if some cannot be drawn; NULL: unknown */
    const size_t *counts;
    /* The exporter adds to bytes and images, and sets frames if it exports only some; or NULL. At
     * end(), left_out is final. */
    struct spin_export_report *report;

    /* With `check`, end() reads back what was written and fills report->check; only set for
     * exporters with `checks`. again() returns a frame, 0..n_frames-1, that stays valid until its
     * next call or that of frame(). It serves checks, and exporters that read all frames in
     * begin(). */
    bool check;
    spin_status (*again)(void *context, int frame, const struct spin_splats **out);
    void *context;

    const double *times; /* [n_frames] of each frame, in the source's unit */
    /* The clip, for exporters with splats_4d, in the time unit of `times`; NULL: the clip consists
     * of frames. */
    const struct spin_splats_4d *splats_4d;
    double stride; /* mean difference of consecutive frame numbers; 0 means 1 */

    /* How frames were paired with a data set, for programs that import the output again. */
    const int *source_index; /* [n_frames] index of each frame in the source clip; NULL: unknown */
    int n_source_frames;     /* frames of the source clip */
    bool numbered;           /* frame numbers come from the source */
    const char *pair;        /* value of spin-import --pair; "" or NULL: not given */
    /* The data set's absolute folder, and the importer that reads it; NULL: none. */
    const char *data;
    const char *data_from;
    bool identity; /* row i is the same splat in every frame, if no splat is left_out at end() */

    const int *numbers; /* [n_frames] of each frame, as in struct spin_frame_info */
};

struct spin_frame_info {
    int number;  /* the source's frame number, or the index if it has none */
    double time; /* in the source's unit */
    size_t n;    /* splats, if known */
};

struct spin_exporter {
    int abi;
    const char *name, *summary;
    const struct spin_plugin_option *options;
    unsigned wants; /* required columns */
    bool checks;    /* can read back its output */
    /* The output records whether splats are to be rendered with antialiasing, or was rendered
     * so. */
    bool antialias;
    /* Accepts a clip of 4D splats, for which frame() is not called; without `frame` it accepts
     * nothing else. */
    bool splats_4d;
    bool needs_renderer;
    bool alpha;          /* supports job->transparent */
    bool looks_at_views; /* uses job->views; else the data set is not opened */

    /* Exactly one of end() and abort() follows a successful begin(). Files appear under their final
     * name only when complete. */
    spin_status (*begin)(const struct spin_export_job *job, void **self);
    spin_status (*frame)(void *self, int frame, const struct spin_frame_info *info,
                         const struct spin_splats *splats);
    spin_status (*end)(void *self);
    void (*abort)(void *self);
};

/* An output file that appears under its name only when complete: it is written beside it under a
 * unique name, path.tmp.*, and renamed by commit after all writes and the close succeeded. Write
 * with spin_out_write() or with stdio on `file`; commit detects errors of both. Exactly one of
 * commit and abandon must follow; both free it.
 *
 * Set `sync` after opening for output that would take long to produce again: commit then flushes it
 * to the disk (fsync) before renaming. Without it a file is still never partial after a kill or on
 * a full disk, but may be after a power failure. */
struct spin_out {
    FILE *file;
    char *path, *temporary;
    uint64_t bytes; /* written by spin_out_write() */
    bool sync;
    bool force; /* as passed to spin_out_open() */
};
/* Without force: SPIN_E_IO if path exists ("... exists; use --force to overwrite"), even as a
 * dangling link. Commit checks again and does not replace a file that another process created in
 * the meantime. Inputs are never replaced. */
spin_status spin_out_open(const char *path, bool force, struct spin_out *out);
spin_status spin_out_write(struct spin_out *out, const void *data, size_t bytes);
spin_status spin_out_commit(struct spin_out *out);
void spin_out_abandon(struct spin_out *out);

/* mkdir -p */
spin_status spin_folder_make(const char *path);

/* The object that a shared library built outside this tree defines as spin_plugin; spin-plugin(7)
 * is the guide. abi stays the first member in all versions. */
struct spin_plugin {
    int abi;                                      /* SPIN_PLUGIN_ABI */
    const struct spin_importer *const *importers; /* NULL-terminated; or NULL */
    const struct spin_exporter *const *exporters; /* NULL-terminated; or NULL */
};
extern SPIN_VISIBLE const struct spin_plugin spin_plugin;

/* The built-in ones, NULL-terminated, in alphabetical order. */
extern const struct spin_importer *const spin_importers[];
extern const struct spin_exporter *const spin_exporters[];

/* Load the plug-ins of SPIN_PLUGIN_PATH: shared objects and folders of them, separated by colons.
 * They are loaded once, by the first call of any of these three functions, and from nowhere else.
 * Plug-ins that fail to load are skipped with a warning, except `chosen` (or NULL), whose error the
 * caller reports. */
void spin_plugins_load(const char *chosen);
/* All importers and exporters, the built-in ones first, NULL-terminated. */
const struct spin_importer *const *spin_importer_list(void);
const struct spin_exporter *const *spin_exporter_list(void);

/* The shared object that defines this importer or exporter; NULL: it is built in. */
const char *spin_plugin_origin(const void *plugin);
/* Why the plug-in of this name, or the object name.so, failed to load; NULL if it did not. */
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
/* Fill the columns of a frame. BEST: from the retrained splats if any, else from refined splats if
 * they have all attributes, else from the source. The number of splats in a frame may differ
 * between these. SPIN_E_NOT_FOUND if the columns do not exist (positions only: run spin-retrain).
 */
spin_status spin_scene_read(struct spin_scene *scene, int frame, enum spin_splat_source from,
                            unsigned columns, struct spin_splats *out);

/* ---- 6. Rendering ---------------------------------------------------------------------------- */

/* Render one view of splats that have all attribute columns. image: [3][h][w]. */
spin_status spin_render(struct spin_renderer *r, const struct spin_splats *splats,
                        const struct spin_camera *camera, const float background[3], float *image);

/* Layers of the last rendered image; either may be NULL. alpha: [h][w], 0..1, how much of the
 * background the splats cover. depth: [2][h][w], along the camera's axis in world units: the
 * expected depth (mean weighted by contribution), and the median depth, where transmittance falls
 * to a half; 0: none. */
spin_status spin_render_layers(struct spin_renderer *r, float *alpha, float *depth);

/* Load an image, box-filtered to width x height if its size differs, into out, planar [3][h][w]
 * float 0..1; save one as PNG (sync: see struct spin_out). For exporters that render. Transparent
 * pixels are blended over the background; NULL: black. */
spin_status spin_image_load(const char *path, int width, int height, const float background[3],
                            float *out);
spin_status spin_image_save(const char *path, int width, int height, const float *image, bool sync);

/* ---- 7. Calls and programs ------------------------------------------------------------------- */

/* Half-open range of frame numbers A:B:STEP; {0} means all. */
struct spin_range {
    bool given;
    int first, last, step;
};

enum spin_split { SPIN_SPLIT_TEST, SPIN_SPLIT_TRAIN, SPIN_SPLIT_ALL };

/* How an evaluation of dynamic regions selects dynamic pixels. */
enum spin_dynamic_from {
    SPIN_DYNAMIC_AUTO,   /* masks if every view has one, else images */
    SPIN_DYNAMIC_MASKS,  /* the data set's foreground masks */
    SPIN_DYNAMIC_IMAGES, /* pixels that differ from their camera's median over time */
    SPIN_DYNAMIC_OFF
};

/* For programs: handle SIGBUS, which is raised by reading from a mapped file that another process
 * truncated. The handler prints one line that begins with `command` and names the file, removes
 * partial output, and ends the process with exit code 1. Without this call the signal ends the
 * process. */
void spin_catch_cut_files(const char *command);

/* For programs started as several processes by MPI's mpirun, which share the work of one call of
 * spin_run.h (rank 0 returns the report). A process started without mpirun is rank 0 of 1 and does
 * not load MPI. */
/* This process's rank, from its environment; -1: not started by mpirun. May be called before
 * spin_ranks_begin(). */
int spin_ranks_place(void);
/* Join the other ranks. To be called before the shared call, by the thread that makes it. */
spin_status spin_ranks_begin(void);
/* To be called after the shared call, with its status; returns that, or the failure of another
 * rank. *speaks: this process prints the report, or the error. */
spin_status spin_ranks_end(spin_status status, bool *speaks);
/* To be called when everything is printed. If code is not 0, terminates other ranks that do not end
 * by themselves. */
void spin_ranks_exit(int code);

#ifdef __cplusplus
}
#endif
#endif
