/* State of a training between iterations (docs/method.md sections 3 to 7). An iteration is in
 * step.h. */
#pragma once

#include "model/field_eval.h"
#include "render/raster.h"
#include "train/exposure.h"
#include "train/rank_sum.h"
#include "train/train_frame.h"

struct spin_train_rates {
    double table, head[SPIN_HEADS], position, exposure, end;
    double residual[SPIN_HEADS]; /* 0: residual values and SH do not change */
    double sh;                   /* of splats' own SH beyond the first coefficient */
    /* As in 3DGS: the position rate decays log-linearly to this one, and all others are constant;
     * 0: not so. */
    double position_end;
    double floor;   /* share of the initial rates at which those of tracks and frames end */
    double tracked; /* factor on position and residual rates, for splats with a track */
    double track[SPIN_HEADS], displacement;
    int64_t warmup, iterations;
    int64_t track_iterations; /* static tracks learn in this many first iterations */
    int64_t network_from;     /* the network and its rates begin after so many iterations */
    bool lenses_stay;         /* lenses keep their falloff; only cameras' gains and offsets learn */
};

/* 3DGS's rates of log scale, rotation, colour and opacity; and all rates for a single frame in a
 * scene of this extent, except that of the exposure (docs/method.md section 2) */
extern const double spin_rate_3dgs[SPIN_HEADS];
struct spin_train_rates spin_rates_3dgs(double extent, int iterations);

/* Sizes for spin_trainer_open(). */
struct spin_trainer_size {
    int n_frames;
    const struct spin_frame_size *frame; /* [n_frames] */
    bool tracked; /* splats may have tracks, and are densified; n_tracks may still be 0 */
    size_t n_tracks, n_moving, n_varying, n_backdrop;
    bool motion; /* tracks are 4D splats */
    bool network;
    bool alone;    /* a single frame: this rank does the work without the others */
    int sh_degree; /* of splats' own SH; 0: only the first coefficient */
    int max_items; /* images of a batch */
    size_t max_pixels, max_tiles;
    int n_cameras, n_lenses; /* that learn exposure and falloff */
    const float *exposure;   /* [n_cameras + n_lenses][SPIN_EXPOSURE] initial values */
};

struct spin_average {     /* see average.h */
    int64_t first, every; /* every so many iterations after the first one counts; 0: none */
    int n;                /* iterations that have counted */
    size_t n_values;
    float *mean; /* [n_values] in host memory: the parameters of state_arrays.h in their order */
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
    /* The first of them, whose splats have own positions, and own residual values. */
    size_t n_moving, n_varying;
    size_t n_backdrop; /* the last tracks: opaque, never split or pruned */
    bool gather;       /* statistics for densification */
    bool hold;         /* an iteration draws and gathers, but does not update the splats' values */
    struct spin_exposures exposures;
    struct spin_train_frame *frame; /* [n_frames] */
    int n_frames;
    bool residuals; /* splats have values besides the network's */
    int sh_degree;  /* of splats' own SH */
    size_t sh_width;
    int rank, n_ranks; /* of those that share an iteration */
    size_t n_max, max_pixels, max_tiles;
    struct spin_train_rates rates;
    struct spin_lazy_adam *lazy; /* of the table, if it pays; else NULL */
    float lambda_dssim, background[3];
    float lambda_scale, lambda_opacity; /* weights of mean scale and opacity, of drawn splats */
    int sh_increase_every; /* iterations until the next degree of SH joins; 0: all from the start */
    int64_t iteration;     /* iterations done */
    struct spin_average average;
    struct spin_field_eval field_eval;
    struct spin_raster raster;
    float SPIN_DEV *d_pos; /* [frames at once][n_max][3] */
    /* [frames at once][SPIN_RESIDUAL n_max], if splats have residual values. */
    float SPIN_DEV *d_residual;
    float SPIN_DEV *d_sh;             /* [frames at once][sh_width n_max] */
    float SPIN_DEV *means, *residual; /* splats combined with their tracks, if there are any */
    double SPIN_DEV *values;          /* [max_items][SPIN_LOSS_VALUES] of an iteration */
    double *host_values;              /* their copy on the host */
    int *drawn;                       /* [max_items] the item of each row of values */
    struct spin_rank_sum rank_sum;
    /* With several ranks: gradients of the own values of a batch's frames; zeros between
     * iterations. */
    float SPIN_DEV *own_grad;
    int max_items, n_drawn;
    bool seen; /* a splat is visible in some view of the iteration */
};

/* Allocates everything. The caller then sets parameters, positions, residual values, tracks, times
 * and rates through the device. */
spin_status spin_trainer_open(struct spin_trainer *t, struct spin_device *device,
                              const struct spin_field *field, const struct spin_trainer_size *size);
/* Fits the buffers to the number of splats, which densify_tracks.c has changed. */
spin_status spin_trainer_resize(struct spin_trainer *t);
/* Updates only the lines of the table that an iteration needs. Call it before the first iteration,
 * with rates set. */
spin_status spin_trainer_enable_lazy_adam(struct spin_trainer *t);
void spin_trainer_close(struct spin_trainer *t);
/* Frames that the device processes together, at most. */
int spin_trainer_frames_at_once(const struct spin_trainer *t);

/* Statistics for densification: all-reduces them, so that each rank has the sums; and turns them
 * into parts again, of which rank 0 has everything. All ranks call both. */
spin_status spin_trainer_join_seen(struct spin_trainer *t);
void spin_trainer_part_seen(struct spin_trainer *t);

/* The network, or NULL: there is none, or it has not joined yet. */
const struct spin_field *spin_trainer_network(const struct spin_trainer *t);

/* SH degree of the current iteration: colours that depend on the direction join later. Coefficients
 * beyond it must be zero, see spin_field_clear_sh(). */
int spin_trainer_sh_degree(const struct spin_trainer *t);

/* The current table: the parameters themselves or, with lazy Adam, a copy in place of the gradient
 * until spin_trainer_put_back(). No iteration may run in between. */
float SPIN_DEV *spin_trainer_take_table(struct spin_trainer *t);
void spin_trainer_put_back(struct spin_trainer *t);

/* Current rates for an initial rate lr0: in general; of positions; of static tracks, which learn in
 * the first iterations; and of the network, which may join later and counts its own steps. */
double spin_trainer_rate(const struct spin_trainer *t, double lr0, int64_t iteration);
double spin_trainer_position_rate(const struct spin_trainer *t);
double spin_trainer_track_rate(const struct spin_trainer *t, double lr0);
double spin_trainer_network_rate(const struct spin_trainer *t, double lr0, int64_t step);
int64_t spin_trainer_network_steps(const struct spin_trainer *t);
/* After a resume, records the rates of the iterations before it, which lazy Adam needs. */
void spin_trainer_catch_up(struct spin_trainer *t, int64_t done);
