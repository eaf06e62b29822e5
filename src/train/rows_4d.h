/* Converts a trained clip to 4D splats (--method 4d): each track is cut into segments, during which
 * its splat moves on a straight line and does not change otherwise; a splat without a track is a
 * segment of one frame. Each segment becomes a row, which is one 4D splat: a splat with a velocity,
 * and with a Gaussian window over the times of the segment. Training treats a row as a track with
 * motion (device.h). */
#pragma once

#include "train/training_frames.h"

struct spin_rows_4d {
    size_t n, capacity;
    /* [n][SPIN_TRACK] each row: position, then residual values (model/residual.h). */
    float *values;
    /* [n][SPIN_MOTION] motion of each row (device.h), with times as those of spin_field_time(). */
    float *motion;
    /* Number of rows whose segment covers all frames, so that their window is constant. */
    size_t n_whole;
    int n_frames;
    /* [frames][counts] indices of the rows that are drawn in each frame, ascending. */
    uint32_t **of;
    size_t *counts; /* [frames] number of rows that are drawn in each frame */
};

/* A row is drawn in the frames at whose time its Gaussian window has at least this value. */
extern const double spin_rows_4d_least_weight;

/* Cuts the clip of the plan's input into rows, and sets the numbers of splats in the plan to those
 * of the rows. SPIN_E_NOT_FOUND if the clip was not trained with --method tracks;
 * SPIN_E_UNSUPPORTED if its frames are not in the order of their times. Zero *rows first; close it
 * also after a failure. */
spin_status spin_rows_4d_cut(struct spin_rows_4d *rows, struct spin_plan *plan);
void spin_rows_4d_close(struct spin_rows_4d *rows);
/* Sets the initial exposures and falloffs of the plan to those that were learned in the training of
 * the input, which replace measured ones. */
spin_status spin_rows_4d_photometric(struct spin_plan *plan);
/* Uploads the rows, and for each frame the list of its rows. With --method 4d it is called instead
 * of spin_frames_load(). */
spin_status spin_rows_4d_load(const struct spin_rows_4d *rows, const struct spin_plan *plan,
                              struct spin_trainer *trainer, struct spin_frames *frames);
/* Downloads the current rows, rounds their values and calls spin_splats_4d_finish() for them. The
 * caller frees *out, also after a failure. */
spin_status spin_rows_4d_read(const struct spin_plan *plan, struct spin_trainer *trainer,
                              enum spin_round_4d round, struct spin_splats_4d *out);
