/* State of a training between iterations (docs/method.md sections 3 to 7). An iteration is in
 * step.h. */
#pragma once

#include "model/field_eval.h"
#include "render/raster.h"
#include "train/exposure.h"
#include "train/rank_sum.h"
#include "train/train_frame.h"

/* Learning rates: unless noted, each rises linearly over `warmup` iterations and then falls along a
 * cosine to `end`. */
struct spin_train_rates {
    double table, head[SPIN_HEADS], position, exposure, end;
    double residual[SPIN_HEADS]; /* 0: residual values and SH stay fixed */
    double sh;                   /* splats' own SH coefficients beyond the first */
    /* Above 0: rates follow 3DGS, where the position rate decays log-linearly to this value and all
     * other rates are constant. */
    double position_end;
    double floor;   /* final share of the rates of tracks and frames, if above `end` */
    double tracked; /* factor on position and residual rates, for splats with a track */
    double track[SPIN_HEADS], displacement;
    int64_t warmup, iterations;
    int64_t track_iterations; /* iterations, from the first, in which static tracks learn */
    int64_t network_from;     /* iterations before the network joins and its warmup begins */
    bool lenses_stay;         /* falloff is fixed: only gains and offsets learn */
};

/* 3DGS's learning rates of log scale, rotation, colour and opacity. */
extern const double spin_rate_3dgs[SPIN_HEADS];
/* Rates for a single frame in a scene of this extent, as in 3DGS (docs/method.md section 2). The
 * caller sets the rate of the exposure. */
struct spin_train_rates spin_rates_3dgs(double extent, int iterations);

/* Sizes for spin_trainer_open(). */
struct spin_trainer_size {
    int n_frames;
    const struct spin_frame_size *frame; /* [n_frames] */
    bool tracked; /* splats may have tracks and are densified; n_tracks may be 0 even so */
    size_t n_tracks, n_moving, n_varying, n_backdrop;
    bool motion; /* tracks are 4D splats */
    bool network;
    bool alone;    /* a single frame, which this rank trains without the other ranks */
    int sh_degree; /* degree of splats' own SH; 0: only the first coefficient */
    int max_items; /* largest number of images in a batch */
    size_t max_pixels, max_tiles;
    int n_cameras, n_lenses; /* numbers of cameras and lenses that learn exposure and falloff */
    const float *exposure;   /* [n_cameras + n_lenses][SPIN_EXPOSURE] initial values */
};

struct spin_average {     /* see average.h */
    int64_t first, every; /* each `every`-th iteration after `first` is averaged; 0: no average */
    int n;                /* iterations averaged so far */
    size_t n_values;
    float *mean; /* [n_values] in host memory: parameters in the order of state_arrays.h */
};

struct spin_trainer {
    struct spin_device *device;
    struct spin_field field;
    const struct spin_field *network; /* &field, or NULL: no network */
    struct spin_param table, heads;   /* empty without a network */
    struct spin_param tracks;         /* [SPIN_TRACK n_tracks] in groups (device.h) */
    bool tracked;                     /* see spin_trainer_size */
    size_t n_tracks;
    /* [n_tracks][SPIN_MOTION] of tracks that are 4D splats, or NULL. Not trained. */
    float SPIN_DEV *motion;
    /* Numbers of leading tracks whose splats have their own positions, and residual values. */
    size_t n_moving, n_varying;
    size_t n_backdrop; /* trailing tracks that form the backdrop: opaque, never split or pruned */
    bool gather;       /* iterations gather statistics for densification */
    bool hold;         /* iterations render and gather, but do not update the splats */
    struct spin_exposures exposures;
    struct spin_train_frame *frame; /* [n_frames] */
    int n_frames;
    bool residuals; /* splats or tracks have residual values */
    int sh_degree;  /* degree of splats' own SH */
    size_t sh_width;
    int rank, n_ranks;                   /* this rank, among the ranks that share an iteration */
    size_t n_max, max_pixels, max_tiles; /* largest: splats of a frame, size of a view */
    struct spin_train_rates rates;
    struct spin_lazy_adam *lazy; /* lazy Adam of the table; NULL: dense Adam */
    float lambda_dssim, background[3];
    float lambda_scale, lambda_opacity; /* weights: mean scale and opacity of visible splats */
    int sh_increase_every; /* iterations until the SH degree rises; 0: full degree from the start */
    int64_t iteration;     /* iterations done */
    struct spin_average average;
    struct spin_field_eval field_eval;
    struct spin_raster raster;
    float SPIN_DEV *d_pos; /* [frames at once][n_max][3] */
    /* [frames at once][SPIN_RESIDUAL n_max], if splats have residual values. */
    float SPIN_DEV *d_residual;
    float SPIN_DEV *d_sh;             /* [frames at once][sh_width n_max] */
    float SPIN_DEV *means, *residual; /* splats combined with their tracks, if there are any */
    double SPIN_DEV *values;          /* [max_items][SPIN_LOSS_VALUES] losses of an iteration */
    double *host_values;              /* copy of `values` on the host */
    int *drawn;                       /* [max_items] the item of each row of values */
    struct spin_rank_sum rank_sum;
    /* With several ranks: gradients of the values that the batch's frames own; zero between
     * iterations. */
    float SPIN_DEV *own_grad;
    int max_items, n_drawn; /* n_drawn: rows of `values` in use */
    bool seen;              /* a splat is visible in some view of the iteration */
};

/* Allocates everything. The caller then sets parameters, positions, residual values, tracks, times
 * and rates through the device. */
spin_status spin_trainer_open(struct spin_trainer *t, struct spin_device *device,
                              const struct spin_field *field, const struct spin_trainer_size *size);
/* Resizes the buffers after densify_tracks.c has changed the numbers of splats. */
spin_status spin_trainer_resize(struct spin_trainer *t);
/* Enables lazy Adam, which updates only the lines of the table that an iteration needs. Call it
 * before the first iteration, with rates set. */
spin_status spin_trainer_enable_lazy_adam(struct spin_trainer *t);
void spin_trainer_close(struct spin_trainer *t);
/* Largest number of frames that the device processes together. */
int spin_trainer_frames_at_once(const struct spin_trainer *t);

/* All-reduces the statistics for densification: afterwards each rank has the sums. All ranks call
 * it. */
spin_status spin_trainer_join_seen(struct spin_trainer *t);
/* Turns the sums into parts again: rank 0 keeps them and the other ranks start from zero, so that
 * the next all-reduce counts them once. All ranks call it. */
void spin_trainer_part_seen(struct spin_trainer *t);

/* The network; NULL if there is none or it has not joined yet. */
const struct spin_field *spin_trainer_network(const struct spin_trainer *t);

/* SH degree of the current iteration, which may rise during training. Coefficients of higher
 * degrees must be zero, see spin_field_clear_sh(). */
int spin_trainer_sh_degree(const struct spin_trainer *t);

/* Returns the up-to-date table: the parameters themselves or, with lazy Adam, a copy that occupies
 * the memory of the gradient until spin_trainer_put_back(). No iteration may run in between. */
float SPIN_DEV *spin_trainer_take_table(struct spin_trainer *t);
void spin_trainer_put_back(struct spin_trainer *t);

/* Learning rate at an iteration, for the initial rate lr0. */
double spin_trainer_rate(const struct spin_trainer *t, double lr0, int64_t iteration);
/* Current learning rate of positions. */
double spin_trainer_position_rate(const struct spin_trainer *t);
/* Current learning rate of static tracks, which learn in the first track_iterations. */
double spin_trainer_track_rate(const struct spin_trainer *t, double lr0);
/* Learning rate of the network at one of its own steps. */
double spin_trainer_network_rate(const struct spin_trainer *t, double lr0, int64_t step);
/* The network's steps so far: iterations since it joined. */
int64_t spin_trainer_network_steps(const struct spin_trainer *t);
/* Gives lazy Adam the learning rates of the network's first `done` steps. It lacks them after a
 * resume only. */
void spin_trainer_catch_up(struct spin_trainer *t, int64_t done);
