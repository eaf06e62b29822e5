/* Converts a trained clip to 4D splats (--method 4d): each track is cut into segments in which it
 * moves on a straight line and looks the same; a splat without a track is a segment by itself. A
 * segment becomes a row: a splat with a velocity, and a Gaussian window over the times at which it
 * is visible. Training treats a row as a track with motion (device.h). */
#pragma once

#include "train/frames.h"

struct spin_rows_4d {
    size_t n, capacity;
    float *values;  /* [n][SPIN_TRACK] position, then a row of residual values (model/residual.h) */
    float *motion;  /* [n][SPIN_MOTION] in the unit of spin_field_time() */
    size_t n_whole; /* rows that cover all frames and have a constant window */
    int n_frames;
    uint32_t **of;  /* [frames][counts] the rows drawn in a frame, ascending */
    size_t *counts; /* [frames] */
};

/* Rows are drawn in a frame if their Gaussian window is at least this. */
extern const double spin_rows_4d_least_weight;

/* Cuts the clip of the plan's input into rows, and sets the numbers of splats in the plan.
 * SPIN_E_NOT_FOUND unless the clip was trained with --method tracks, SPIN_E_UNSUPPORTED if frames
 * are not in the order of their times. Zero it first; close it also after a failure. */
spin_status spin_rows_4d_cut(struct spin_rows_4d *rows, struct spin_plan *plan);
void spin_rows_4d_close(struct spin_rows_4d *rows);
/* Restores the gains and falloffs that the input was trained with, instead of measuring them. */
spin_status spin_rows_4d_looks(struct spin_plan *plan);
/* Uploads the rows and the list of rows of each frame. Replaces spin_frames_load(). */
spin_status spin_rows_4d_load(const struct spin_rows_4d *rows, const struct spin_plan *plan,
                              struct spin_trainer *trainer, struct spin_frames *frames);
/* Downloads the current rows, rounds them and passes them through spin_splats_4d_settle(). The
 * caller frees *out, also after a failure. */
spin_status spin_rows_4d_read(const struct spin_plan *plan, struct spin_trainer *trainer,
                              enum spin_round_4d round, struct spin_splats_4d *out);
