/* One training step of the network, and what it keeps between steps (method.md sections 3 to 7). The
 * loop around it - data, schedule of views, evaluation, checkpoints - is retrain*.c. */
#ifndef SPIN_TRAIN_STEP_H
#define SPIN_TRAIN_STEP_H

#include "train/lazy_adam.h"
#include "model/field.h"
#include "render/raster.h"
#include "train/exposure.h"

/* Positions of one frame. Their moments and step counter stand still while the frame is not in the
 * batch (method.md section 6). */
struct spin_train_frame {
    size_t n;
    double time;        /* in the source's unit */
    float *pos, *m, *v; /* [n][3] on the device */
    float *residual, *residual_m,
        *residual_v; /* [SPIN_RESIDUAL n], or NULL: splats have nothing of their own */
    int64_t steps;
};

struct spin_train_rates {
    double table, head[SPIN_HEADS], position, exposure, end;
    double residual[SPIN_HEADS]; /* 0: own values stay as they are */
    int64_t warmup, iterations;
};

struct spin_trainer {
    struct spin_device *device;
    struct spin_field field;
    struct spin_param table, heads;
    struct spin_exposures exposures;
    struct spin_train_frame *frame; /* [n_frames] */
    int n_frames;
    size_t n_max, max_pixels, max_tiles;
    struct spin_train_rates rates;
    struct spin_lazy_table lazy; /* of the table, when that pays */
    float lambda_dssim, background[3];
    float lambda_scale, lambda_opacity; /* on the mean scale and opacity of what a step sees */
    int sh_increase_every; /* steps until the next degree of SH joins; 0: all from the start */
    int64_t iteration;     /* steps done */
    struct spin_field_eval field_eval;
    struct spin_raster raster;
    float *d_pos;      /* [n_max][3] */
    float *d_residual; /* [SPIN_RESIDUAL n_max], when splats have values of their own */
};

/* One picture of a batch. */
struct spin_train_item {
    int frame;
    struct spin_target taken;
};

struct spin_train_values {
    double loss, l1, ssim; /* means over the batch */
    bool seen;             /* some view shows a splat */
    double *each;          /* [n] losses, when not NULL */
};

/* Reserve everything for frames of counts[f] splats, pictures up to max_pixels, and the colours of
 * n_exposures cameras (0: none are learned), and values of every splat's own if so. The caller then fills
 * parameters, positions, own values, times and rates through the device. */
spin_status spin_trainer_open(struct spin_trainer *t, struct spin_device *device,
                              const struct spin_field *field, int n_frames, const size_t *counts,
                              size_t max_pixels, size_t max_tiles, int n_exposures, bool residual);
/* Leave lines of the table alone until they are needed. Before the first step; rates are set. */
spin_status spin_trainer_enable_lazy_adam(struct spin_trainer *t);
void spin_trainer_close(struct spin_trainer *t);
/* Bytes that open will reserve, and about as much as the ops' scratch comes to. */
size_t spin_trainer_bytes(const struct spin_field *field, int n_frames, const size_t *counts,
                          size_t max_pixels, bool residual);

/* One iteration: the mean loss of the items, its gradient, one Adam step. Items of one frame share
 * one decoding. Fails only when the rasteriser's lists cannot grow, or the device failed. */
spin_status spin_trainer_step(struct spin_trainer *t, const struct spin_train_item *items, int n,
                              struct spin_train_values *values);

/* The degree of SH that the step under way draws with: the colours of a still scene first, what
 * depends on the direction later. Above it there must be zeros, spin_field_clear_sh(). */
int spin_trainer_sh_degree(const struct spin_trainer *t);

/* The table as it is now: the parameters, or for a lazy one a copy in the place of the gradient,
 * until spin_trainer_put_back(). No step may come between. */
float *spin_trainer_take_table(struct spin_trainer *t);
void spin_trainer_put_back(struct spin_trainer *t);

#endif
