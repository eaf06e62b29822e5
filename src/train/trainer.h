/* State of a training between iterations (docs/method.md sections 3 to 7). step.h runs an
 * iteration. */
#pragma once

#include "model/field_eval.h"
#include "render/raster.h"
#include "train/exposure.h"
#include "train/rank_sum.h"
#include "train/train_frame.h"

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
