/* spin_train.h - the options of a retraining. spin_run.h includes this file. */
#ifndef SPIN_TRAIN_H
#define SPIN_TRAIN_H

#include "spin.h"

#ifdef __cplusplus
extern "C" {
#endif

/* NETWORK: the method of the paper, in which a field computes the attributes of splats. FRAMES:
 * each frame is optimised independently, as in 3DGS. TRACKS: splats and tracks store their
 * attributes, and there is no field. 4D: trains 4D splats, which are made from a clip that was
 * trained with TRACKS. */
enum spin_method { SPIN_METHOD_NETWORK, SPIN_METHOD_FRAMES, SPIN_METHOD_TRACKS, SPIN_METHOD_4D };
/* Initial values of residual attributes, which splats store and to which the field adds its output.
 * OFF: there are no residual attributes. POINTS: as in 3DGS, scales start from the distances to the
 * neighbours and colours from those of the source. SOURCE: all attributes start from those of the
 * source or, if frames are refined, of the refined frame; SH coefficients beyond the first are
 * dropped. */
enum spin_residual { SPIN_RESIDUAL_OFF, SPIN_RESIDUAL_POINTS, SPIN_RESIDUAL_SOURCE };
/* With the method FRAMES and sh_increase_every 0, the SH degree rises by one after this many
 * iterations. */
enum { SPIN_SH_INCREASE_EVERY = 1000 };
/* Initial values of refined frames. POINTS: the positions and colours of the source. SOURCE: all
 * attributes of the source. */
enum spin_refine_start { SPIN_REFINE_FROM_POINTS, SPIN_REFINE_FROM_SOURCE };

/* Whether to learn exposure and falloff. AUTO: ON if the colours of a camera deviate from those of
 * the others by over 5 %, or if the brightness in image corners deviates by over 5 % from that in
 * the centre; otherwise OFF. */
enum spin_exposure { SPIN_EXPOSURE_OFF, SPIN_EXPOSURE_ON, SPIN_EXPOSURE_AUTO };

/* Whether to add a backdrop. AUTO: OFF if the borders of the training images show one flat colour,
 * or if frames have fewer than 1000 splats on average; otherwise ON. */
enum spin_backdrop_choice { SPIN_BACKDROP_OFF, SPIN_BACKDROP_ON, SPIN_BACKDROP_AUTO };

/* Centre and radius that normalise positions at the input of the field. OFF: centre 0 and radius 1.
 * AUTO: the centre is the median of the positions, and the radius is that of the ball around it
 * that contains 90 % of the positions. NONE: centre 0 and radius 1, without the contraction; all
 * splats outside the unit cube then get zero features, and thus the same attributes. */
enum spin_normalise { SPIN_NORMALISE_OFF, SPIN_NORMALISE_AUTO, SPIN_NORMALISE_NONE };

/* Precision of the values that a retraining writes. COMPACT: values are rounded so that the errors
 * are barely visible. HALF: values are rounded to about the precision of half floats. FULL: values
 * are not rounded. */
enum spin_precision { SPIN_PRECISION_COMPACT, SPIN_PRECISION_HALF, SPIN_PRECISION_FULL };

/* The options of a retraining. spin-retrain(1) documents the defaults and limits of all numbers. */
struct spin_retrain_options {
    const char *input, *output;
    /* Name of the preset from which the options were made, for messages only; or NULL. */
    const char *preset;
    const char *data, *data_from, *pair;
    struct spin_range range;
    double image_scale; /* factor on width and height of the images; 1: original size */
    /* Ids of the cameras that are held out as test views; NULL: those that the data set names. */
    const int *test_cameras;
    int n_test_cameras;
    int test_outer; /* number of outermost cameras that are held out as test views as well */
    enum spin_method method;
    /* Iterations of refinement for each frame; 0: frames are not refined. The clip is trained after
     * the refinement; with the method FRAMES it is not trained. */
    int refine;
    enum spin_refine_start refine_start;
    /* True: refinement clones, splits and prunes splats. False: it only prunes them. */
    bool densify;
    int max_points; /* densification ends at this number of splats per frame; 0: no limit */
    /* Number of iterations, and number of images in each. iterations -1 means 1500 + 100 x frames,
     * and -3 three times as many, both limited by spin_options_most_iterations(), since few cameras
     * would be overtrained. batch -1 means one image for each rank, with fewer iterations and
     * larger learning rates. */
    int iterations, batch;
    /* Hash grid of the field: number of levels, features in an entry; a level has at most
     * 2^hash_log2 entries. */
    int levels, features, hash_log2;
    /* Width of the hidden layers of the heads; SH degree of the colours. */
    int hidden, sh_degree;
    /* Cells of the finest level along x, y, z, t. 0 for t means the number of frames, but at
     * least 16. */
    int finest_resolution[4];
    double lambda_dssim; /* weight of 1 - SSIM in the loss; the L1 error has the weight 1 - this */
    double dynamic_weight; /* weight in the loss of pixels that show motion; other pixels have
                              weight 1 */
    bool antialias;        /* train and render with antialiasing */
    uint64_t seed;
    /* Number of iterations over which learning rates rise from 0; -1: iterations / 40. */
    int warmup;
    /* Share of all iterations, at the end of the training, that the Polyak average of the
     * parameters covers; 0: parameters are not averaged. */
    double average;
    double lr_table, lr_sh, lr_scale, lr_rotation, lr_opacity, lr_position;
    /* The SH degree starts at 0 and rises by one after this many iterations. 0 means the full
     * degree from the start or, with the method FRAMES, SPIN_SH_INCREASE_EVERY iterations. */
    int sh_increase_every;
    /* Whether to learn gain and offset of each training camera, and falloff of each lens. */
    enum spin_exposure learn_exposure;
    /* True: if the images show a subject in front of the background colour, or have alpha, render
     * over random backgrounds where the alpha of an image is known. Exposures are not learned. */
    bool learn_alpha;
    double lr_exposure;    /* learning rate of gains, offsets and falloff */
    double lr_head_factor; /* factor on the learning rates of the four heads */
    /* True: splats that are the same Gaussian in several frames form a track and share attributes.
     */
    bool tracks;
    /* Learning rates of attributes that the splats of a track share, as a factor on those of 3DGS.
     */
    double lr_track;
    /* Factor on the rates lr_position and lr_residual for the values that a splat with a track has
     * in each frame; splats without a track have the full rates. */
    double lr_tracked;
    /* Learning rate of the displacements of tracks, in units of the camera extent. Dynamic tracks
     * have half of this rate. */
    double lr_displacement;
    /* Static tracks learn only in the first track_iterations iterations; -1: in all iterations, but
     * at most in the first 5000. */
    int track_iterations;
    /* Whether to add a backdrop: opaque splats behind the outermost surfaces. Has no effect if
     * `tracks` is false or frames are refined. */
    enum spin_backdrop_choice backdrop;
    /* True: the splats of dynamic and of varying tracks learn residual attributes in every frame.
     */
    bool dynamic_residual;
    /* Number of iterations between densifications of the clip; 0: it is not densified; -1:
     * track_iterations / 20. */
    int densify_every;
    /* densify_threshold: a splat or track is split if its mean gradient, in normalised device
     * coordinates, is at least this. densify_until: densification stops after this share of
     * track_iterations. */
    double densify_threshold, densify_until;
    enum spin_residual residual;
    /* Learning rates of residual attributes, as a factor on those of 3DGS; 0: residual attributes
     * stay fixed. */
    double lr_residual;
    bool relu; /* true: the heads use ReLU instead of GELU */
    enum spin_normalise normalise;
    /* Number of the views in a batch that show the same frame. */
    int views_per_frame;
    float background[3];           /* colour behind the splats, r g b in 0..1 */
    enum spin_precision precision; /* precision of the written values */
    const char *device;            /* "auto", "cpu" or "cuda" */
    int n_threads;                 /* number of threads of the CPU; 0: one for each core */
    /* True: results on a GPU are bit-reproducible. Results on the CPU always are. */
    bool deterministic;
    /* Number of iterations between evaluations of the test views (0: they are evaluated only at the
     * end), and between checkpoints (0: one is saved every 5 minutes). */
    int eval_every, save_every;
    bool resume, force, dry_run;
    /* True if the caller decides by itself whether to resume, as spin_convert() does. Error
     * messages then suggest to run the same command again instead of --resume. */
    bool auto_resume;
    const char *preview, *log; /* folder for preview images; log file; each may be NULL */
    /* Folder for a web page that shows the progress; or NULL. */
    const char *watch;
    /* Folder of refined frames that several runs share and that none of them deletes. NULL: this
     * run uses a folder beside the output and deletes it at the end. */
    const char *cache;
};

/* Sets all options to those of the preset "quick". */
void spin_retrain_defaults(struct spin_retrain_options *o);
#define SPIN_PRESETS "quick|best|paper|short"
/* Sets all options to those of a preset. "quick": splats share attributes through tracks, without a
 * field; it trains on one image per iteration, with densification and antialiasing, and the number
 * of iterations grows with the number of frames. "best": "quick" with three times as many
 * iterations and adapted learning rates of tracks. "paper": the method with the paper's settings,
 * which takes hours on a GPU. "short": the paper's method in minutes on a CPU. It visits each frame
 * a hundred times instead of thousands, so its learning rates are higher, all views of an iteration
 * share one evaluation of the field, and splats start from the colours and distances of the
 * source's points. SPIN_E_USAGE if there is no preset of this name; the options are then those of
 * "quick". */
spin_status spin_retrain_preset(const char *name, struct spin_retrain_options *o);

#ifdef __cplusplus
}
#endif

#endif
