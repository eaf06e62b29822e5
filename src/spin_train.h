/* spin_train.h - the options of a retraining. Included by spin_run.h. */
#ifndef SPIN_TRAIN_H
#define SPIN_TRAIN_H

#include "spin.h"

#ifdef __cplusplus
extern "C" {
#endif

/* NETWORK: the method of the paper; a field computes the attributes. FRAMES: each frame is
 * optimised independently, as in 3DGS. TRACKS: splats and tracks store their attributes, without a
 * field. 4D: 4D splats, made from a clip that was trained with TRACKS. */
enum spin_method { SPIN_METHOD_NETWORK, SPIN_METHOD_FRAMES, SPIN_METHOD_TRACKS, SPIN_METHOD_4D };
/* Residual attributes of the splats, to which the field adds its output. OFF: none. POINTS: start
 * from the distance to the neighbours and from the colour in the source, as in 3DGS. SOURCE: start
 * from all attributes of the source or of the refined frame, at SH degree 0. */
enum spin_residual { SPIN_RESIDUAL_OFF, SPIN_RESIDUAL_POINTS, SPIN_RESIDUAL_SOURCE };
/* Iterations per SH degree with the method FRAMES, if sh_increase_every is 0. */
enum { SPIN_SH_INCREASE_EVERY = 1000 };
/* Initial values of refined frames: coloured points, or the attributes of the source. */
enum spin_refine_start { SPIN_REFINE_FROM_POINTS, SPIN_REFINE_FROM_SOURCE };

/* AUTO: on if the colours of a camera, or the brightness in image corners, differ by over 5 %. */
enum spin_exposure { SPIN_EXPOSURE_OFF, SPIN_EXPOSURE_ON, SPIN_EXPOSURE_AUTO };

/* AUTO: on, unless the borders of the training images show one flat colour or frames have fewer
 * than 1000 splats on average. */
enum spin_backdrop_choice { SPIN_BACKDROP_OFF, SPIN_BACKDROP_ON, SPIN_BACKDROP_AUTO };

/* Centre and radius that normalise positions at the input of the field. OFF: centre 0, radius 1.
 * AUTO: the median of the positions, and the radius that contains 90 % of them. NONE: as OFF, and
 * without the contraction: splats outside the unit cube get zero features and share one set of
 * attributes. GIVEN: normalise_centre, normalise_radius. */
enum spin_normalise {
    SPIN_NORMALISE_OFF,
    SPIN_NORMALISE_AUTO,
    SPIN_NORMALISE_NONE,
    SPIN_NORMALISE_GIVEN
};

/* Precision of the values that a retraining writes. COMPACT: rounding errors are barely visible.
 * HALF: about the precision of half floats. FULL: lossless. */
enum spin_precision { SPIN_PRECISION_COMPACT, SPIN_PRECISION_HALF, SPIN_PRECISION_FULL };

/* Defaults and limits of all numbers are in spin-retrain(1). */
struct spin_retrain_options {
    const char *input, *output;
    const char *preset; /* name of the underlying preset, for messages; or NULL */
    const char *data, *data_from, *pair;
    struct spin_range range;
    double image_scale;      /* 1: original size */
    const int *test_cameras; /* NULL: the data set's own split */
    int n_test_cameras;
    enum spin_method method;
    /* Iterations of refinement per frame, before the field is trained or, with FRAMES, instead. */
    int refine;
    enum spin_refine_start refine_start;
    bool densify;   /* densify while refining; otherwise only prune */
    int max_points; /* limit per frame for densification; 0: none */
    /* Values of iterations below 0: -1 means 1500 + 100 x frames, -3 three times as many. */
    int iterations, batch;
    int levels, features, hash_log2; /* hash grid: at most 2^hash_log2 entries per level */
    int hidden, sh_degree;           /* width of the heads; SH degree of the colours */
    int base_resolution[4];          /* cells of the coarsest level along x y z t */
    int finest_resolution[4];        /* cells of the finest level; 0 for t: max(16, frames) */
    double lambda_dssim;
    /* Weights in the loss of the mean scale, in units of the camera extent, and mean opacity. */
    double lambda_scale, lambda_opacity;
    double dynamic_weight;  /* weight of pixels that show motion, relative to others */
    bool antialias;         /* train and render with antialiasing */
    double hash_init_range; /* the hash table starts uniformly distributed in +/- this */
    uint64_t seed;
    int warmup; /* iterations over which learning rates rise; -1: iterations / 40 */
    /* Final share of the iterations that the Polyak average of the parameters covers; 0: none. */
    double average;
    double lr_table, lr_sh, lr_scale, lr_rotation, lr_opacity, lr_position;
    /* Iterations after which the SH degree rises by one. 0: full degree from the start; with the
     * method FRAMES, SPIN_SH_INCREASE_EVERY. */
    int sh_increase_every;
    enum spin_exposure learn_exposure; /* gain and offset per training camera, falloff per lens */
    double lr_exposure;                /* learning rate of gains, offsets and falloff */
    double lr_head_factor;             /* factor on the learning rates of the four heads */
    /* Share attributes between splats that are the same Gaussian in several frames. */
    bool tracks;
    /* Factor on 3DGS's learning rates, for attributes that a track shares. */
    double lr_track;
    /* Factor on lr_position and lr_residual, for per-frame values of splats with a track. */
    double lr_tracked;
    /* Learning rate of displacements of tracks, in units of the camera extent; dynamic tracks use
     * half of it. */
    double lr_displacement;
    /* Number of iterations, from the first, in which static tracks learn; -1: all, at most 5000. */
    int track_iterations;
    /* Whether to add a backdrop: opaque splats behind the outermost surfaces. Requires tracks. */
    enum spin_backdrop_choice backdrop;
    /* Learn residual attributes in every frame for dynamic and varying tracks. */
    bool dynamic_residual;
    /* Iterations between densifications; 0: no densification; -1: track_iterations / 20. */
    int densify_every;
    /* Mean gradient, in normalised device coordinates, at which a splat is split; share of
     * track_iterations after which densification stops. */
    double densify_threshold, densify_until;
    double network_start; /* share of the iterations after which the field joins */
    enum spin_residual residual;
    /* Factor on 3DGS's learning rates, for residual attributes; 0: they stay fixed. */
    double lr_residual;
    /* Initial log scale of all splats; NaN: the log of the median distance to the 3 nearest
     * neighbours. */
    double init_log_scale;
    bool relu; /* ReLU instead of GELU in the heads */
    enum spin_normalise normalise;
    double normalise_centre[3], normalise_radius; /* with SPIN_NORMALISE_GIVEN */
    int views_per_frame;                          /* views of a batch that show the same frame */
    float background[3];
    enum spin_precision precision; /* precision of the output */
    const char *device;            /* "auto", "cpu" or "cuda" */
    int n_threads;                 /* 0: all cores */
    bool deterministic; /* bit-reproducible results on a GPU; on the CPU they always are */
    /* Iterations between evaluations (0: only at the end) and checkpoints (0: every 5 minutes). */
    int eval_every, save_every;
    bool resume, force, dry_run;
    /* The caller resumes by itself, as spin_convert() does: errors do not mention --resume. */
    bool auto_resume;
    const char *preview, *log; /* folder of preview images, log file; or NULL */
    const char *watch;         /* folder for a page that shows the progress; or NULL */
    /* Persistent folder of refined frames, shared by runs; NULL: a temporary one of this run. */
    const char *cache;
};

/* Sets the options of preset "quick". */
void spin_retrain_defaults(struct spin_retrain_options *o);
#define SPIN_PRESETS "quick|best|paper|short"
/* Sets the options of a preset. "quick": attributes shared by tracks instead of a field, one image
 * per iteration, densification, antialiasing; the number of iterations grows with that of frames.
 * "best": the same with three times as many iterations. "paper": the paper's settings, which take
 * hours on a GPU. "short": the paper's method in minutes on a CPU: each frame is visited a hundred
 * times instead of thousands, so learning rates are higher, the views of an iteration share one
 * evaluation of the field, and splats start from known values. SPIN_E_USAGE if no such preset
 * exists; the options are then those of "quick". */
spin_status spin_retrain_preset(const char *name, struct spin_retrain_options *o);

#ifdef __cplusplus
}
#endif

#endif
