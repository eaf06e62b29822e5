/* spin_train.h - the options of a retraining. Programs need not include this file: spin_run.h does.
 */
#ifndef SPIN_TRAIN_H
#define SPIN_TRAIN_H

#include "spin.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Training methods. NETWORK: the method of the SPIN-4DGS paper, in which a neural field computes
 * the attributes of splats. FRAMES: each frame is optimised independently, as in 3DGS. TRACKS: the
 * attributes of splats and tracks are optimised directly, without a field. 4D: 4D splats are
 * trained, which are made from a clip that was trained with TRACKS. */
enum spin_method { SPIN_METHOD_NETWORK, SPIN_METHOD_FRAMES, SPIN_METHOD_TRACKS, SPIN_METHOD_4D };
/* Initial values of residual attributes: values that each splat stores and that are added to the
 * output of the field. OFF: there are no residual attributes. POINTS: as in 3DGS, scales are
 * initialised from the distances to the neighbours, and colours are those of the source. SOURCE:
 * all attributes are initialised with those of the source or, if frames are refined, with those of
 * the refined frame; SH coefficients beyond the first are dropped. */
enum spin_residual { SPIN_RESIDUAL_OFF, SPIN_RESIDUAL_POINTS, SPIN_RESIDUAL_SOURCE };
/* Number of iterations between increases of the SH degree, for the method FRAMES if
 * sh_increase_every is 0. */
enum { SPIN_SH_INCREASE_EVERY = 1000 };
/* Initial values of refined frames. POINTS: the positions and colours of the source. SOURCE: all
 * attributes of the source. */
enum spin_refine_start { SPIN_REFINE_FROM_POINTS, SPIN_REFINE_FROM_SOURCE };

/* Whether to learn the exposure of each camera and the falloff (vignetting) of each lens. AUTO: ON
 * if the colours of a camera deviate from those of the others by over 5 %, or if the brightness in
 * image corners deviates by over 5 % from that in the centre; otherwise OFF. */
enum spin_exposure { SPIN_EXPOSURE_OFF, SPIN_EXPOSURE_ON, SPIN_EXPOSURE_AUTO };

/* Whether to add a backdrop, that is, opaque splats behind the outermost surfaces. AUTO: OFF if the
 * borders of the training images show one flat colour, or if frames have fewer than 1000 splats on
 * average; otherwise ON. */
enum spin_backdrop_choice { SPIN_BACKDROP_OFF, SPIN_BACKDROP_ON, SPIN_BACKDROP_AUTO };

/* Centre and radius that normalise positions at the input of the field. OFF: centre 0 and radius 1.
 * AUTO: the centre is the median of the positions, and the radius is that of the ball around it
 * that contains 90 % of the positions. NONE: centre 0 and radius 1, and unbounded space is not
 * contracted to the unit cube; all splats outside the unit cube then get zero features, and thus
 * the same attributes. */
enum spin_normalise { SPIN_NORMALISE_OFF, SPIN_NORMALISE_AUTO, SPIN_NORMALISE_NONE };

/* Precision of the values that a retraining writes. COMPACT: values are quantised without visible
 * loss. HALF: values are rounded to about the precision of half floats. FULL: values are not
 * rounded. */
enum spin_precision { SPIN_PRECISION_COMPACT, SPIN_PRECISION_HALF, SPIN_PRECISION_FULL };

/* The options of a retraining. spin-retrain(1) documents the defaults and limits of all numbers. */
struct spin_retrain_options {
    const char *input, *output;
    /* Name of the preset that set the options, for messages only; or NULL. */
    const char *preset;
    const char *data, *data_from, *pair;
    struct spin_range range;
    double image_scale; /* factor on width and height of the images; 1: original size */
    /* Ids [n_test_cameras] of the cameras that are held out as test views; NULL: the test cameras
     * that the data set names. */
    const int *test_cameras;
    int n_test_cameras;
    int test_outer; /* number of outermost cameras that are held out in addition to test_cameras */
    enum spin_method method;
    /* Iterations of refinement for each frame; 0: frames are not refined. After the refinement, the
     * whole clip is trained, except with the method FRAMES. */
    int refine;
    enum spin_refine_start refine_start;
    /* True: refinement clones, splits and prunes splats. False: it only prunes them. */
    bool densify;
    int max_points; /* upper limit of splats per frame for densification; 0: no limit */
    /* Number of iterations, and number of images per iteration. iterations -1 means 1500 + 100 x
     * frames, and -3 three times that number; spin_options_most_iterations() limits both, since a
     * long training with few cameras overfits. batch -1 means one image for each rank; with several
     * ranks, the number of iterations is then reduced and learning rates are increased. */
    int iterations, batch;
    /* Hash grid of the field: number of levels, number of features per entry, and log2 of the
     * largest number of entries of a level. */
    int levels, features, hash_log2;
    /* Width of the hidden layers of the field's heads; SH degree of the colours. */
    int hidden, sh_degree;
    /* Resolution of the finest level of the hash grid along x, y, z and t. 0 for t means the number
     * of frames, but at least 16. */
    int finest_resolution[4];
    double lambda_dssim; /* loss = lambda_dssim (1 - SSIM) + (1 - lambda_dssim) L1 */
    /* Weight of pixels that show motion in the loss; other pixels have weight 1. */
    double dynamic_weight;
    bool antialias; /* train and render with antialiasing */
    uint64_t seed;
    /* Number of iterations in which learning rates rise linearly from 0 to their initial values;
     * -1: iterations / 40. */
    int warmup;
    /* Share of the iterations, 0..1, whose parameters are averaged at the end of the training
     * (Polyak average): 0.2 means the last 20 %. 0: parameters are not averaged. */
    double average;
    double lr_table, lr_sh, lr_scale, lr_rotation, lr_opacity, lr_position;
    /* The SH degree starts at 0 and rises by one every sh_increase_every iterations. 0 means the
     * full degree from the start, except with the method FRAMES, where it means
     * SPIN_SH_INCREASE_EVERY. */
    int sh_increase_every;
    /* Whether to learn the gain and offset of each training camera, and the falloff of each lens.
     */
    enum spin_exposure learn_exposure;
    /* True: if the images show a subject in front of the background colour, or have an alpha
     * channel, splats learn the alpha of the subject: each iteration composites images and renders
     * over a random colour, at the pixels whose alpha is known. Exposures are then not learned. */
    bool learn_alpha;
    double lr_exposure;    /* learning rate of gains, offsets and falloff */
    double lr_head_factor; /* factor on the learning rates of the field's four heads */
    /* True: splats that represent the same Gaussian in several frames form a track and share
     * attributes. */
    bool tracks;
    /* Factor on the learning rates of 3DGS for attributes that the splats of a track share. */
    double lr_track;
    /* Factor on lr_position and lr_residual for the per-frame values of splats with a track; the
     * factor of splats without a track is 1. */
    double lr_tracked;
    /* Learning rate of the displacements of tracks, relative to the extent of the training cameras.
     * Dynamic tracks have half of this rate. */
    double lr_displacement;
    /* Number of iterations, from the start of the training, in which static tracks are trained; -1:
     * all iterations, but at most 5000. */
    int track_iterations;
    /* Whether to add a backdrop. Has no effect if `tracks` is false or frames are refined. */
    enum spin_backdrop_choice backdrop;
    /* True: the splats of dynamic and of varying tracks learn residual attributes in every frame.
     */
    bool dynamic_residual;
    /* Number of iterations between densifications of the clip; 0: no densification; -1:
     * track_iterations / 20. */
    int densify_every;
    /* densify_threshold: a splat or track is split if the mean gradient of its screen position, in
     * normalised device coordinates, is at least this value. The gradient is the sum over the
     * pixels of absolute values. densify_until: share of
     * track_iterations, 0..1, after which densification stops. */
    double densify_threshold, densify_until;
    enum spin_residual residual;
    /* Factor on the learning rates of 3DGS for residual attributes; 0: residual attributes are not
     * trained. */
    double lr_residual;
    bool relu; /* true: the field's heads use ReLU instead of GELU */
    enum spin_normalise normalise;
    /* Number of images of an iteration that show the same frame. */
    int views_per_frame;
    float background[3];           /* colour behind the splats, r g b in 0..1 */
    enum spin_precision precision; /* precision of the written values */
    const char *device;            /* "auto", "cpu" or "cuda" */
    int n_threads;                 /* number of CPU threads; 0: one for each core */
    /* True: results on a GPU are bit-reproducible. Results on the CPU are always bit-reproducible.
     */
    bool deterministic;
    /* Number of iterations between evaluations of the test views (0: one evaluation, at the end),
     * and between checkpoints (0: a checkpoint every 5 minutes). */
    int eval_every, save_every;
    bool resume, force, dry_run;
    /* True if the caller decides whether to resume, as spin_convert() does. Error messages then
     * suggest running the same command again instead of adding --resume. */
    bool auto_resume;
    const char *preview, *log; /* folder for preview images, log file; either may be NULL */
    /* Folder in which to write a web page that shows the progress; or NULL. */
    const char *watch;
    /* Cache folder of refined frames, which several runs may share and no run deletes. NULL: the
     * run uses a folder beside the output and deletes it at the end. */
    const char *cache;
    /* If the arrays of the frames do not fit into memory: folder of the temporary files in which to
     * keep them. NULL: the folder of the output; "off": fail instead. Ignored on a GPU. */
    const char *scratch;
};

/* Sets all options to those of the preset "quick". */
void spin_retrain_defaults(struct spin_retrain_options *o);
#define SPIN_PRESETS "quick|best|paper|short"
/* Sets all options to those of a preset. "quick": the method TRACKS with one image per iteration,
 * densification and antialiasing; the number of iterations grows with the number of frames. "best":
 * "quick" with three times as many iterations and adapted learning rates of tracks. "paper": the
 * method NETWORK with the settings of the paper, which takes hours on a CPU. "short": the method
 * NETWORK in minutes on a CPU. Since "short" trains each frame in about a hundred iterations
 * instead of thousands, it differs in three ways: learning rates are higher; all images of an
 * iteration show the same frame, so that the field is evaluated for one frame only; scales and
 * colours are initialised from the points of the source. SPIN_E_USAGE if there is no preset of this
 * name; the options are then those of "quick". */
spin_status spin_retrain_preset(const char *name, struct spin_retrain_options *o);

#ifdef __cplusplus
}
#endif

#endif
