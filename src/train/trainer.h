/* What a training keeps between steps, and where it lies (docs/method.md sections 3 to 7). A step
 * is in step.h. */
#pragma once

#include "model/field_eval.h"
#include "render/raster.h"
#include "train/exposure.h"
#include "train/rank_sum.h"
#include "train/train_frame.h"

struct spin_train_rates {
    double table, head[SPIN_HEADS], position, exposure, end;
    double residual[SPIN_HEADS]; /* 0: residual values stay as they are, and so does SH */
    double sh;                   /* of splats' own SH beyond the first coefficient */
    double position_end; /* as in 3DGS: positions' rate comes log-linearly to this one, all others
                            stay; 0: no */
    double floor;        /* share of the first rates at which those of tracks and frames end */
    double tracked;      /* on position and residual, for splats with a track */
    double track[SPIN_HEADS], displacement;
    int64_t warmup, iterations;
    int64_t track_iterations; /* the first of them: tracks that stand still learn in these */
    int64_t network_from; /* the network joins after this many iterations: its rates begin then */
    bool lenses_stay;     /* of exposures only those of cameras learn */
};

/* 3DGS's rates of log scale, rotation, colour and opacity; and all for a frame by itself in a scene
 * of this extent, but for the exposure (docs/method.md section 2). */
extern const double spin_rate_3dgs[SPIN_HEADS];
struct spin_train_rates spin_rates_3dgs(double extent, int iterations);

/* What there is memory for. */
struct spin_trainer_size {
    int n_frames;
    const struct spin_frame_size *frame; /* [n_frames] */
    bool tracked; /* splats may have tracks, and are densified; n_tracks may still be 0 */
    size_t n_tracks, n_moving, n_varying, n_backdrop;
    bool motion; /* tracks are 4D splats */
    bool network;
    bool alone;    /* the work is this rank's, and shares nothing with others */
    int sh_degree; /* of splats' own SH; 0: the colour alone */
    int max_items; /* pictures of a batch */
    size_t max_pixels, max_tiles;
    int n_cameras, n_lenses; /* whose exposure and falloff are learned */
    const float *exposure;   /* [n_cameras + n_lenses][SPIN_EXPOSURE] what they begin with */
};

struct spin_average {     /* see average.h */
    int64_t first, every; /* iterations that count: after the first, in steps of this; 0: none */
    int n;                /* that have counted */
    size_t n_values;
    float *mean; /* [n_values] in the host's memory: the parameters of state_arrays.h in turn */
};

struct spin_trainer {
    struct spin_device *device;
    struct spin_field field;
    const struct spin_field *network; /* the same, or NULL: there is none */
    struct spin_param table, heads;   /* empty without a network */
    struct spin_param tracks;         /* [SPIN_TRACK n_tracks] in groups (device.h) */
    bool tracked;                     /* as in spin_trainer_size */
    size_t n_tracks;
    float SPIN_DEV *motion;     /* [n_tracks][SPIN_MOTION] of tracks that are 4D splats, or NULL; it
                                   stays as it is */
    size_t n_moving, n_varying; /* the first of them: their splats have positions, residual values,
                                   of their own */
    size_t n_backdrop;          /* the last tracks: opaque, never split or pruned */
    bool gather;                /* what densification goes by */
    bool hold; /* a step draws and gathers, and leaves the splats' values as they are */
    struct spin_exposures exposures;
    struct spin_train_frame *frame; /* [n_frames] */
    int n_frames;
    bool residuals; /* splats have values besides the network's */
    int sh_degree;  /* of splats' own SH */
    size_t sh_width;
    int rank, n_ranks; /* that share the steps */
    size_t n_max, max_pixels, max_tiles;
    struct spin_train_rates rates;
    struct spin_lazy_adam *lazy; /* of the table, as that pays; else NULL */
    float lambda_dssim, background[3];
    float lambda_scale, lambda_opacity; /* on the mean scale and opacity of what a step sees */
    int sh_increase_every; /* steps until the next degree of SH joins; 0: all from the start */
    int64_t iteration;     /* steps done */
    struct spin_average average;
    struct spin_field_eval field_eval;
    struct spin_raster raster;
    float SPIN_DEV *d_pos;      /* [frames at once][n_max][3] */
    float SPIN_DEV *d_residual; /* [frames at once][SPIN_RESIDUAL n_max], when splats have
                              residual values */
    float SPIN_DEV *d_sh;       /* [frames at once][sh_width n_max] */
    float SPIN_DEV *means,
        *residual;           /* of splats with what their tracks add, where there are some */
    double SPIN_DEV *values; /* [max_items][SPIN_LOSS_VALUES] of a step */
    double *host_values;     /* the same */
    int *drawn;              /* [max_items] the item of each row of values */
    struct spin_rank_sum rank_sum;
    float SPIN_DEV *own_grad; /* with several ranks: gradients of the own values of a batch's
                                 frames; zeros between steps */
    int max_items, n_drawn;
    bool seen; /* some view of the step shows a splat */
};

/* Reserve everything. The caller then fills parameters, positions, residual values, tracks, times
 * and rates through the device. */
spin_status spin_trainer_open(struct spin_trainer *t, struct spin_device *device,
                              const struct spin_field *field, const struct spin_trainer_size *size);
/* The number of splats has changed (densify_tracks.c): make the buffers fit. */
spin_status spin_trainer_resize(struct spin_trainer *t);
/* Update only the lines of the table that a step needs. Before the first step; rates are set. */
spin_status spin_trainer_enable_lazy_adam(struct spin_trainer *t);
void spin_trainer_close(struct spin_trainer *t);
/* Frames that go through the device together, at most. */
int spin_trainer_frames_at_once(const struct spin_trainer *t);

/* What densification goes by, of all ranks: the sums on each; and back to parts, which rank 0 has.
 * All ranks call them. */
spin_status spin_trainer_join_seen(struct spin_trainer *t);
void spin_trainer_part_seen(struct spin_trainer *t);

/* The network, or NULL: there is none, or it has not joined yet. */
const struct spin_field *spin_trainer_network(const struct spin_trainer *t);

/* The degree of SH that the step under way draws with: the colours of a still scene first, what
 * depends on the direction later. Above it there must be zeros, spin_field_clear_sh(). */
int spin_trainer_sh_degree(const struct spin_trainer *t);

/* The table as it is now: the parameters, or with lazy Adam a copy in the place of the gradient,
 * until spin_trainer_put_back(). No step may come between. */
float SPIN_DEV *spin_trainer_take_table(struct spin_trainer *t);
void spin_trainer_put_back(struct spin_trainer *t);

/* Rates now, of what begins with lr0: of all that is trained; of tracks, which learn in the first
 * steps; and of the network, which may join later and counts its own steps. */
double spin_trainer_rate(const struct spin_trainer *t, double lr0, int64_t iteration);
double spin_trainer_position_rate(const struct spin_trainer *t);
double spin_trainer_track_rate(const struct spin_trainer *t, double lr0);
double spin_trainer_network_rate(const struct spin_trainer *t, double lr0, int64_t step);
int64_t spin_trainer_network_steps(const struct spin_trainer *t);
/* After a resume the rates of the steps before it are noted again, for lazy Adam. */
void spin_trainer_catch_up(struct spin_trainer *t, int64_t done);
