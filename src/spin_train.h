/* spin_train.h - the options of a retraining. See spin_run.h, which includes this. */
#ifndef SPIN_TRAIN_H
#define SPIN_TRAIN_H

#include "spin.h"

#ifdef __cplusplus
extern "C" {
#endif

/* NETWORK: the method of the paper. EXPLICIT: every frame on its own, as 3DGS does it. TRACKS: as
 * NETWORK, but splats and tracks have explicit values only. 4D: 4D splats, made of a clip that
 * TRACKS trained. */
enum spin_method { SPIN_METHOD_NETWORK, SPIN_METHOD_FRAMES, SPIN_METHOD_TRACKS, SPIN_METHOD_4D };
/* What a splat has of its own, to which the network adds: nothing; scale from its neighbours and
 * colour of its source; all of its source's (or its refined frame's) attributes, SH up to degree 0.
 */
enum spin_residual { SPIN_RESIDUAL_OFF, SPIN_RESIDUAL_POINTS, SPIN_RESIDUAL_SOURCE };
/* Iterations that 0 in sh_increase_every means to the explicit method. */
enum { SPIN_SH_INCREASE_EVERY = 1000 };
enum spin_refine_start { SPIN_REFINE_FROM_POINTS, SPIN_REFINE_FROM_SOURCE };

/* AUTO: where cameras show the same points in different colours. */
enum spin_exposure { SPIN_EXPOSURE_OFF, SPIN_EXPOSURE_ON, SPIN_EXPOSURE_AUTO };

/* AUTO: where the borders of the training images do not show one flat colour. */
enum spin_backdrop_choice { SPIN_BACKDROP_OFF, SPIN_BACKDROP_ON, SPIN_BACKDROP_AUTO };

/* Centre and radius of the scene at the network's input. AUTO: median of the positions, and the
 * distance that holds 90% of them. NONE: as OFF, without the contraction; splats outside the unit
 * cube share one set of attributes. GIVEN: normalise_centre, normalise_radius. */
enum spin_normalise {
    SPIN_NORMALISE_OFF,
    SPIN_NORMALISE_AUTO,
    SPIN_NORMALISE_NONE,
    SPIN_NORMALISE_GIVEN
};

/* Of the values that a retraining writes. COMPACT: steps that pictures hardly show. HALF: about
 * that of half floats. FULL: to the bit. */
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
    int warmup;     /* iterations; -1: iterations / 40 */
    double average; /* share of the iterations, the last ones, whose values are averaged; 0: none */
    double lr_table, lr_sh, lr_scale, lr_rotation, lr_opacity, lr_position;
    int sh_increase_every; /* iterations until the next degree of SH joins; 0: all from the start,
                              explicit: 1000 */
    enum spin_exposure learn_exposure; /* learn a gain and offset of every training camera */
    double lr_exposure;                /* their rate */
    double lr_head_factor;             /* on the four head rates */
    bool tracks;            /* learn once what frames share, where splats keep their identity */
    double lr_track;        /* on 3DGS's rates for what they share */
    double lr_tracked;      /* on lr_position and lr_residual, for splats that share something */
    double lr_displacement; /* of a shared displacement, times the extent */
    int track_iterations;   /* the first ones, in which tracks that stand still learn; -1: all, at
                               most 5000 */
    enum spin_backdrop_choice backdrop; /* close the scene from behind; with tracks only */
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
    bool auto_resume; /* the caller resumes by itself, as spin_convert() does: errors name no
                         --resume */
    const char *preview, *log; /* folder, file; or NULL */
    const char *watch;         /* folder for a page that shows the state; or NULL */
    const char
        *cache; /* folder of refined frames that runs share, and that stays; NULL: the run's own */
};

/* Those of the first preset. */
void spin_retrain_defaults(struct spin_retrain_options *o);
#define SPIN_PRESETS "quick|best|paper|short"
/* "quick": no network, but attributes that frames share, one image a step, densified, antialiased;
 * as many iterations as the clip's frames ask for. "best": the same with three times as many.
 * "paper": the paper's settings, for hours on an accelerator. "short": the paper's method for
 * minutes of training on a CPU; frames are visited a hundred times instead of thousands, so rates
 * are higher, the views of a step share one evaluation of the network, and splats start from known
 * values. SPIN_E_USAGE when there is no such preset; then the options are those of "quick". */
spin_status spin_retrain_preset(const char *name, struct spin_retrain_options *o);

#ifdef __cplusplus
}
#endif

#endif
