/* State of a training between iterations (docs/method.md sections 3 to 7). step.h runs an
 * iteration. */
#pragma once

#include "model/field_eval.h"
#include "render/raster.h"
#include "train/train_frame.h"
#include "device/device.h"
#include "io/ranks.h"
#include "scene/lens.h"
#include "model/field.h"

/* ---- Parameters ------------------------------------------------------------------------------ */

/* An array of parameters in device memory, with their gradient and Adam's moments. */

struct spin_param {
    float SPIN_DEV *p, *g, *m, *v; /* [n] parameters, gradient, first and second moments */
    size_t n, pad;                 /* pad: number of unused floats before each array */
};

/* Allocates the four arrays and sets them to zero. Each array starts `pad` floats after the start
 * of its allocation, see spin_lazy_pad(). Close it also after a failure. */
spin_status spin_param_open(struct spin_param *param, struct spin_device *d, size_t n, size_t pad);
void spin_param_close(struct spin_param *param, struct spin_device *d);
/* Describes the parameters [first, last) to the device's adam(), for Adam step `step` with learning
 * rate lr. */
struct spin_param_group spin_param_group(const struct spin_param *param, size_t first, size_t last,
                                         double lr, int64_t step);

/* ---- Exposure and falloff -------------------------------------------------------------------- */

/* Photometric model of the cameras, learned with the scene (math/exposure.h): gain and offset of
 * each camera for each colour channel, and falloff of each lens. */

struct spin_exposures {
    /* [n_cameras + n_lenses][SPIN_EXPOSURE]: first the cameras, then the lenses. Empty (n is 0) if
     * no exposure is learned. */
    struct spin_param param;
    size_t n_cameras;
    /* [pixels][3] rendered images after exposure and falloff were applied. */
    float SPIN_DEV *exposed;
    size_t pixels;
};

/* Allocates the parameters and copies their initial values from `first`, which has the layout of
 * `param`. `pixels` is the total number of pixels of the images that the device processes together.
 * With n_cameras 0 no exposure is learned and nothing is allocated. Close it also after a failure.
 */
spin_status spin_exposures_open(struct spin_exposures *t, struct spin_device *d, int n_cameras,
                                int n_lenses, const float *first, size_t pixels);
void spin_exposures_close(struct spin_exposures *t, struct spin_device *d);

/* Downloads the current falloff of the lenses. */
spin_status spin_exposures_read_lenses(const struct spin_exposures *t, struct spin_device *d,
                                       struct spin_lenses *lenses);

/* Fixes the gauge after an Adam step: shifts the gains and offsets of all cameras so that the mean
 * of the log gains and the mean of the offsets are 0. A held-out view, which has no exposure of its
 * own, is thus rendered in the colours of this mean camera. Falloff needs no gauge, since its
 * formula gives 1 at the image centre. */
void spin_exposures_centre(struct spin_exposures *t, struct spin_device *d);

/* ---- All-reduce of device memory ------------------------------------------------------------- */

/* All-reduce (io/ranks.h) of values in device memory. On the CPU device this is host memory, where
 * MPI sums the values in place. The values of a GPU are downloaded, summed by MPI and uploaded; the
 * host memory for this is page-locked if possible (host_reserve() of device.h), which saves a copy.
 */

/* State of the all-reduce in a rank. All members are zero if there is only one rank. */
struct spin_rank_sum {
    struct spin_device *device;
    struct spin_host_memory host; /* for values that are downloaded from a GPU and summed by MPI */
};

/* All ranks must call it. With -v it logs which host memory the values of a GPU pass through. */
spin_status spin_rank_sum_open(struct spin_rank_sum *s, struct spin_device *device);
void spin_rank_sum_close(struct spin_rank_sum *s);

/* All-reduces an array of n values, after the queued work of the device is done: afterwards it
 * contains the sum of the arrays of all ranks. kind: SPIN_SUM_F32 or SPIN_SUM_U32. All ranks must
 * call it with the same n and kind. The sums are bit-identical on all ranks, and reproducible with
 * the same number of ranks. Fails if memory is exhausted, if the device fails, or if another rank
 * has failed. With only one rank it does nothing. */
spin_status spin_rank_sum(struct spin_rank_sum *s, void SPIN_DEV *at, size_t n, int kind);

/* ---- State of a training --------------------------------------------------------------------- */

/* Learning rates. Each member is a peak: unless noted, the rate rises linearly to it over `warmup`
 * iterations, and then falls along a cosine to `end` in the last iteration. */
struct spin_train_rates {
    double table, head[SPIN_HEADS], position, exposure, end;
    /* If residual[SPIN_HEAD_SCALE] is 0, neither the residual values nor the SH coefficients beyond
     * the first are trained, even if `sh` is above 0. */
    double residual[SPIN_HEADS];
    double sh; /* of SH coefficients beyond the first, which splats own */
    /* Above 0: all rates follow 3DGS instead. The position rate decays log-linearly from `position`
     * to position_end, and all other rates are constant. */
    double position_end;
    /* Rates of tracks, of values that frames own and of exposures fall to this share of their peak
     * instead of `end`, unless that is less than `end`. The rates of static tracks fall to `end` if
     * track_iterations is less than `iterations`. */
    double floor;
    double tracked; /* factor on `position` and `residual` for splats with a track */
    double track[SPIN_HEADS], displacement;
    int64_t warmup, iterations;
    /* After this many iterations the rate of static tracks stays at `end`; if equal to
     * `iterations`, static tracks learn in all iterations. */
    int64_t track_iterations;
    bool lenses_stay; /* true if falloff is fixed, so that only gains and offsets are learned */
};

/* 3DGS's learning rates of log scale, rotation, colour and opacity. */
extern const double spin_rate_3dgs[SPIN_HEADS];
/* Returns the rates of 3DGS for the training of a single frame, whose cameras have this extent
 * (docs/method.md section 2). The caller sets the rate of the exposure. */
struct spin_train_rates spin_rates_3dgs(double extent, int iterations);

/* Sizes that spin_trainer_open() needs to allocate a trainer. */
struct spin_trainer_size {
    int n_frames;
    const struct spin_frame_size *frame; /* [n_frames] */
    /* True if splats may have tracks, and statistics for densification are gathered. n_tracks may
     * be 0 even then. */
    bool tracked;
    size_t n_tracks, n_moving, n_varying, n_backdrop;
    bool motion;  /* true if tracks are 4D splats, which move and have Gaussian windows */
    bool network; /* true if there is a network */
    /* True for the training of a single frame, in which other ranks do not take part. */
    bool alone;
    int sh_degree; /* degree of the SH that splats own; 0: they own the first coefficient only */
    int max_items; /* largest number of images in a batch */
    size_t max_pixels, max_tiles;
    /* Numbers of cameras whose exposure is learned, and of lenses; n_cameras 0: neither exposure
     * nor falloff is learned. */
    int n_cameras, n_lenses;
    /* [n_cameras + n_lenses][SPIN_EXPOSURE] initial values of the exposure parameters. */
    const float *exposure;
};

struct spin_average { /* the Polyak average, see average.h */
    /* Iterations after `first` are averaged: the last one, and those before it at intervals of
     * `every`. `every` 0: there is no average. */
    int64_t first, every;
    int n; /* number of iterations averaged so far */
    size_t n_values;
    /* [n_values] mean of the parameters, in the order of state_arrays.h; in host memory. */
    float *mean;
};

struct spin_trainer {
    struct spin_device *device;
    struct spin_field field;
    const struct spin_field *network; /* &field, or NULL if there is no network */
    struct spin_param table, heads;   /* empty without a network */
    struct spin_param tracks; /* [SPIN_TRACK n_tracks] values of the tracks, in groups (device.h) */
    bool tracked;             /* see spin_trainer_size */
    size_t n_tracks;
    /* [n_tracks][SPIN_MOTION] velocity and window of tracks that are 4D splats, which are not
     * trained; NULL for other tracks. */
    float SPIN_DEV *motion;
    /* The first n_moving tracks are dynamic: their splats own positions. The splats of the first
     * n_varying tracks own residual values. */
    size_t n_moving, n_varying;
    /* The last n_backdrop tracks form the backdrop: they stay opaque and are never split or pruned.
     */
    size_t n_backdrop;
    bool gather; /* set by the caller: iterations gather statistics for densification */
    /* Set by the caller: iterations render and gather statistics, but do not update the values that
     * frames own. */
    bool hold;
    struct spin_exposures exposures;
    struct spin_train_frame *frame; /* [n_frames] */
    int n_frames;
    bool residuals; /* true if splats or tracks have residual values */
    int sh_degree;  /* degree of the SH that splats own */
    size_t sh_width;
    /* Number of this rank, and number of the ranks that share an iteration. */
    int rank, n_ranks;
    /* Largest number of splats of a frame; pixels and tiles of the largest view. */
    size_t n_max, max_pixels, max_tiles;
    struct spin_train_rates rates;
    struct spin_lazy_adam *lazy; /* lazy Adam of the table; NULL: Adam updates the whole table */
    float lambda_dssim, background[3];
    /* Iterations after which the SH degree rises by one; 0: full degree from the start. */
    int sh_increase_every;
    int64_t iteration; /* number of iterations done */
    struct spin_average average;
    struct spin_field_eval field_eval;
    struct spin_raster raster;
    float SPIN_DEV *d_pos; /* [frames at once][n_max][3] gradients of positions */
    /* [frames at once][SPIN_RESIDUAL n_max] gradients of residual values; NULL if `residuals` is
     * false.
     */
    float SPIN_DEV *d_residual;
    /* [frames at once][sh_width n_max] gradients of SH coefficients beyond the first; NULL if
     * sh_width is 0. */
    float SPIN_DEV *d_sh;
    /* Positions and residual values of splats combined with those of their tracks; NULL if there
     * are no tracks. */
    float SPIN_DEV *means, *residual;
    /* [max_items][SPIN_LOSS_VALUES] losses of the images of an iteration, in device memory. */
    double SPIN_DEV *values;
    double *host_values; /* copy of `values` on the host */
    int *drawn; /* [max_items] index of the item whose losses are in each row of `values` */
    struct spin_rank_sum rank_sum;
    /* With several ranks: gradients of the values that the frames of the batch own, to be summed
     * over ranks; zero between iterations. NULL with one rank. */
    float SPIN_DEV *own_grad;
    int max_items, n_drawn; /* n_drawn: number of rows of `values` in use */
    /* True if a splat is visible in a view that this rank rendered in the iteration. */
    bool seen;
};

/* Allocates the trainer with all its arrays. The caller then sets the times and the rates, and
 * uploads the initial values of parameters, positions, residual values and tracks. */
spin_status spin_trainer_open(struct spin_trainer *t, struct spin_device *device,
                              const struct spin_field *field, const struct spin_trainer_size *size);
/* Adapts the buffers to the numbers of splats in `frame`. densify_tracks.c calls it after it has
 * changed these. */
spin_status spin_trainer_resize(struct spin_trainer *t);
/* Enables lazy Adam, which updates only the lines of the table that an iteration reads. Must be
 * called before the first iteration, after t->rates is set. */
spin_status spin_trainer_enable_lazy_adam(struct spin_trainer *t);
void spin_trainer_close(struct spin_trainer *t);
/* Returns the largest number of frames that the device processes together. */
int spin_trainer_frames_at_once(const struct spin_trainer *t);

/* All-reduces the statistics for densification, of which each rank has a part: afterwards each rank
 * has the whole sums. All ranks must call it. */
spin_status spin_trainer_join_seen(struct spin_trainer *t);
/* Makes the statistics parts of a sum again, after spin_trainer_join_seen(): rank 0 keeps the sums,
 * and the other ranks set theirs to zero, so that the next all-reduce counts each view only once.
 * All ranks must call it. */
void spin_trainer_part_seen(struct spin_trainer *t);

/* Returns the SH degree of the current iteration; it may rise during training. The coefficients of
 * higher degrees must be zero, see spin_field_clear_sh(). */
int spin_trainer_sh_degree(const struct spin_trainer *t);

/* Returns the hash table with all Adam steps applied. With lazy Adam this is a copy, which uses the
 * memory of the gradient: no iteration may run until spin_trainer_put_back() is called. Otherwise
 * it is the table itself. */
float SPIN_DEV *spin_trainer_take_table(struct spin_trainer *t);
void spin_trainer_put_back(struct spin_trainer *t);

/* Returns the learning rate in an iteration, for parameters whose peak rate is lr0. */
double spin_trainer_rate(const struct spin_trainer *t, double lr0, int64_t iteration);
/* Returns the learning rate of positions in the current iteration. */
double spin_trainer_position_rate(const struct spin_trainer *t);
/* Returns the learning rate of static tracks in the current iteration, for values whose peak rate
 * is lr0. It falls within rates.track_iterations iterations instead of all. */
double spin_trainer_track_rate(const struct spin_trainer *t, double lr0);
/* Gives lazy Adam the learning rates of those of the first `done` Adam steps that it lacks. It
 * lacks rates only after a resume, since a checkpoint does not contain them. */
void spin_trainer_catch_up(struct spin_trainer *t, int64_t done);

/* ---- Lazy Adam ------------------------------------------------------------------------------- */

/* Decides whether lazy Adam (device.h, struct spin_lazy_adam) is faster than an update of the whole
 * hash table, and computes the sizes of its memory. */

/* Number of floats by which the start of the table's parameters must be shifted so that the lines
 * of lazy Adam coincide with cache lines. */
size_t spin_lazy_pad(const struct spin_field *field);
/* Number of lines in the hashed levels, the only part of the table that is divided into lines. */
size_t spin_lazy_lines(const struct spin_field *field);
/* True if the evaluation of `splats` splats in an iteration reads, on average, less than half of
 * the lines of a hashed level; if it reads more, lazy Adam saves nothing. False also if lazy Adam
 * does not support the sizes of the table or this number of Adam steps. */
bool spin_lazy_pays(const struct spin_field *field, double splats, int64_t steps);
