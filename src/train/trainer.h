/* The trainer: the state of a training between iterations (docs/method.md sections 3 to 7). step.h
 * runs an iteration. */
#pragma once

#include "model/field_eval.h"
#include "render/raster.h"
#include "train/train_frame.h"
#include "device/device.h"
#include "io/ranks.h"
#include "scene/lens.h"
#include "model/field.h"

/* ---- Parameters ------------------------------------------------------------------------------ */

/* An array of parameters in device memory, with gradients and Adam moments. */

struct spin_param {
    float SPIN_DEV *p, *g, *m, *v; /* [n] parameters, gradients, first and second moments */
    size_t n, pad;                 /* pad: number of unused floats before each array */
};

/* Allocates the four arrays and sets them to zero. Each array starts `pad` floats after the start
 * of its allocation, see spin_lazy_pad(). Close *param also after a failure. */
spin_status spin_param_open(struct spin_param *param, struct spin_device *d, size_t n, size_t pad);
void spin_param_close(struct spin_param *param, struct spin_device *d);
/* Returns the parameters [first, last) as a group for the device's adam(). step: number of this
 * Adam step, from 1; lr: its learning rate. */
struct spin_param_group spin_param_group(const struct spin_param *param, size_t first, size_t last,
                                         double lr, int64_t step);

/* ---- Exposure and falloff -------------------------------------------------------------------- */

/* Photometric model of the cameras, which is trained together with the scene (math/exposure.h):
 * gain and offset of each camera and falloff of each lens, for each colour channel. */

struct spin_exposures {
    /* [n_cameras + n_lenses][SPIN_EXPOSURE]: first the cameras, then the lenses. Empty (n is 0) if
     * no exposure is learned. */
    struct spin_param param;
    size_t n_cameras;
    /* [3 pixels] rendered images after exposure and falloff were applied, in the layout of blend()
     * (device.h). */
    float SPIN_DEV *exposed;
    size_t pixels;
};

/* Allocates the parameters and copies their initial values from `first`, which has the layout of
 * `param`. pixels: total number of pixels of the images that the device processes at once. If
 * n_cameras is 0, no exposure is learned and nothing is allocated. Close *t also after a failure.
 */
spin_status spin_exposures_open(struct spin_exposures *t, struct spin_device *d, int n_cameras,
                                int n_lenses, const float *first, size_t pixels);
void spin_exposures_close(struct spin_exposures *t, struct spin_device *d);

/* Downloads the current falloffs to *lenses; leaves *lenses unchanged if no exposure is learned. */
spin_status spin_exposures_read_lenses(const struct spin_exposures *t, struct spin_device *d,
                                       struct spin_lenses *lenses);

/* Call it after each Adam step. A common gain or offset of all cameras could also be learned as
 * splat colours, so this shifts the log gains and the offsets of all cameras to a mean of 0. A
 * held-out view, whose exposure is unknown, is thus rendered with the mean exposure. Falloffs are
 * unambiguous, since they are 1 at the image centre. */
void spin_exposures_centre(struct spin_exposures *t, struct spin_device *d);

/* ---- All-reduce of device memory ------------------------------------------------------------- */

/* All-reduce (io/ranks.h) of values in device memory. On the CPU device, which uses host memory,
 * MPI sums the values in place. The values of a GPU are downloaded, summed by MPI and uploaded; the
 * staging memory on the host is page-locked if possible (host_reserve() of device.h), which saves a
 * copy. */

/* State of the all-reduce on this rank. All members are zero if there is only one rank. */
struct spin_rank_sum {
    struct spin_device *device;
    struct spin_host_memory host; /* staging memory for the values of a GPU */
};

/* All ranks must call it. With -v, logs whether the staging memory is page-locked. */
spin_status spin_rank_sum_open(struct spin_rank_sum *s, struct spin_device *device);
void spin_rank_sum_close(struct spin_rank_sum *s);

/* Waits for the queued work of the device and all-reduces an array: replaces its n values by the
 * sums over all ranks, added element by element. kind: SPIN_SUM_F32 or SPIN_SUM_U32. All ranks must
 * call it with the same n and kind. The sums are bit-identical on all ranks, and reproducible with
 * the same number of ranks. Fails if memory is exhausted, the device fails, or another rank has
 * failed. Does nothing with a single rank. */
spin_status spin_rank_sum(struct spin_rank_sum *s, void SPIN_DEV *at, size_t n, int kind);

/* ---- State of a training --------------------------------------------------------------------- */

/* Peak learning rates. Unless noted, a rate rises linearly to its peak in `warmup` iterations and
 * then falls along a cosine to `end` in the last iteration. */
struct spin_train_rates {
    double table, head[SPIN_HEADS], position, exposure, end;
    /* If residual[SPIN_HEAD_SCALE] is 0, neither the residual values nor the SH coefficients beyond
     * the first are trained, even if `sh` is above 0. */
    double residual[SPIN_HEADS];
    double sh; /* rate of the SH coefficients beyond the first that splats own */
    /* If above 0, all rates follow 3DGS instead: the position rate decays log-linearly from
     * `position` to position_end, and all other rates are constant. */
    double position_end;
    /* Rates fall to this share of their peak, or to `end` if that is larger. Exception: the rates
     * of static tracks always fall to `end` if track_iterations is less than `iterations`. */
    double floor;
    double tracked; /* factor on `position` and `residual` for splats with a track */
    double track[SPIN_HEADS], displacement;
    int64_t warmup, iterations;
    /* Number of iterations in which the rates of static tracks fall to `end`, where they then
     * remain; if equal to `iterations`, static tracks are trained like all other parameters. */
    int64_t track_iterations;
    bool lenses_stay; /* true if falloffs are not trained, only gains and offsets */
};

/* Learning rates of 3DGS for log scale, rotation, colour and opacity. */
extern const double spin_rate_3dgs[SPIN_HEADS];
/* Returns the rates of 3DGS for training a single frame (docs/method.md section 2). extent: extent
 * of the training cameras. The caller sets the rate of the exposure. */
struct spin_train_rates spin_rates_3dgs(double extent, int iterations);

/* Sizes and kinds of the arrays that spin_trainer_open() allocates. */
struct spin_trainer_size {
    int n_frames;
    const struct spin_frame_size *frame; /* [n_frames] */
    /* True if splats may have tracks, and densification statistics are gathered; n_tracks may
     * nevertheless be 0. */
    bool tracked;
    size_t n_tracks, n_moving, n_varying, n_backdrop;
    bool motion;  /* true if tracks are 4D splats, with velocities and Gaussian windows */
    bool network; /* true if there is a network */
    /* True for the training of a single frame, which this rank does without the other ranks. */
    bool alone;
    int sh_degree; /* SH degree of the splats' own coefficients; 0: only the first coefficient */
    /* Folder of the temporary files that contain the arrays of the frames; NULL: device memory. */
    const char *scratch;
    int max_items; /* largest number of images in a batch */
    size_t max_pixels, max_tiles;
    /* Number of cameras whose exposure is learned, and number of lenses. If n_cameras is 0, neither
     * exposures nor falloffs are learned. */
    int n_cameras, n_lenses;
    /* [n_cameras + n_lenses][SPIN_EXPOSURE] initial values of the exposure parameters. */
    const float *exposure;
};

struct spin_average { /* the Polyak average, see checkpoint.h */
    /* The last iteration is averaged, and every `every`-th iteration before it, back to `first`
     * (excluded). every 0: there is no average. */
    int64_t first, every;
    int n; /* number of iterations averaged so far */
    size_t n_values;
    /* [n_values] mean of the parameters, in host memory, in the order of spin_state_arrays(). */
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
    /* [n_tracks][SPIN_MOTION] if tracks are 4D splats: their velocities and windows, which are not
     * trained; otherwise NULL. */
    float SPIN_DEV *motion;
    /* The first n_moving tracks are dynamic: their splats own positions. The splats of the first
     * n_varying tracks own residual values. */
    size_t n_moving, n_varying;
    /* The last n_backdrop tracks are the backdrop: their opacity is fixed, and they are neither
     * split nor pruned. */
    size_t n_backdrop;
    bool gather;   /* set by the caller: iterations gather densification statistics */
    bool absolute; /* set by the caller: of absolute gradients, see struct spin_view_batch */
    /* Set by the caller: the next iteration renders and gathers statistics, but skips the Adam step
     * of the values that frames own. */
    bool hold;
    struct spin_exposures exposures;
    struct spin_train_frame *frame; /* [n_frames] */
    int n_frames;
    const char *scratch; /* see spin_trainer_size */
    bool residuals;      /* true if splats or tracks have residual values */
    int sh_degree;       /* SH degree of the splats' own coefficients */
    size_t sh_width;
    /* Index of this rank, and number of ranks that share an iteration. */
    int rank, n_ranks;
    /* Largest number of splats of any frame; largest numbers of pixels and tiles of any view. */
    size_t n_max, max_pixels, max_tiles;
    struct spin_train_rates rates;
    struct spin_lazy_adam *lazy; /* lazy Adam of the table; NULL: the whole table is updated */
    float lambda_dssim, background[3];
    /* Number of iterations between increases of the SH degree; 0: full degree from the start. */
    int sh_increase_every;
    int64_t iteration; /* number of finished iterations */
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
    /* [frames at once][n_max] positions and residual values of splats with the values of their
     * tracks added; NULL if there are no tracks. */
    float SPIN_DEV *means, *residual;
    /* [max_items][SPIN_LOSS_VALUES] losses of the images of an iteration, in device memory. */
    double SPIN_DEV *values;
    double *host_values; /* copy of `values` on the host */
    int *drawn;          /* [max_items] item whose losses are in each row of `values` */
    struct spin_rank_sum rank_sum;
    /* With several ranks: buffer for the all-reduce of the gradients of the values that the frames
     * of a batch own; zero between iterations. NULL with a single rank. */
    float SPIN_DEV *own_grad;
    int max_items, n_drawn; /* n_drawn: number of rows of `values` in use */
    /* True if any splat was visible in a view that this rank rendered in the current iteration. */
    bool seen;
};

/* Allocates the trainer with all its arrays. The caller then sets the times of the frames and the
 * learning rates, and uploads the initial values of network, positions, residual values and tracks.
 */
spin_status spin_trainer_open(struct spin_trainer *t, struct spin_device *device,
                              const struct spin_field *field, const struct spin_trainer_size *size);
/* Adapts the buffers to the numbers of splats in t->frame after a densification. */
spin_status spin_trainer_resize(struct spin_trainer *t);
/* Enables lazy Adam, which updates only the lines of the table that an iteration reads. Call it
 * after t->rates is set and before the first iteration. */
spin_status spin_trainer_enable_lazy_adam(struct spin_trainer *t);
void spin_trainer_close(struct spin_trainer *t);
/* Returns the largest number of frames that the device processes at once. */
int spin_trainer_frames_at_once(const struct spin_trainer *t);

/* All-reduces the densification statistics, which each rank gathers over its own views: afterwards,
 * all ranks have the sums. All ranks must call it. */
spin_status spin_trainer_join_seen(struct spin_trainer *t);
/* Must be called by all ranks after spin_trainer_join_seen() if statistics are gathered further:
 * rank 0 keeps the sums and all other ranks clear theirs, so that the next all-reduce counts each
 * view only once. */
void spin_trainer_part_seen(struct spin_trainer *t);
/* Releases the statistics of all frames, when no densification follows. */
void spin_trainer_drop_statistics(struct spin_trainer *t);

/* Returns the SH degree of the current iteration, which may rise during the training. The
 * coefficients of higher degrees must be zero, see spin_field_clear_sh(). */
int spin_trainer_sh_degree(const struct spin_trainer *t);

/* Returns the hash table with all Adam steps applied. Without lazy Adam, it is the table itself.
 * With lazy Adam, it is a copy in the memory of the gradient, so no iteration may run until
 * spin_trainer_put_back() is called. */
float SPIN_DEV *spin_trainer_take_table(struct spin_trainer *t);
void spin_trainer_put_back(struct spin_trainer *t);

/* Returns the learning rate of parameters with the peak rate lr0 in an iteration. */
double spin_trainer_rate(const struct spin_trainer *t, double lr0, int64_t iteration);
/* Returns the learning rate of positions in the current iteration. */
double spin_trainer_position_rate(const struct spin_trainer *t);
/* Returns the learning rate of values of static tracks with the peak rate lr0 in the current
 * iteration. It reaches its final value after rates.track_iterations iterations. */
double spin_trainer_track_rate(const struct spin_trainer *t, double lr0);
/* Passes the learning rates of the first `done` Adam steps to lazy Adam, except those that it
 * already has. This is necessary after a resume, since a checkpoint does not contain them. */
void spin_trainer_catch_up(struct spin_trainer *t, int64_t done);

/* ---- Lazy Adam ------------------------------------------------------------------------------- */

/* Decides whether lazy Adam (device.h, struct spin_lazy_adam) is faster than updating the whole
 * hash table, and computes the layout of its lines. */

/* Returns the `pad` of spin_param_open() for the hash table, with which the lines of lazy Adam
 * coincide with cache lines. */
size_t spin_lazy_pad(const struct spin_field *field);
/* Returns the number of lines in the hashed levels. Dense levels are not divided into lines. */
size_t spin_lazy_lines(const struct spin_field *field);
/* True if an iteration that evaluates `splats` splats reads, on average, less than half of the
 * lines of a hashed level; otherwise lazy Adam is not faster. Also false if lazy Adam does not
 * support the size of the table or this number of Adam steps. */
bool spin_lazy_pays(const struct spin_field *field, double splats, int64_t steps);
