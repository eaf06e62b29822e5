/* spin.h - the public header of spin4d, and a map of its source. spin_run.h declares the functions
 * that the commands call.
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

/* The error message of the last failure in this thread: one line without a full stop; "" if nothing
 * has failed. */
const char *spin_last_error(void);

/* Sets this thread's error message and returns `code`. The text is in lower case without a full
 * stop: what failed, where (file, array, line), why; names in 'quotes'. */
spin_status spin_fail(spin_status code, const char *fmt, ...) SPIN_PRINTF(2, 3);
/* Shorthands for the most frequent status codes. */
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

/* Makes running calls of this library stop at the next safe point and return SPIN_E_CANCELLED.
 * Async-signal-safe. */
void spin_cancel(void);

/* ---- 2. Splats of one frame ------------------------------------------------------------------ */

enum spin_column {
    SPIN_COL_MEANS = 1 << 0,           /* [n][3] centres, world units */
    SPIN_COL_QUATS = 1 << 1,           /* [n][4] w, x, y, z, unit length */
    SPIN_COL_LOG_SCALES = 1 << 2,      /* [n][3] natural log of the standard deviation */
    SPIN_COL_LOGIT_OPACITIES = 1 << 3, /* [n] opacity before the sigmoid; finite */
    SPIN_COL_SH = 1 << 4,              /* [n][(sh_degree+1)^2][3] SH coefficients */
    SPIN_COL_RGB = 1 << 5,             /* [n][3] 0..1, colours of splats without SH */
    SPIN_COL_ATTRIBUTES =              /* all columns of a Gaussian except its mean */
    SPIN_COL_QUATS | SPIN_COL_LOG_SCALES | SPIN_COL_LOGIT_OPACITIES | SPIN_COL_SH
};

/* A structure of arrays: each column is NULL or has n rows. The struct owns its memory. The caller
 * sets the struct to zero first, calls spin_splats_reserve() as often as needed, and calls
 * spin_splats_free() at the end, also after a failure. */
struct spin_splats {
    size_t n;               /* rows */
    size_t capacity;        /* rows that each allocated column can hold */
    int sh_degree;          /* degree of sh, 0..3 */
    bool antialias;         /* true: render the splats with antialiasing */
    float *means;           /* [n][3] */
    float *quats;           /* [n][4] or NULL */
    float *log_scales;      /* [n][3] or NULL */
    float *logit_opacities; /* [n] or NULL */
    float *sh;              /* [n][(sh_degree+1)^2][3] or NULL */
    float *rgb;             /* [n][3] or NULL */
    bool mapped;            /* true: columns point into a mapped file; read-only, not owned */
    size_t held[6];         /* private: allocated bytes of each column */
};

/* Sets n and sh_degree, clears antialias, and allocates the requested columns for at least n rows.
 * Other columns that are already allocated grow to n rows too. Contents are not preserved. Fails
 * with SPIN_E_MEMORY, or SPIN_E_UNSUPPORTED if SH is requested with a degree outside 0..3. */
spin_status spin_splats_reserve(struct spin_splats *s, size_t n, unsigned columns, int sh_degree);
void spin_splats_free(struct spin_splats *s);
/* Copies the marked rows of s to *out, with all columns except rgb. mark: [n], not 0 for marked
 * rows. */
spin_status spin_splats_select(const struct spin_splats *s, const unsigned char *mark,
                               struct spin_splats *out);
/* Copies rows row[0..n-1] of s to *out in this order, with the same columns. */
spin_status spin_splats_gather(const struct spin_splats *s, const uint32_t *row, size_t n,
                               struct spin_splats *out);

/* 4D splats: each has a path over time and a window in time, so it is stored once instead of in
 * every frame. At time t, with d = t - times[i], row i is a splat with
 *
 *     mean       centres + paths[0] d + paths[1] d^2 + paths[2] d^3
 *     rotation   quats + d spins, normalised
 *     scale      log_scales
 *     opacity    sigmoid(logit_opacities) w(t)
 *     colour     sh + cos(2 pi d / period) sh_cos[0] + cos(4 pi d / period) sh_cos[1]
 *
 * where w(t) = exp(-0.5 (d / sigmas)^2) is a Gaussian window. Terms of arrays that are NULL are
 * omitted. Three optional arrays change the window of a row, one after the other:
 *
 *     If there are plateaus (lo, hi, sigma2), w is 1 from lo to hi. Before lo, w falls off like a
 *     Gaussian of standard deviation sigmas; after hi, like one of standard deviation sigma2.
 *     If there are gates (g), g + (1 - g) w replaces w.
 *     If there are cuts (first, end), w is 0 outside [first, end).
 *
 * All times are in the unit of the clip's frame times (struct spin_frame_info). A frame is a slice
 * of the 4D splats: the rows that are drawn at the time of the frame, in the order of the arrays.
 *
 * The struct owns its memory. Set it to zero, call spin_splats_4d_reserve() once, fill the arrays,
 * call spin_splats_4d_finish(), and free the memory with spin_splats_4d_free(). */
struct spin_splats_4d {
    size_t n;
    int degree;           /* degree of the paths, which are polynomials: 0..3 */
    int sh_degree;        /* 0..3 */
    bool antialias;       /* true: render the splats with antialiasing */
    double least_weight;  /* a row is not drawn at times at which its w is below this */
    double least_opacity; /* the same for the product of w and the opacity */
    double period;        /* period of the cosines of sh_cos */
    /* Factors by which the training multiplied the screen-space covariances of the splats; {0, 0}:
     * none. */
    double cov2d[2];
    float *centres;         /* [n][3] world units */
    float *times;           /* [n] */
    float *quats;           /* [n][4] w, x, y, z */
    float *log_scales;      /* [n][3] */
    float *logit_opacities; /* [n] */
    float *sigmas;          /* [n] standard deviation of w, above 0; SPIN_FOREVER: w is 1 */
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

/* Flags of the optional arrays. `paths` has no flag: it is allocated if degree is above 0. */
enum spin_splats_4d_part {
    SPIN_4D_SPINS = 1 << 0,
    SPIN_4D_PLATEAUS = 1 << 1,
    SPIN_4D_CUTS = 1 << 2,
    SPIN_4D_GATES = 1 << 3,
    SPIN_4D_SH_COS = 1 << 4
};
/* Sets n and both degrees, and allocates arrays filled with zeros: all arrays that may not be NULL;
 * `paths`, if degree is above 0; and the optional arrays in `parts`, a set of enum
 * spin_splats_4d_part. */
spin_status spin_splats_4d_reserve(struct spin_splats_4d *s, size_t n, int degree, int sh_degree,
                                   unsigned parts);
void spin_splats_4d_free(struct spin_splats_4d *s);
/* Returns the 4D splats as the splats of one frame, each at its centre with its full opacity. The
 * result points to the arrays of *s: do not free it. */
struct spin_splats spin_splats_of_4d(const struct spin_splats_4d *s);
/* Validates the rows after all arrays are filled. Drops rows with values that are not finite or far
 * out of range, with a rotation of length 0, or with a sigma that is not above 0, and sets
 * *n_dropped to their number. Keeps the order of the remaining rows and normalises their quats.
 * from: NULL, or [n], which receives the original index of each remaining row. */
spin_status spin_splats_4d_finish(struct spin_splats_4d *s, size_t *n_dropped, size_t *from);
/* Fills the columns of *out with the rows that are drawn at `time`. */
spin_status spin_splats_4d_slice(const struct spin_splats_4d *s, double time, unsigned columns,
                                 struct spin_splats *out);
/* Whether row i is drawn at `time`. */
bool spin_splats_4d_is_visible(const struct spin_splats_4d *s, size_t i, double time);
/* The window w(time) of row i. */
double spin_splats_4d_weight(const struct spin_splats_4d *s, size_t i, double time);
/* Sets counts [n] to the number of rows that are drawn at each of the n times. */
spin_status spin_splats_4d_counts(const struct spin_splats_4d *s, const double *times, size_t n,
                                  size_t *counts);

/* ---- 3. Cameras and views -------------------------------------------------------------------- */

/* Depth of the near plane in 3DGS, world units. */
#define SPIN_NEAR 0.2

struct spin_camera {
    int width, height;     /* pixels */
    double fx, fy, cx, cy; /* pixels; centre of the top-left pixel is 0.5, 0.5 */
    double w2c[12];        /* [3][4], R | t: p_c = R p_w + t; R orthonormal, det +1 */
    double z_near;         /* splats at this depth or nearer are not drawn; 0: SPIN_NEAR */
};

/* One image of a data set. */
struct spin_view {
    struct spin_camera camera;
    int dataset_frame; /* index of the frame in the data set, from 0 */
    int number;        /* frame number from the file name, or -1 */
    double time;       /* in the data set's unit; panoptic data sets: dataset_frame */
    int camera_id;     /* number of the camera in the data set */
    bool test;         /* true: a test view, held out from training for measuring */
    char *path;        /* image file, absolute or relative to the working directory */
    char *mask;        /* image that is 0 outside the foreground; NULL: none */
};

/* All views of a data set, sorted by dataset_frame, then camera_id. */
struct spin_views {
    struct spin_view *view; /* [n] */
    size_t n, capacity;
    int n_dataset_frames;
    bool numbered;   /* true: all views have a number, the same for all views of a frame */
    char notes[512]; /* for the user: a line per assumption or loss of data; "" if none */
    /* Frames without images were left out, so that the order of frames does not identify them. */
    bool lacks_frames;
};

/* Appends a copy of v, with copies of path and mask. */
spin_status spin_views_add(struct spin_views *views, const struct spin_view *v);
void spin_views_free(struct spin_views *views);

/* ---- 4. Plug-ins ----------------------------------------------------------------------------- */

/* A plug-in may call the functions of parts 1 to 4 and of part 6; src/plugin.sym lists them. */

#define SPIN_PLUGIN_ABI 9

/* A sound track: a sound file in memory, which spin4d copies without decoding it, except into
 * videos. */
struct spin_sound {
    char name[64];             /* name for users, without folder and extension */
    const char *type;          /* "wav", "opus", "vorbis", "m4a", "aac", "mp3" or "flac"; static */
    const unsigned char *data; /* NULL: there is no sound */
    size_t size;               /* bytes */
    /* Time of the clip, in seconds, at which the sound begins. If start is negative, the first
     * -start seconds of the sound are skipped. */
    double start;
    double gain; /* factor of the amplitude, 0 or more */
};

/* A command line option of a plug-in, `--key value`. A table of options ends with key == NULL. */
struct spin_plugin_option {
    const char *key; /* without the leading dashes */
    const char *arg; /* placeholder of the value in --help; NULL: the option has no value */
    const char *help;
    const char *fallback; /* default value; NULL: none */
};

/* The options of a plug-in that the user gave. pairs: key, value, key, value, ..., NULL; or NULL.
 */
struct spin_plugin_values {
    const char *const *pairs;
};
/* Returns the value that the user gave for key, or fallback if there is none. */
const char *spin_plugin_value(const struct spin_plugin_values *v, const char *key,
                              const char *fallback);

/* The part of an input that probe() may examine. */
struct spin_peek {
    const char *path;
    bool is_folder;
    /* The first n_head bytes of the file: 16384, or fewer if the file is shorter. If the input is a
     * folder, they are read from the first of these files that exists: cfg_args, chkpnt*,
     * deformation.pth, point_cloud.ply, ckpts/ckpt_*.pt, ckpt_*.pt. */
    const unsigned char *head;
    size_t n_head;
    /* Names of the members of a zip archive, or of the file params.npz in a folder, one per line;
     * "" for other inputs. */
    const char *tail_names;
    const char *const *names; /* entries of a folder, sorted, at most 4096; NULL-terminated */
};

/* The data that an importer's open() reports about a run. The importer owns the arrays and frees
 * them in close(). */
struct spin_sequence_info {
    int n_frames;
    const double *times;     /* [n_frames] in the method's unit of time; NULL: 0, 1, 2, ... */
    const int *numbers;      /* [n_frames] frame numbers from file names; NULL: none */
    const size_t *counts;    /* [n_frames] number of splats; NULL: unknown before frame() */
    unsigned columns;        /* columns that frame() can fill */
    unsigned static_columns; /* the subset of `columns` that is equal in all frames */
    bool identity;           /* true: row i is the same splat in every frame */
    int sh_degree;           /* -1: no SH */
    bool antialias;          /* true: the splats were trained with antialiasing */
    bool continuous;         /* true: frame() accepts any time in [time_first, time_last] */
    double time_first, time_last;
    int n_clip_frames; /* continuous methods: frames of the clip; 0: unknown */
    double fps;        /* frames per second of the clip; 0: unknown */
    /* Times of the frames if the data set stores no times. True: frame i of n is at i/n of the
     * range from time_first to time_last; false: at i/(n-1). */
    bool half_open;
    /* True: the method's unit of time is the frame. Frame i of a data set is then at time i, even
     * if the data set stores other times. */
    bool counts_frames;
    char variant[128]; /* variant of the format, for --info */
    char notes[1024];  /* for the user: a line per assumption or loss of data; "" if none */
    /* Offset that frame() has subtracted from all positions, since they are too far from 0 for the
     * precision of float; 0 for most runs. */
    double shift[3];
    /* The sound track, whose `start` is relative to the first frame of the source; NULL: none. */
    const struct spin_sound *sound;
    double up[3]; /* unit vector that points up; 0 0 0: unknown */
};

struct spin_importer {
    int abi;              /* SPIN_PLUGIN_ABI */
    const char *name;     /* argument of --from */
    const char *summary;  /* one line for --list */
    const char *upstream; /* project and commit whose files the importer was written for */
    const struct spin_plugin_option *options;

    /* Returns the confidence, 0..100, that this importer can read the input. Must not open files or
     * allocate memory. */
    int (*probe)(const struct spin_peek *peek);

    /* Functions that read splats; NULL if the importer reads data sets only. open() reads headers
     * and other data that are quick to read. frame() calls spin_splats_reserve() and fills the
     * requested columns of one frame; continuous methods use `time`, others use `frame`. Frames may
     * be requested in any order and more than once, but only one thread calls frame() at a time.
     * close() is also called after a failed open() that set *self. */
    spin_status (*open)(const char *path, const struct spin_plugin_values *values, void **self,
                        struct spin_sequence_info *sequence);
    spin_status (*frame)(void *self, int frame, double time, unsigned columns,
                         struct spin_splats *out);
    void (*close)(void *self);

    /* Sets *out to the input as 4D splats, on which spin_splats_4d_finish() has been called, or to
     * NULL if this input contains none. The importer owns the splats and frees them in close(). The
     * function pointer is NULL if the method never stores 4D splats. */
    spin_status (*splats_4d)(void *self, const struct spin_splats_4d **out);

    /* Appends all views of the data set in folder `path` to *out. NULL: the importer reads no data
     * sets. */
    spin_status (*views)(const char *path, const struct spin_plugin_values *values,
                         struct spin_views *out);
};

struct spin_renderer;

/* Result of spin-export --check: differences between the output, which was read back, and the
 * bundle, over all frames. */
struct spin_export_check {
    int frames; /* frames read back; 0: not checked */
    uint64_t splats;
    double bounds; /* largest difference of a side of a frame's bounding box, world units */
    /* Errors of the mean, log scale, rotation (degrees), opacity, colour and SH. */
    double rms[6], largest[6];
    uint64_t sh_lost; /* splats with SH coefficients that the output does not contain */
    /* Largest error of a mean relative to the largest standard deviation of its splat; NaN:
     * unknown. */
    double place_sizes;
    /* Largest error of a mean in pixels of the data set's images; NaN: unknown, or no splat is
     * visible to any camera. */
    double place_pixels;
    int rendered; /* number of the frame that was rendered for psnr; -1: none */
    /* PSNR in dB of this frame rendered from the output, against its render from the bundle;
     * INFINITY: identical; NaN: not measured. */
    double psnr;
};

/* Result of spin-export --decimate: numbers of splats, and the loss of quality. */
struct spin_decimated {
    /* Numbers of splats before and after the decimation: the mean over frames, or of the whole clip
     * if in_all is true. `before` excludes splats that other options drop, and is 0 without
     * --decimate. */
    double before, after;
    /* Number of splats whose values were merged into others, in each frame; the rest of before -
     * after was dropped. */
    size_t merged;
    /* True: `before` and `after` are numbers of the whole clip. This is so for 4D splats, and for
     * splats that all frames share if filters drop some of them in some frames only. */
    bool in_all;
    /* True: the splats were ranked by their contribution to the data set's views; false: by opacity
     * and size. */
    bool by_views;
    int n_pictures; /* rendered images that were compared; 0: none shows a splat */
    /* PSNR in dB over the compared images: renders of the kept splats against renders of all
     * splats; INFINITY: identical. */
    double psnr;
    int n_tries;      /* outputs written until one had the requested size; 0: no size requested */
    uint64_t reached; /* bytes of the output, if a size was requested */
};

/* Why spin-export leaves out a splat. If several reasons apply, the first of this list is reported.
 */
enum spin_row_reason {
    SPIN_ROW_KEPT,
    /* The next four reasons are options of spin-export. The first three options do not apply to
     * splats with a NaN or infinite position: these are dropped as SPIN_ROW_NOT_FINITE. */
    SPIN_ROW_CROP,
    SPIN_ROW_MIN_VIEWS,
    SPIN_ROW_FLOATERS,
    SPIN_ROW_BACKDROP, /* --backdrop off */
    /* The next three reasons: viewers cannot draw the splat, or it would cover the whole scene. */
    SPIN_ROW_NOT_FINITE,
    SPIN_ROW_NO_ROTATION, /* the rotation has length zero */
    SPIN_ROW_TOO_LARGE,   /* --max-scale */
    /* The last two are options of spin-export. */
    SPIN_ROW_MIN_OPACITY,
    SPIN_ROW_DECIMATE,
    SPIN_ROW_REASONS
};

struct spin_export_report {
    int frames;
    double splats_mean;
    uint64_t bytes; /* 0: unknown */
    /* Numbers of splats that are left out, summed over all frames; 4D splats count once. dropped:
     * by reason. left_out: the sum for the reasons NOT_FINITE, NO_ROTATION and TOO_LARGE. filtered:
     * the sum for the other reasons except DECIMATE. Exporters do not set these members. */
    uint64_t dropped[SPIN_ROW_REASONS];
    uint64_t left_out, filtered;
    /* True: some frames keep other rows than the first frame. Exporters do not set this member. */
    bool rows_differ;
    struct spin_export_check check;
    struct spin_decimated decimated;
    uint64_t images; /* images that the exporter rendered and wrote; 0 for most exporters */
};

/* The arguments of an exporter's begin(). All pointers stay valid until end() or abort() returns;
 * the caller owns the memory. */
struct spin_export_job {
    const char *output; /* as given by the user */
    bool force;         /* overwrite existing files */
    bool sync;          /* copy this to `sync` of every struct spin_out that the exporter opens */
    int n_frames;       /* frames to export */
    double fps;         /* 0: unknown */
    const char *source; /* name of the method that the clip was imported from */
    int sh_degree;      /* SH degree of the exported splats */
    bool antialias;     /* true: the splats must be rendered with antialiasing */
    const struct spin_plugin_values *values;
    const struct spin_views *views; /* NULL: the data set is not available */
    const int *dataset_frame_of;    /* [n_frames] index of each frame in the data set, or -1 */
    struct spin_renderer *renderer; /* NULL unless the exporter sets needs_renderer */
    const float *background;        /* [3] */
    /* True for --background none: render images with alpha. Always false if the exporter does not
     * set `alpha`. */
    bool transparent;
    int n_threads; /* 0: all processors */
    /* Reads the source splats of a frame, for comparisons with the retrained splats. NULL unless
     * the bundle contains both. source_of: first argument of the function. */
    spin_status (*source_frame)(void *source_of, int frame, struct spin_splats *out);
    void *source_of;
    int source_sh_degree;
    bool source_antialias;
    bool retrained; /* true: the attributes were retrained, not imported */
    /* [n_frames] number of splats of each frame, including splats that viewers cannot draw; NULL:
     * unknown */
    const size_t *counts;
    bool counts_are_bounds; /* true: `counts` are upper bounds, since options drop splats */
    /* The exporter adds to `bytes` and `images` of the report, and sets `frames` if it exports only
     * some frames. left_out and rows_differ have their final values when end() is called. The
     * pointer may be NULL. */
    struct spin_export_report *report;

    /* True: end() must read back its files and fill report->check. Always false if the exporter
     * does not set `checks`. */
    bool check;
    /* Sets *out to the splats of a frame, 0..n_frames-1, for checks and for exporters that need all
     * frames in begin(). The splats stay valid until the next call of again() or frame(). context:
     * first argument of the function. */
    spin_status (*again)(void *context, int frame, const struct spin_splats **out);
    void *context;

    const double *times; /* [n_frames] time of each frame, in the source's unit */
    /* The clip as 4D splats, in the time unit of `times`. NULL: the clip consists of frames, or the
     * exporter does not set `splats_4d`. */
    const struct spin_splats_4d *splats_4d;
    double stride; /* mean difference between successive frame numbers; 0 means 1 */

    /* The next four members describe how the frames are paired with those of the data set. An
     * exporter can store them in its output for programs that import the output again. */
    const int *source_index; /* [n_frames] index of each frame in the source clip; NULL: unknown */
    int n_source_frames;     /* number of frames of the source clip */
    bool numbered;           /* true: frame numbers come from the source, not from counting */
    const char *pair;        /* value of spin-import --pair; "" or NULL: not given */
    /* The data set: its folder, as an absolute path, and the importer that reads it; NULL: none. */
    const char *data;
    const char *data_from;
    bool identity; /* row i is the same splat in every frame, unless report->rows_differ */

    const int *numbers; /* [n_frames] number of each frame, see struct spin_frame_info */
    /* The sound track, whose `start` is relative to the first exported frame; NULL: none, or the
     * exporter does not set `sound`. If it is not NULL, `fps` is known. */
    const struct spin_sound *sound;
    const double *up; /* [3] unit vector that points up; NULL: unknown */
};

struct spin_frame_info {
    int number;  /* frame number in the source, or the index if the source has no numbers */
    double time; /* time of the frame, in the source's unit */
    size_t n;    /* number of splats; 0: unknown */
};

struct spin_exporter {
    int abi;
    const char *name, *summary;
    const struct spin_plugin_option *options;
    unsigned wants; /* required columns */
    bool checks;    /* true: the exporter supports job->check */
    /* True: the output can record that its splats must be rendered with antialiasing, or consists
     * of images, which are rendered with antialiasing. False: this information is lost. */
    bool antialias;
    /* True: the exporter accepts clips of 4D splats in job->splats_4d, for which frame() is not
     * called. If `frame` is NULL, the exporter accepts only such clips. */
    bool splats_4d;
    bool needs_renderer; /* true: the exporter uses job->renderer */
    bool alpha;          /* true: the exporter supports job->transparent */
    bool looks_at_views; /* true: the exporter uses job->views, so the data set is opened */
    /* Formats of sound that the exporter supports: types of struct spin_sound separated by spaces,
     * such as "wav opus", or "all". NULL: the exporter cannot store sound. */
    const char *sound;

    /* After a successful begin(), exactly one of end() and abort() is called. Output files must
     * appear under their final names only when they are complete (see struct spin_out). */
    spin_status (*begin)(const struct spin_export_job *job, void **self);
    spin_status (*frame)(void *self, int frame, const struct spin_frame_info *info,
                         const struct spin_splats *splats);
    spin_status (*end)(void *self);
    void (*abort)(void *self);
};

/* An output file that appears under its name only when complete. It is written under a unique name
 * in the same folder, path.tmp.*, and spin_out_commit() renames it to `path` if all writes and the
 * close succeeded. Write with spin_out_write() or with stdio on `file`; spin_out_commit() detects
 * the errors of both. Exactly one of spin_out_commit() and spin_out_abandon() must be called; it
 * frees the contents of the struct.
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
/* Without force, fails with SPIN_E_IO ("... exists; use --force to overwrite") if path exists, even
 * as a dangling link, and spin_out_commit() does not replace a file that another process has
 * created in the meantime. Files that the program has read as input are never replaced, even with
 * force. */
spin_status spin_out_open(const char *path, bool force, struct spin_out *out);
spin_status spin_out_write(struct spin_out *out, const void *data, size_t bytes);
spin_status spin_out_commit(struct spin_out *out);
void spin_out_abandon(struct spin_out *out);

/* Creates a folder and its missing parents, like mkdir -p. */
spin_status spin_folder_make(const char *path);

/* A plug-in built outside this tree is a shared library that defines an object of this type with
 * the name spin_plugin, see spin-plugin(7). abi is the first member in all versions. */
struct spin_plugin {
    int abi;                                      /* SPIN_PLUGIN_ABI */
    const struct spin_importer *const *importers; /* NULL-terminated; or NULL */
    const struct spin_exporter *const *exporters; /* NULL-terminated; or NULL */
};
extern SPIN_VISIBLE const struct spin_plugin spin_plugin;

/* The built-in importers and exporters, NULL-terminated, in alphabetical order. */
extern const struct spin_importer *const spin_importers[];
extern const struct spin_exporter *const spin_exporters[];

/* Loads the plug-ins in the environment variable SPIN_PLUGIN_PATH, a list of shared objects and
 * folders separated by colons. spin_importer_list() and spin_exporter_list() call this function
 * with NULL, so call it first to pass a name; later calls do nothing. Plug-ins that fail to load
 * are skipped with a warning, except the one named `chosen`, whose error the caller reports; NULL:
 * warn about all. */
void spin_plugins_load(const char *chosen);
/* All importers and exporters, the built-in ones first, NULL-terminated. */
const struct spin_importer *const *spin_importer_list(void);
const struct spin_exporter *const *spin_exporter_list(void);

/* The path of the shared object that defines this importer or exporter; NULL: it is built in. */
const char *spin_plugin_origin(const void *plugin);
/* The reason why the plug-in `name`, or the shared object name.so, failed to load; NULL if it did
 * not fail. */
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
/* Fills the columns of a frame. SPIN_FROM_BEST reads the retrained splats if there are any, else
 * the refined splats if they have all attributes, else the source splats. The numbers of retrained,
 * refined and source splats may differ. Fails with SPIN_E_NOT_FOUND if the bundle lacks one of the
 * columns; if it contains only positions, spin-retrain adds the other columns. */
spin_status spin_scene_read(struct spin_scene *scene, int frame, enum spin_splat_source from,
                            unsigned columns, struct spin_splats *out);

/* ---- 6. Rendering ---------------------------------------------------------------------------- */

/* Renders one view of splats that have all attribute columns. image: [3][h][w]. */
spin_status spin_render(struct spin_renderer *r, const struct spin_splats *splats,
                        const struct spin_camera *camera, const float background[3], float *image);

/* Copies layers of the image that was rendered last. alpha: NULL, or [h][w], 0..1, which receives 1
 * minus the transmittance of all splats. depth: NULL, or [2][h][w], which receives two depths along
 * the camera's axis in world units: the expected depth (the mean weighted by contribution) and the
 * median depth, at which the transmittance falls to one half. A depth of 0 means that nothing is
 * visible. */
spin_status spin_render_layers(struct spin_renderer *r, float *alpha, float *depth);

/* Loads an image into out, planar [3][h][w] float 0..1, for exporters that render. If the size of
 * the image differs from width x height, it is resized with a box filter. Transparent pixels are
 * blended over the background; NULL: black. */
spin_status spin_image_load(const char *path, int width, int height, const float background[3],
                            float *out);
/* Saves an image as PNG. sync: see struct spin_out. */
spin_status spin_image_save(const char *path, int width, int height, const float *image, bool sync);

/* ---- 7. Calls and programs ------------------------------------------------------------------- */

/* Half-open range of frame numbers, as given by --range A:B:STEP; {0} means all frames. */
struct spin_range {
    bool given;
    int first, last, step;
};

/* Which views an evaluation measures. OUTER: test views whose camera is more than 3 degrees outside
 * the cone that the training cameras span around the subject. These views show how well a clip
 * extrapolates. */
enum spin_split { SPIN_SPLIT_TEST, SPIN_SPLIT_TRAIN, SPIN_SPLIT_ALL, SPIN_SPLIT_OUTER };

/* How an evaluation decides which pixels are dynamic, so that it can measure them separately. */
enum spin_dynamic_from {
    SPIN_DYNAMIC_AUTO,   /* masks if every view has one, else images */
    SPIN_DYNAMIC_MASKS,  /* the data set's foreground masks */
    SPIN_DYNAMIC_IMAGES, /* pixels that differ from the median of their camera's images over time */
    SPIN_DYNAMIC_OFF
};

/* Installs a handler for SIGBUS, which is raised by reading from a mapped file that another process
 * has truncated. The handler prints one line that begins with `command` and names the file, removes
 * partial output, and ends the process with exit code 1. Only programs should call this; without
 * the handler, the signal kills the process. */
void spin_catch_cut_files(const char *command);

/* The next four functions are for programs that MPI's mpirun starts as several processes. The
 * processes share the work of one call of a function of spin_run.h; only rank 0 returns the report.
 * A process started without mpirun is rank 0 of 1 and does not load MPI. */

/* The rank of this process, from its environment variables; -1: not started by mpirun. May be
 * called before spin_ranks_begin(). */
int spin_ranks_env_rank(void);
/* Joins the other ranks. Call this before the shared call, in the same thread. */
spin_status spin_ranks_begin(void);
/* Call this after the shared call, with the status that it returned. Returns this status, or the
 * failure of another rank. *speaks is set to true if this process must print the report or the
 * error. */
spin_status spin_ranks_end(spin_status status, bool *speaks);
/* Call this last, after all output is printed. If code is not 0, terminates the other ranks in case
 * they wait for this one. */
void spin_ranks_exit(int code);

#ifdef __cplusplus
}
#endif
#endif
