/* spin_train.h - the options of a retraining. Included by spin_run.h. */
#ifndef SPIN_TRAIN_H
#define SPIN_TRAIN_H

#include "spin.h"

#ifdef __cplusplus
extern "C" {
#endif

/* NETWORK: the method of the paper, whose attributes come from a field. FRAMES: each frame
 * optimised independently, as in 3DGS. TRACKS: splats and tracks store their attributes, without a
 * field. 4D: 4D splats, made from a clip that was trained with TRACKS. */
enum spin_method { SPIN_METHOD_NETWORK, SPIN_METHOD_FRAMES, SPIN_METHOD_TRACKS, SPIN_METHOD_4D };
/* The splat's own values, to which the field adds. OFF: none. POINTS: scale from its neighbours,
 * colour of its source. SOURCE: all attributes of its source or refined splat, with SH up to degree
 * 0. */
enum spin_residual { SPIN_RESIDUAL_OFF, SPIN_RESIDUAL_POINTS, SPIN_RESIDUAL_SOURCE };
/* What sh_increase_every = 0 means for the method FRAMES, in iterations. */
enum { SPIN_SH_INCREASE_EVERY = 1000 };
enum spin_refine_start { SPIN_REFINE_FROM_POINTS, SPIN_REFINE_FROM_SOURCE };

/* AUTO: on if cameras show the same points in different colours. */
enum spin_exposure { SPIN_EXPOSURE_OFF, SPIN_EXPOSURE_ON, SPIN_EXPOSURE_AUTO };

/* AUTO: on unless the borders of the training images show one flat colour. */
enum spin_backdrop_choice { SPIN_BACKDROP_OFF, SPIN_BACKDROP_ON, SPIN_BACKDROP_AUTO };

/* Centre and radius of the scene at the input of the field. AUTO: the median of the positions, and
 * the distance that contains 90% of them. NONE: as OFF but without the contraction; splats outside
 * the unit cube share one set of attributes. GIVEN: normalise_centre, normalise_radius. */
enum spin_normalise {
    SPIN_NORMALISE_OFF,
    SPIN_NORMALISE_AUTO,
    SPIN_NORMALISE_NONE,
    SPIN_NORMALISE_GIVEN
};

/* Precision of the values that a retraining writes. COMPACT: rounding errors that are barely
 * visible. HALF: about that of half floats. FULL: lossless. */
enum spin_precision { SPIN_PRECISION_COMPACT, SPIN_PRECISION_HALF, SPIN_PRECISION_FULL };

/* Defaults and limits of all numbers are in spin-retrain(1). */
struct spin_retrain_options {
    const char *input, *output;
    const char *preset; /* name of the preset these are based on, for messages; or NULL */
    const char *data, *data_from, *pair;
    struct spin_range range;
    double image_scale;      /* 1: as stored */
    const int *test_cameras; /* NULL: the data set's own split */
    int n_test_cameras;
    enum spin_method method;
    int refine; /* iterations on each frame, before the field is trained, or instead */
    enum spin_refine_start refine_start; /* from coloured points, or from the source's attributes */
    bool densify;                        /* densify while refining; otherwise only prune */
    int max_points;                      /* limit per frame for densification; 0: none */
    /* iterations -n means n x (1500 + 100 x frames), for -1 and -3 only. */
    int iterations, batch;
    int levels, features, hash_log2; /* of the hash grid */
    int hidden, sh_degree;           /* width of the heads; degree of the colours */
    int base_resolution[4];          /* x y z t */
    int finest_resolution[4];        /* 0 for t: max(16, frames) */
    double lambda_dssim;
    /* Weights of the mean scale (in units of the camera extent) and of the mean opacity. */
    double lambda_scale, lambda_opacity;
    double dynamic_weight;  /* weight of pixels that show motion, relative to others */
    bool antialias;         /* train and render with antialiasing */
    double hash_init_range; /* initial values of the hash table are within +/- this */
    uint64_t seed;
    int warmup; /* iterations over which learning rates rise; -1: iterations / 40 */
    /* Share of the iterations, at the end, whose values are averaged (Polyak average); 0: none. */
    double average;
    double lr_table, lr_sh, lr_scale, lr_rotation, lr_opacity, lr_position;
    /* Iterations after which the SH degree rises by one; 0: full degree from the start, but for
     * FRAMES SPIN_SH_INCREASE_EVERY. */
    int sh_increase_every;
    enum spin_exposure learn_exposure; /* gain and offset for each training camera */
    double lr_exposure;                /* learning rate of these */
    double lr_head_factor;             /* factor on the learning rates of the four heads */
    /* Share attributes between splats that are the same Gaussian in several frames. */
    bool tracks;
    /* Factor on 3DGS's learning rates, for shared attributes. */
    double lr_track;
    /* Factor on lr_position and lr_residual, for splats with a track. */
    double lr_tracked;
    /* Learning rate of displacements of tracks, in units of the camera extent. */
    double lr_displacement;
    /* The first iterations, in which static tracks learn; -1: all, at most 5000. */
    int track_iterations;
    /* Close the scene with opaque splats behind its surfaces; with tracks only. */
    enum spin_backdrop_choice backdrop;
    /* Dynamic tracks have residuals in every frame as well. */
    bool dynamic_residual;
    /* Iterations between densifications; 0: none; -1: track_iterations / 20. */
    int densify_every;
    /* Threshold of the mean gradient; share of track_iterations in which densification runs. */
    double densify_threshold, densify_until;
    double network_start;        /* share of the iterations before the field joins */
    enum spin_residual residual; /* values that the field adds to */
    /* Factor on 3DGS's learning rates, for a splat's own values; 0: these are constant. */
    double lr_residual;
    /* NaN: auto, the log of the median distance to 3 neighbours. */
    double init_log_scale;
    bool relu; /* ReLU instead of GELU in the heads */
    enum spin_normalise normalise;
    double normalise_centre[3], normalise_radius; /* with SPIN_NORMALISE_GIVEN */
    int views_per_frame;                          /* views of a batch that show the same frame */
    float background[3];
    enum spin_precision precision; /* of the output */
    const char *device;            /* "auto", "cpu" or "cuda" */
    int n_threads;                 /* 0: all */
    bool deterministic;            /* bit-identical sums on a GPU; the CPU always has these */
    int eval_every, save_every;    /* iterations; 0: eval at the end only, save every 5 minutes */
    bool resume, force, dry_run;
    /* The caller resumes by itself, as spin_convert() does: errors do not mention --resume. */
    bool auto_resume;
    const char *preview, *log; /* folder, file; or NULL */
    const char *watch;         /* folder for a page that shows the progress; or NULL */
    /* Persistent folder of refined frames, shared by runs; NULL: a temporary one of this run. */
    const char *cache;
};

/* The options of preset "quick". */
void spin_retrain_defaults(struct spin_retrain_options *o);
#define SPIN_PRESETS "quick|best|paper|short"
/* "quick": attributes shared by tracks instead of a field, one image per iteration, densification,
 * antialiasing; the number of iterations grows with that of frames. "best": the same with three
 * times as many iterations. "paper": the paper's settings, which take hours on a GPU. "short": the
 * paper's method in minutes on a CPU: each frame is visited a hundred times instead of thousands,
 * so learning rates are higher, the views of an iteration share one evaluation of the field, and
 * splats start from known values. SPIN_E_USAGE if no such preset exists; the options are then those
 * of "quick". */
spin_status spin_retrain_preset(const char *name, struct spin_retrain_options *o);

#ifdef __cplusplus
}
#endif

#endif
