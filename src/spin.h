/* spin.h - the public header of spin4d, and the map of the source. The calls behind
 * the commands are in spin_run.h.
 *
 *     the commands  ->  one library  <-  importers and exporters, one file each
 *
 *   src/base      errors, memory, log and progress, threads, text; knows nothing of splats
 *   src/io        bytes to arrays and back: files, zip, npy, checkpoints, JSON, images
 *   src/formats   splats in files of others: 3DGS PLY, compressed PLY, SPZ, SOG, .splat, .ksplat, .splat4d, .4dgs,
 *                 GLB
 *   src/scene     splats of a frame, data sets, clips, the *.spin bundle, plug-ins
 *   src/math      every formula once, each with its derivative; headers that C and CUDA share
 *   src/device    the operations of the method, and the devices that do them
 *   src/model     the network: layout, first values, forward and backward
 *   src/render    a view through the rasteriser; frames of a bundle as pictures
 *   src/train     the stages of a training: plan, frames, loop, output
 *   src/eval      metrics, dynamic regions, LPIPS, the report
 *   src/run       the calls of spin_run.h: import, retrain, evaluate, export, and a run to a clip
 *   src/cmd       the commands: parse, call the library, print; nothing else
 *   importers     foreign files in: one plug-in per file, listed in importers.c
 *   exporters     standard files out: one plug-in per file, listed in exporters.c
 *                 (others can be loaded at run time: part 4 below and spin-plugin(7))
 *
 * docs/architecture.md follows a mean from import to export.
 *
 * Conventions, written once. Quaternions are w, x, y, z. Matrices are row-major. Cameras look along
 * +z, x right, y down; w2c maps world to camera; the centre of the top-left pixel is (0.5, 0.5).
 * Images are planar [3][h][w] float, 0..1. Counts are n_, an index is the singular. Zero is the
 * default of every option field unless its line says otherwise.
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

/* What a caller could do about it. A function that can fail returns one of these and leaves a
 * one-line trail, outermost first, for spin_last_error(). */
typedef enum spin_status {
    SPIN_OK = 0,
    SPIN_E_USAGE,          /* asked wrongly: exit code 2 */
    SPIN_E_NOT_FOUND,      /* no such file, frame or name */
    SPIN_E_NOT_RECOGNISED, /* no importer knows this input */
    SPIN_E_MALFORMED,      /* the file lies or is cut short */
    SPIN_E_UNSUPPORTED,    /* well-formed, but we do not do it */
    SPIN_E_IO,             /* the disk or the system said no */
    SPIN_E_MEMORY,         /* not enough of it */
    SPIN_E_DEVICE,         /* the accelerator failed */
    SPIN_E_CANCELLED       /* spin_cancel() was called: exit code 130 or 143 */
} spin_status;

/* The trail of this thread's last failure, one line, no full stop; "" when there was none. */
const char *spin_last_error(void);

/* Start a new trail with this text and return code: lower case, no full stop, what failed, where
 * (file, array, line), why; names in 'quotes'. */
spin_status spin_fail(spin_status code, const char *fmt, ...) SPIN_PRINTF(2, 3);
/* With the codes that are said most. */
#define spin_misuse(...) spin_fail(SPIN_E_USAGE, __VA_ARGS__)
#define spin_not_found(...) spin_fail(SPIN_E_NOT_FOUND, __VA_ARGS__)
#define spin_malformed(...) spin_fail(SPIN_E_MALFORMED, __VA_ARGS__)
#define spin_unsupported(...) spin_fail(SPIN_E_UNSUPPORTED, __VA_ARGS__)

/* Put "text: " in front of the trail and return code. SPIN_OK and SPIN_E_CANCELLED are returned as
 * they are. */
spin_status spin_fail_context(spin_status code, const char *fmt, ...) SPIN_PRINTF(2, 3);

/* Return from this function when expr fails. */
#define SPIN_TRY(expr)                                                                             \
    do {                                                                                           \
        spin_status spin_try_ = (expr);                                                            \
        if (spin_try_ != SPIN_OK)                                                                  \
            return spin_try_;                                                                      \
    } while (0)

/* The same with "text: " in front of the trail. */
#define SPIN_TRY_IN(expr, ...)                                                                     \
    do {                                                                                           \
        spin_status spin_try_ = (expr);                                                            \
        if (spin_try_ != SPIN_OK)                                                                  \
            return spin_fail_context(spin_try_, __VA_ARGS__);                                      \
    } while (0)

/* Jump to out: with status set when expr fails. Needs a local `spin_status status`. */
#define SPIN_TRY_OUT(expr)                                                                         \
    do {                                                                                           \
        status = (expr);                                                                           \
        if (status != SPIN_OK)                                                                     \
            goto out;                                                                              \
    } while (0)

/* "warning: ..." as one line on stderr, without stopping. */
void spin_warn(const char *fmt, ...) SPIN_PRINTF(1, 2);

/* How much the library says on stderr: -1 warnings only, 0 normal, 1 per run ... 4 per op. */
void spin_set_verbosity(int level);

/* Ask running work to stop at the next safe point (async-signal-safe). */
void spin_cancel(void);

/* ---- 2. Splats of one frame ------------------------------------------------------------------ */

enum spin_column {
    SPIN_COL_MEANS = 1 << 0,           /* [n][3] centres, world units */
    SPIN_COL_QUATS = 1 << 1,           /* [n][4] w, x, y, z, unit length */
    SPIN_COL_LOG_SCALES = 1 << 2,      /* [n][3] natural log of the standard deviation */
    SPIN_COL_LOGIT_OPACITIES = 1 << 3, /* [n] before the sigmoid, finite */
    SPIN_COL_SH = 1 << 4,              /* [n][(sh_degree+1)^2][3] coefficients, channel last */
    SPIN_COL_RGB = 1 << 5,             /* [n][3] 0..1, of plain coloured points */
    SPIN_COL_ATTRIBUTES =              /* all that a Gaussian needs besides its place */
    SPIN_COL_QUATS | SPIN_COL_LOG_SCALES | SPIN_COL_LOGIT_OPACITIES | SPIN_COL_SH
};

/* A structure of arrays. Columns are NULL or hold n rows. The struct owns its memory: zero it, let
 * spin_splats_reserve() grow it as often as needed, free it once. */
struct spin_splats {
    size_t n;               /* rows */
    size_t capacity;        /* rows there is room for in every allocated column */
    int sh_degree;          /* of the sh column, 0..3 */
    bool antialias;         /* meant to be drawn antialiased */
    float *means;           /* [n][3] */
    float *quats;           /* [n][4] or NULL */
    float *log_scales;      /* [n][3] or NULL */
    float *logit_opacities; /* [n] or NULL */
    float *sh;              /* [n][(sh_degree+1)^2][3] or NULL */
    float *rgb;             /* [n][3] or NULL */
    bool mapped;            /* the columns lie in a file's map: to be read only, and not owned */
    size_t held[6];         /* private: bytes behind each column */
};

/* Set n and sh_degree, antialias to false, and make the wanted columns at least that large; others
 * become NULL-valued only if they were never asked for. Contents are not kept. SPIN_E_MEMORY. */
spin_status spin_splats_reserve(struct spin_splats *s, size_t n, unsigned columns, int sh_degree);
void spin_splats_free(struct spin_splats *s);
/* The rows of s that are marked with 1, with all columns but rgb, into *out. */
spin_status spin_splats_take(const struct spin_splats *s, const unsigned char *mark,
                             struct spin_splats *out);

/* Splats that have a path and a window in time instead of a row in every frame. At time t, with d =
 * t - times[i], row i is a splat with
 *
 *     place      centres + paths[0] d + paths[1] d^2 + paths[2] d^3
 *     rotation   quats + d spins, of unit length
 *     scale      log_scales
 *     opacity    sigmoid(logit_opacities) w(t)
 *     colour     sh + cos(2 pi d / period) sh_cos[0] + cos(4 pi d / period) sh_cos[1]
 *
 * where w is exp(-0.5 (d / sigmas)^2), a bell. With a plateau lo, hi, sigma2 it is 1 from lo to hi,
 * half a bell of sigmas before lo and one of sigma2 after hi; with a gate g it is g + (1 - g) w;
 * with cuts first, end it is 0 outside [first, end). Times are in the unit of the clip's frames
 * (struct spin_frame_info).
 *
 * What is NULL is left out. A frame is a slice: the rows that its time shows, in their order. The
 * struct owns its memory: zero it, reserve once, settle when filled, free. */
struct spin_splats_4d {
    size_t n;
    int degree;           /* of the paths, 0..3 */
    int sh_degree;        /* 0..3 */
    bool antialias;       /* meant to be drawn antialiased */
    double least_weight;  /* a time shows a row when w is at least this, */
    double least_opacity; /* and its opacity then at least that */
    double period;        /* of sh_cos */
    double
        cov2d[2]; /* factors on the covariance on screen that the model was trained with; 0: none */
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
    double *spans;          /* private: [n][2] times that show a row, both ends included */
};
#define SPIN_FOREVER 3e38f

enum spin_splats_4d_part { /* those that may be left out, but paths */
                           SPIN_4D_SPINS = 1 << 0,
                           SPIN_4D_PLATEAUS = 1 << 1,
                           SPIN_4D_CUTS = 1 << 2,
                           SPIN_4D_GATES = 1 << 3,
                           SPIN_4D_SH_COS = 1 << 4
};
/* Sets n and the degrees, and makes all arrays, of zeros. */
spin_status spin_splats_4d_reserve(struct spin_splats_4d *s, size_t n, int degree, int sh_degree,
                                   unsigned parts);
void spin_splats_4d_free(struct spin_splats_4d *s);
/* The arrays of 4D splats, as those of a frame with each in its own place: nothing to free. */
struct spin_splats spin_splats_of_4d(const struct spin_splats_4d *s);
/* When all rows are filled: rows with values that are not finite or far out of range, without a
 * rotation or a sigma go, the others keep their order and get quats of unit length. from: NULL, or
 * [n], gets the place each had. */
spin_status spin_splats_4d_settle(struct spin_splats_4d *s, size_t *n_dropped, size_t *from);
/* Fills the columns with the rows that `time` shows. */
spin_status spin_splats_4d_slice(const struct spin_splats_4d *s, double time, unsigned columns,
                                 struct spin_splats *out);
/* Whether a time shows row i; w there. */
bool spin_splats_4d_shows(const struct spin_splats_4d *s, size_t i, double time);
double spin_splats_4d_weight(const struct spin_splats_4d *s, size_t i, double time);
/* How many rows each of n times shows. */
spin_status spin_splats_4d_counts(const struct spin_splats_4d *s, const double *times, size_t n,
                                  size_t *counts);

/* ---- 3. Cameras and views -------------------------------------------------------------------- */

/* The near plane of 3DGS, world units. */
#define SPIN_NEAR 0.2

struct spin_camera {
    int width, height;     /* pixels */
    double fx, fy, cx, cy; /* pixels; centre of the top-left pixel is 0.5, 0.5 */
    double w2c[12];        /* [3][4], p_c = R p_w + t; R orthonormal, det +1 */
    double z_near;         /* splats at this depth or nearer are not drawn; 0: SPIN_NEAR */
};

/* One image of a data set. */
struct spin_view {
    struct spin_camera camera;
    int dataset_frame; /* frame of the data set, 0.. */
    int number;        /* frame number in its file name, or -1 */
    double time;       /* in the data set's unit (panoptic: dataset_frame) */
    int camera_id;     /* the data set's own number of the camera */
    bool test;         /* held out */
    char *path;        /* image file, absolute or relative to the working directory */
    char *mask;        /* image of the foreground, 0 elsewhere; NULL: none */
};

/* All views of a data set, sorted by dataset_frame, then camera_id. */
struct spin_views {
    struct spin_view *view; /* [n] */
    size_t n, capacity;
    int n_dataset_frames;
    bool numbered;   /* every view has a frame number, one per frame */
    char notes[512]; /* what was guessed or will be lost, lines; "" */
};

/* Append a copy of v (path and mask are copied). */
spin_status spin_views_add(struct spin_views *views, const struct spin_view *v);
void spin_views_free(struct spin_views *views);

/* ---- 4. Plug-ins ----------------------------------------------------------------------------- */

/* A plug-in may call the functions of parts 1 to 4 and of part 6; src/plugin.sym lists them. */

#define SPIN_PLUGIN_ABI 7

/* One row of a plug-in's own options: `--key value`. The table ends with key == NULL. */
struct spin_plugin_option {
    const char *key; /* without the dashes */
    const char *arg; /* word for the value, NULL for a switch */
    const char *help;
    const char *fallback; /* value when not given, or NULL */
};

/* Values given by the user, NULL-terminated pairs key, value; may be NULL. */
struct spin_plugin_values {
    const char *const *pairs;
};
/* The value of key, else fallback. */
const char *spin_plugin_value(const struct spin_plugin_values *v, const char *key,
                              const char *fallback);

/* What probe() sees: never more than this. */
struct spin_peek {
    const char *path;
    bool is_folder;
    /* First bytes, at most 16384, of a file, or of the first of cfg_args, chkpnt*, deformation.pth
     * and point_cloud.ply that a folder has. */
    const unsigned char *head;
    size_t n_head;
    const char *tail_names;   /* zip archives, and params.npz of a folder: member names, one per
                                 line; else "" */
    const char *const *names; /* folders: entries, sorted, at most 4096; NULL-terminated */
};

/* Filled by an importer's open(). Pointers belong to the importer until close(). */
struct spin_sequence_info {
    int n_frames;
    const double *times;     /* [n_frames] in the method's unit; NULL: 0, 1, 2, ... */
    const int *numbers;      /* [n_frames] frame numbers from file names; NULL: none */
    const size_t *counts;    /* [n_frames] rows of each frame; NULL: not known before reading */
    unsigned columns;        /* what frame() can fill */
    unsigned static_columns; /* the part of it that is the same in every frame */
    bool identity;           /* row i is the same Gaussian in every frame */
    int sh_degree;           /* -1: no SH */
    bool antialias;          /* its splats were trained to be drawn antialiased */
    bool continuous;         /* any time may be asked for, in [time_first, time_last] */
    double time_first, time_last;
    int n_clip_frames;  /* of a continuous one, that its clip has; 0: it does not say */
    double fps;         /* frames a second of the clip; 0: not known */
    bool half_open;     /* frame i of n of a data set without times is at i/n of it, not i/(n-1) */
    bool counts_frames; /* time t is frame t: frame i of a data set is at i, whatever its times */
    char variant[128];  /* what was recognised, for --info */
    char notes[1024];   /* what was guessed or will be lost, lines; "" */
};

struct spin_importer {
    int abi;              /* SPIN_PLUGIN_ABI */
    const char *name;     /* what the user types after --from */
    const char *summary;  /* one line for --list */
    const char *upstream; /* project and commit whose files it was written against */
    const struct spin_plugin_option *options;

    /* How sure, 0..100, that this input is ours. May not open or allocate. */
    int (*probe)(const struct spin_peek *peek);

    /* Tracks. open() reads what is cheap; frame() fills the wanted columns of one frame, calling
     * spin_splats_reserve(); `time` counts only when the track is continuous. frame() may be called
     * in any order, as often as asked, by one thread at a time. close() also follows a failed
     * open() that had set *self. NULL open: no tracks. */
    spin_status (*open)(const char *path, const struct spin_plugin_values *values, void **self,
                        struct spin_sequence_info *sequence);
    spin_status (*frame)(void *self, int frame, double time, unsigned columns,
                         struct spin_splats *out);
    void (*close)(void *self);

    /* The same as 4D splats, where that is what it has: settled, and the importer's until close().
     * *out is NULL when this input has none. */
    spin_status (*splats_4d)(void *self, const struct spin_splats_4d **out);

    /* Views: append every view of the data set in folder `path`. NULL: no views. */
    spin_status (*views)(const char *path, const struct spin_plugin_values *values,
                         struct spin_views *out);
};

struct spin_renderer;

/* What a check found over all frames: how far a reader of the files is from the bundle. */
struct spin_export_check {
    int frames; /* read back; 0: not asked for */
    uint64_t splats;
    double bounds;             /* the most that a side of a frame's box is off by, world units */
    double rms[6], largest[6]; /* place, log scale, rotation (degrees), opacity, colour, SH */
    uint64_t sh_lost;          /* splats with SH of a degree that the format does not hold */
    double place_sizes;        /* the most that a place is off by, of the splat's largest standard
                                * deviation; NaN: unknown */
    double place_pixels; /* in pictures of the data set; NaN: no camera sees a splat, or unknown */
    int rendered;        /* number of the frame that was rendered from its file; -1: none */
    double psnr; /* dB against the bundle's own render; infinite: the same picture; NaN: none */
};

/* What spin-export --decimate left out, and what that loses. */
struct spin_decimated {
    /* Splats of a frame in the mean, or of the clip: without what is left out in any case. before
     * is 0: it was not asked for. */
    double before, after;
    bool in_all;      /* of the clip: 4D splats, or rows that filters leave out in some frames */
    bool by_views;    /* cameras of the data set saw what counts; else opacities and sizes do */
    int n_pictures;   /* 0: no splat is in any picture */
    double psnr;      /* dB of all pictures together, against all splats; infinite: the same */
    int n_tries;      /* outputs written to find a size; 0: none */
    uint64_t reached; /* bytes of the whole output, where a size was asked for */
};

struct spin_export_report {
    int frames;
    double splats_mean;
    uint64_t bytes;    /* 0: unknown */
    uint64_t left_out; /* splats that no viewer could draw, over all frames */
    uint64_t
        filtered; /* left out by --crop, --min-views and --floaters; not an exporter's to set */
    struct spin_export_check check;
    struct spin_decimated decimated;
    uint64_t images; /* drawn and written, by an exporter that draws; else 0 */
};

/* What an exporter is told before the first frame. Everything is borrowed until end() or abort().
 */
struct spin_export_job {
    const char *output; /* as the user gave it */
    bool force;         /* may overwrite */
    bool sync;          /* of every struct spin_out */
    int n_frames;       /* that will come */
    double fps;         /* 0: unknown */
    const char *source; /* name of the method the clip came from */
    int sh_degree;      /* of the splats that will come */
    bool antialias;     /* they are meant to be drawn antialiased */
    const struct spin_plugin_values *values;
    const struct spin_views *views; /* NULL when the bundle has no data set at hand */
    const int *dataset_frame_of;    /* [n_frames] the data set's row of each frame, or -1 */
    struct spin_renderer *renderer; /* set when the exporter has needs_renderer */
    const float *background;        /* [3] */
    bool transparent; /* --background none: what is drawn has alpha; else it is refused */
    int n_threads;    /* 0: all */
    /* The same frame as it was imported, when the bundle holds that beside the network whose splats
     * come; NULL: there is nothing to compare with. */
    spin_status (*source_frame)(void *source_of, int frame, struct spin_splats *out);
    void *source_of;
    int source_sh_degree;
    bool source_antialias;
    bool retrained;                    /* the attributes are the network's */
    const size_t *counts;              /* [n_frames] splats of each frame, or NULL */
    struct spin_export_report *report; /* an exporter adds to bytes, left_out and images, and
                                        * says how many frames when it takes some only; or NULL */

    /* Read back what was written, in end(), and say in report->check what was found; only asked of
     * an exporter that `checks`. again() gives a frame, 0..n_frames-1, until its next call or that
     * of frame(): once more for a check, or in begin() for an exporter that looks at all frames
     * first. */
    bool check;
    spin_status (*again)(void *context, int frame, const struct spin_splats **out);
    void *context;

    const double *times; /* [n_frames] of the frames, in the source's unit */
    /* The clip, for exporters with splats_4d; NULL: it is frames. Times are those of `times`. */
    const struct spin_splats_4d *splats_4d;
    double stride; /* frame numbers from one frame to the next, on average; 0: as 1 */

    /* How the frames are paired with a data set, for who imports them again. */
    const int *source_index; /* [n_frames] place of each in the whole source clip; NULL: unknown */
    int n_source_frames;     /* of that clip */
    bool numbered;           /* frame numbers are the source's own */
    const char *pair;        /* as spin-import --pair; "" or NULL: nothing was said */
    const char *data;        /* the data set's folder, absolute, and who reads it; NULL: none */
    const char *data_from;
    bool identity; /* row i is the same splat in every frame */

    const int *numbers; /* [n_frames] of the frames, as in struct spin_frame_info */
};

struct spin_frame_info {
    int number;  /* the source's frame number (its index when it has none) */
    double time; /* in the source's unit */
    size_t n;    /* splats, when known */
};

struct spin_exporter {
    int abi;
    const char *name, *summary;
    const struct spin_plugin_option *options;
    unsigned wants; /* columns it cannot do without */
    bool checks;    /* can read back what it wrote */
    bool antialias; /* what it writes says, or shows, when splats are meant to be drawn antialiased
                     */
    bool splats_4d; /* where the clip is 4D splats they are used, and no frame comes; without
                     * `frame` it takes nothing else */
    bool needs_renderer;
    bool alpha;          /* knows job->transparent */
    bool looks_at_views; /* job->views are used; else the data set is not opened */

    /* Exactly one of end() and abort() follows a successful begin(). Files appear under their
     * final name only when whole. */
    spin_status (*begin)(const struct spin_export_job *job, void **self);
    spin_status (*frame)(void *self, int frame, const struct spin_frame_info *info,
                         const struct spin_splats *splats);
    spin_status (*end)(void *self);
    void (*abort)(void *self);
};

/* A file that appears under its name only when whole: written under a name of its own beside it,
 * path.tmp.*, and renamed by commit when all writing and closing has succeeded. Write with
 * spin_out_write() or with stdio on `file`; commit sees errors of both. Either commit or abandon
 * must follow; both free it.
 *
 * What could not be made again soon sets `sync` after opening: commit then waits for the disk
 * before it renames. Without, a file is whole after a kill or on a full disk as well, but not
 * surely after the power failed. */
struct spin_out {
    FILE *file;
    char *path, *temporary;
    uint64_t bytes; /* given to spin_out_write() */
    bool sync;
    bool force; /* as it was opened */
};
/* !force: SPIN_E_IO when path exists ("... exists; use --force to overwrite"), a link to nothing as
 * well. Commit looks once more: what somebody else made meanwhile stays. An input is never
 * replaced. */
spin_status spin_out_open(const char *path, bool force, struct spin_out *out);
spin_status spin_out_write(struct spin_out *out, const void *data, size_t bytes);
spin_status spin_out_commit(struct spin_out *out);
void spin_out_abandon(struct spin_out *out);

/* mkdir -p */
spin_status spin_folder_make(const char *path);

/* What a shared object built outside the tree defines under the name spin_plugin; spin-plugin(7) is
 * the guide. The abi stays the first member in every version. */
struct spin_plugin {
    int abi;                                      /* SPIN_PLUGIN_ABI */
    const struct spin_importer *const *importers; /* NULL-terminated; or NULL */
    const struct spin_exporter *const *exporters; /* NULL-terminated; or NULL */
};
extern SPIN_VISIBLE const struct spin_plugin spin_plugin;

/* Those built in, NULL-terminated, alphabetical. */
extern const struct spin_importer *const spin_importers[];
extern const struct spin_exporter *const spin_exporters[];

/* Load what SPIN_PLUGIN_PATH names: shared objects and folders of them, with colons between. Done
 * once, by the first of these three; nothing is loaded from anywhere else. What cannot be taken is
 * left out with a warning, but for a plug-in that is called `chosen` (or NULL): the caller reports
 * that one. */
void spin_plugins_load(const char *chosen);
/* Those built in, then those loaded, NULL-terminated. */
const struct spin_importer *const *spin_importer_list(void);
const struct spin_exporter *const *spin_exporter_list(void);

/* The shared object that defines this importer or exporter; NULL: built in. */
const char *spin_plugin_origin(const void *plugin);
/* Why the plug-in of this name, or the object name.so, was left out; NULL: none was. */
const char *spin_plugin_fault(const char *name);

/* ---- 5. A clip: the *.spin bundle ------------------------------------------------------------ */

struct spin_scene;

enum spin_splat_source { SPIN_FROM_BEST, SPIN_FROM_SOURCE, SPIN_FROM_TRAINED, SPIN_FROM_REFINED };

spin_status spin_scene_open(const char *path, struct spin_scene **out);
void spin_scene_close(struct spin_scene *scene);
int spin_scene_n_frames(const struct spin_scene *scene);
const struct spin_frame_info *spin_scene_frame(const struct spin_scene *scene, int frame);
bool spin_scene_is_trained(const struct spin_scene *scene);
unsigned spin_scene_columns(const struct spin_scene *scene); /* of the source */
/* Fill the columns of a frame. BEST: from the network when there is one, else from refined splats
 * that have all attributes, else from the source. A frame may have another number of splats in
 * each. SPIN_E_NOT_FOUND when the columns are not there (positions only: run spin-retrain). */
spin_status spin_scene_read(struct spin_scene *scene, int frame, enum spin_splat_source from,
                            unsigned columns, struct spin_splats *out);

/* ---- 6. Drawing ------------------------------------------------------------------------------ */

/* Draw one view of splats that have all attribute columns. image: [3][h][w]. */
spin_status spin_render(struct spin_renderer *r, const struct spin_splats *splats,
                        const struct spin_camera *camera, const float background[3], float *image);

/* Of the picture drawn last: what the splats hide of the background, [h][w], 0..1; and their depth
 * along the camera's axis in world units, [2][h][w]: the expected one, which is the mean by what
 * each adds to the picture, and the median, at which half of the light is held up. 0: there is
 * none. Either may be NULL. */
spin_status spin_render_layers(struct spin_renderer *r, float *alpha, float *depth);

/* Read an image, box-filtered to camera size when they differ, as planar [3][h][w] float 0..1
 * (out must hold it), and write one as PNG (sync: as of struct spin_out). For exporters that draw.
 * Transparent pixels show the background; NULL: black. */
spin_status spin_image_load(const char *path, int width, int height, const float background[3],
                            float *out);
spin_status spin_image_save(const char *path, int width, int height, const float *image, bool sync);

/* ---- 7. Calls and programs ------------------------------------------------------------------- */

/* Half-open frame numbers A:B:STEP; {0} means all. */
struct spin_range {
    bool given;
    int first, last, step;
};

enum spin_split { SPIN_SPLIT_TEST, SPIN_SPLIT_TRAIN, SPIN_SPLIT_ALL };

/* Which pixels count as dynamic when an evaluation measures dynamic regions apart. */
enum spin_dynamic_from {
    SPIN_DYNAMIC_AUTO,   /* masks where every view has one, else the images */
    SPIN_DYNAMIC_MASKS,  /* the data set's foreground masks */
    SPIN_DYNAMIC_IMAGES, /* pixels that differ from the median over time of their camera */
    SPIN_DYNAMIC_OFF
};

/* For programs: catch SIGBUS, which reading from a mapped file raises when somebody cuts it short.
 * One line that begins with `command` then names the file on stderr, what is half-written is
 * removed, and the process ends with exit code 1. Without this call the signal ends it. */
void spin_catch_cut_files(const char *command);

/* For programs that MPI's mpirun starts as several processes, which share the work of one call of
 * spin_run.h (rank 0 has the report). A process that was started alone is rank 0 of 1, and loads
 * nothing. */
/* This process's rank, as its environment says; -1: it was started alone. Good before the begin. */
int spin_ranks_place(void);
/* Before the call, in the thread that will make it: join the others. */
spin_status spin_ranks_begin(void);
/* After the call: with its status, or the failure of another rank. speaks: this process prints the
 * report, or the error. */
spin_status spin_ranks_end(spin_status status, bool *speaks);
/* When all is printed. With a code that is not 0 the other processes are ended, if they do not end
 * by themselves. */
void spin_ranks_exit(int code);

#ifdef __cplusplus
}
#endif
#endif
