/* spin_run.h - the calls behind the commands: their options and what they report. See spin.h. */
#ifndef SPIN_RUN_H
#define SPIN_RUN_H

#include "spin.h"

#ifdef __cplusplus
extern "C" {
#endif

/* For programs: catch SIGBUS, which reading from a mapped file raises when somebody cuts it short. One
 * line that begins with `command` then names the file on stderr, what is half-written is removed, and
 * the process ends with exit code 1. Without this call the signal ends it. */
void spin_catch_cut_files(const char *command);

/* For programs that MPI's mpirun starts as several processes, which share the work of one call below (rank 0 has
 * the report). A process that was started alone is rank 0 of 1, and loads nothing. */
/* This process's rank, as its environment says; -1: it was started alone. Good before the begin. */
int spin_ranks_place(void);
/* Before the call, in the thread that will make it: join the others. */
spin_status spin_ranks_begin(void);
/* After the call: with its status, or the failure of another rank. speaks: this process prints the report, or the
 * error. */
spin_status spin_ranks_end(spin_status status, bool *speaks);
/* When all is printed. With a code that is not 0 the other processes are ended, if they do not end by themselves. */
void spin_ranks_exit(int code);

/* Half-open frame numbers A:B:STEP; {0} means all. */
struct spin_range {
    bool given;
    int first, last, step;
};

struct spin_import_options {
    const char *input, *output;   /* output NULL: describe only */
    const char *from;             /* importer, NULL: detect */
    const char *data, *data_from; /* data set, or NULL */
    const char *pair;             /* "auto", "number" or "order"; NULL: auto */
    const char *frame_times; /* of the data set: "auto", "data", "unit" or "count"; NULL: auto */
    int n_frames;            /* continuous methods: sample this many; 0: not asked */
    const double *times;     /* continuous methods: sample here */
    int n_times;
    struct spin_range range;
    bool positions_only, force;
    bool sync;                       /* write the bundle to the disk (fsync) before it is renamed */
    bool full;                       /* describe: read every frame, not up to 16 of them */
    const char *check_cameras;       /* folder for PNGs of the points over data's images, or NULL */
    const char *const *plugin_pairs; /* see struct spin_plugin_values */
};

/* The calls below report what they did as a JSON document, malloc'ed; its keys are those of --json, which the
 * commands' manuals describe. Of several processes rank 0 has it. NULL: it is not wanted. */

/* Import a foreign run to a bundle, or only describe it. */
spin_status spin_import(const struct spin_import_options *o, char **report);

/* What a bundle holds and how it was made. Of its arrays only the headers are read. SPIN_E_NOT_RECOGNISED when the
 * file is no bundle. */
spin_status spin_bundle_describe(const char *path, char **report);

/* NETWORK: the method of the paper. EXPLICIT: every frame on its own, as 3DGS does it. TRACKS: as NETWORK, but
 * splats and tracks have explicit values only. */
enum spin_method { SPIN_METHOD_NETWORK, SPIN_METHOD_FRAMES, SPIN_METHOD_TRACKS };
/* What a splat has of its own, to which the network adds: nothing; scale from its neighbours and colour
 * of its source; all of its source's (or its refined frame's) attributes, SH up to degree 0. */
enum spin_residual { SPIN_RESIDUAL_OFF, SPIN_RESIDUAL_POINTS, SPIN_RESIDUAL_SOURCE };
/* Iterations that 0 in sh_increase_every means to the explicit method. */
enum { SPIN_SH_INCREASE_EVERY = 1000 };
enum spin_refine_start { SPIN_REFINE_FROM_POINTS, SPIN_REFINE_FROM_SOURCE };

/* AUTO: where cameras show the same points in different colours. */
enum spin_exposure { SPIN_EXPOSURE_OFF, SPIN_EXPOSURE_ON, SPIN_EXPOSURE_AUTO };

/* Centre and radius of the scene at the network's input. AUTO: median of the positions, and the distance that
 * holds 90% of them. NONE: as OFF, without the contraction; splats outside the unit cube share one set of
 * attributes. GIVEN: normalise_centre, normalise_radius. */
enum spin_normalise {
    SPIN_NORMALISE_OFF,
    SPIN_NORMALISE_AUTO,
    SPIN_NORMALISE_NONE,
    SPIN_NORMALISE_GIVEN
};

/* Of the values that a retraining writes. COMPACT: steps that pictures hardly show. HALF: about that of half floats.
 * FULL: to the bit. */
enum spin_precision { SPIN_PRECISION_COMPACT, SPIN_PRECISION_HALF, SPIN_PRECISION_FULL };

/* Defaults and limits of all numbers: spin-retrain(1). */
struct spin_retrain_options {
    const char *input, *output;
    const char *preset; /* where these began, for messages; or NULL */
    const char *data, *data_from, *pair;
    struct spin_range range;
    double image_scale;      /* 1: as stored */
    const int *test_cameras; /* NULL: the data set's own split */
    int n_test_cameras;
    enum spin_method method;
    int refine; /* iterations of every frame before the network, or instead */
    enum spin_refine_start refine_start; /* from coloured points, or from the source's attributes */
    bool densify;                        /* refining adds points; else it only prunes them */
    int max_points;                      /* of a frame while it is refined; 0: no limit */
    int iterations, batch;           /* iterations -n: n x (1500 + 100 x frames), -1 and -3 only */
    int levels, features, hash_log2; /* of the hash grid */
    int hidden, sh_degree;           /* width of the heads; of the colours */
    int base_resolution[4];          /* x y z t */
    int finest_resolution[4];        /* of t 0: max(16, frames) */
    double lambda_dssim;
    double lambda_scale, lambda_opacity; /* of the mean scale (in extents) and opacity */
    double dynamic_weight;               /* of pixels that show motion, relative to the others */
    bool antialias;                      /* draw antialiased, and so train */
    double hash_init_range;              /* first values of the table lie within */
    uint64_t seed;
    int warmup; /* iterations; -1: iterations / 40 */
    double lr_table, lr_sh, lr_scale, lr_rotation, lr_opacity, lr_position;
    int sh_increase_every; /* iterations until the next degree of SH joins; 0: all from the start, explicit: 1000 */
    enum spin_exposure learn_exposure; /* learn a gain and offset of every training camera */
    double lr_exposure;                /* their rate */
    double lr_head_factor;             /* on the four head rates */
    bool tracks;            /* learn once what frames share, where splats keep their identity */
    double lr_track;        /* on 3DGS's rates for what they share */
    double lr_tracked;      /* on lr_position and lr_residual, for splats that share something */
    double lr_displacement; /* of a shared displacement, times the extent */
    int track_iterations; /* the first ones, in which what is shared learns; -1: all, at most 5000 */
    bool dynamic_residual; /* splats that move have residual values of every frame as well */
    int densify_every; /* iterations between densifications; 0: none; -1: track_iterations / 20 */
    double densify_threshold, densify_until; /* of the mean gradient; share of track_iterations */
    double network_start;                    /* share of the iterations before the network joins */
    enum spin_residual residual;             /* what the network adds to */
    double lr_residual;    /* on 3DGS's rates for a splat's own values; 0: they stay */
    double init_log_scale; /* NaN: auto, log of the median distance to 3 neighbours */
    bool relu;             /* ReLU in the heads instead of GELU */
    enum spin_normalise normalise;
    double normalise_centre[3], normalise_radius; /* with SPIN_NORMALISE_GIVEN */
    int views_per_frame;                          /* of a batch taken from one frame */
    float background[3];
    enum spin_precision precision; /* of the output */
    const char *device;            /* "auto", "cpu" or "cuda" */
    int n_threads;                 /* 0: all */
    bool deterministic;            /* sums on a card repeat bit for bit; the CPU's always do */
    int eval_every, save_every;    /* iterations; 0: at the end; every 5 minutes */
    bool resume, force, dry_run;
    const char *preview, *log; /* folder, file; or NULL */
    const char
        *cache; /* folder of refined frames that runs share, and that stays; NULL: the run's own */
};

/* Those of the first preset. */
void spin_retrain_defaults(struct spin_retrain_options *o);
#define SPIN_PRESETS "quick|best|paper|short"
/* "quick": no network, but attributes that frames share, one image a step, densified, antialiased; as many iterations
 * as the clip's frames ask for. "best": the same with three times as many. "paper": the paper's settings, for hours on
 * an accelerator. "short": the paper's method for minutes of training on a CPU; frames are visited a hundred times
 * instead of thousands, so rates are higher, the views of a step share one evaluation of the network, and splats start
 * from known values. SPIN_E_USAGE when there is no such preset; then the options are those of "quick". */
spin_status spin_retrain_preset(const char *name, struct spin_retrain_options *o);

/* LPIPS networks, and the place of each in arrays. */
enum { SPIN_LPIPS_VGG, SPIN_LPIPS_ALEX, SPIN_N_LPIPS };

/* Means over views; what was not measured is NaN. */
struct spin_quality {
    bool valid;
    double psnr, ssim, psnr_channel_mean;
    double psnr_colour_fitted; /* after one gain and offset a channel were fitted to the camera's photographs */
    double psnr_dynamic,
        psnr_static; /* in and outside the dynamic regions, of views that have both */
    double dynamic;  /* share of the pixels */
    double lpips[SPIN_N_LPIPS];
};

struct spin_retrain_report {
    struct spin_retrain_options
        options; /* as given, with the numbers that were chosen for the clip */
    int iterations;
    int densify_every; /* iterations between densifications of the clip; 0: none */
    double seconds, seconds_per_iteration; /* NAN: no frame was left to refine, and nothing else done */
    int frames;
    double splats_mean;
    char device[64];
    struct spin_quality before, refined, test;
    double refine_seconds;                /* part of seconds */
    double outside_ball;                  /* share of points outside the unit ball at the encoder */
    size_t bytes_needed, bytes_available; /* available 0: it is not known */
    char fitting[96];  /* options that would fit, when these do not; empty: none were found */
    size_t bytes_peak; /* of this process, when the work is done */
    double seconds_estimated; /* dry run */
    int ranks;                /* processes that share the work */
    double bytes_sent;        /* dry run: by all of them in a step, at most */
    double loss_last; /* smoothed; of frames refined now, their mean, or NAN: there were none */
};

spin_status spin_retrain(const struct spin_retrain_options *o, char **report);

enum spin_split { SPIN_SPLIT_TEST, SPIN_SPLIT_TRAIN, SPIN_SPLIT_ALL };

/* Which pixels count as dynamic when an evaluation measures dynamic regions apart. */
enum spin_dynamic_from {
    SPIN_DYNAMIC_AUTO,   /* masks where every view has one, else the images */
    SPIN_DYNAMIC_MASKS,  /* the data set's foreground masks */
    SPIN_DYNAMIC_IMAGES, /* pixels that differ from the median over time of their camera */
    SPIN_DYNAMIC_OFF
};

struct spin_eval_options {
    const char *input, *data, *data_from, *pair;
    enum spin_split split;
    const int *test_cameras;
    int n_test_cameras;
    struct spin_range range;
    double image_scale;
    bool source;        /* measure the imported attributes */
    const char *images; /* folder for renders, or NULL */
    enum spin_dynamic_from dynamic;
    const char *report, *log; /* a page of HTML; what spin-retrain --log wrote; or NULL */
    const char *lpips; /* folder with the weights of one or both networks of LPIPS; or NULL */
    const char *lpips_backbone, *lpips_lin; /* the two files of one network; or NULL */
    float background[3];
    const char *device;
    int n_threads;
    bool force;
};

struct spin_eval_view {
    int frame, camera;     /* the source's frame number, camera_id */
    struct spin_quality q; /* of this view */
};

/* Bytes of a bundle, by what they are for: as they lie in the file, or unpacked. */
struct spin_bundle_bytes {
    uint64_t file;         /* the whole file */
    uint64_t source;       /* as imported, positions and attributes */
    uint64_t refined;      /* frames refined on their own */
    uint64_t positions;    /* retrained positions and residual values, frame by frame */
    uint64_t tracks;       /* values that frames share, and which splat has which */
    uint64_t table, heads; /* of the network */
};

struct spin_eval_report {
    struct spin_quality mean;
    struct spin_eval_view *view; /* [n_views] */
    size_t n_views;
    int n_frames;
    int n_bundle_frames;            /* storage is of these, whichever were measured */
    bool trained, refined;          /* what was measured; neither: the source */
    enum spin_dynamic_from dynamic; /* where the dynamic regions came from; OFF: nowhere */
    uint64_t left_out;              /* splats that cannot be drawn, over all frames */
    double seconds_decode;          /* one frame: positions and network to splats */
    double seconds_draw;            /* one view of a decoded frame */
    struct spin_bundle_bytes storage, unpacked;
};

spin_status spin_eval(const struct spin_eval_options *o, char **report);
void spin_eval_report_free(struct spin_eval_report *report);
/* Means over the views of one frame, of one camera, of both or (NULL, NULL) of all. What was measured
 * in some views only is the mean over these. valid is false when there is no such view. */
struct spin_quality spin_eval_mean(const struct spin_eval_report *report, const int *frame,
                                   const int *camera);

struct spin_export_options {
    const char *input, *output, *to;
    struct spin_range range;
    bool source, force;
    bool sync;  /* files are on the disk before they have their names */
    bool check; /* read back what was written */
    const char *data, *data_from, *pair;
    float background[3];
    const char *device;
    int n_threads;
    const char *const *plugin_pairs;
};

spin_status spin_export(const struct spin_export_options *o, char **report);

#ifdef __cplusplus
}
#endif

#endif
