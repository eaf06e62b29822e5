/* Converts a trained clip to 4D splats (--method 4d). Each track is divided into segments of
 * consecutive frames in which its splat moves on a straight line and its other values are constant,
 * within a tolerance; a splat without a track is a segment of one frame. Each segment becomes a
 * row, that is, one 4D splat: a splat with a velocity, and with a Gaussian window over the times of
 * the segment. The trainer treats each row as a track with motion (device.h). */
#pragma once

#include "train/training_frames.h"

struct spin_rows_4d {
    size_t n, capacity;
    /* [n][SPIN_TRACK] position and residual values (model/field.h) of each row. */
    float *values;
    /* [n][SPIN_MOTION] motion of each row (device.h). The unit of time is that of
     * spin_field_time(), in which the clip lasts from 0 to 1. */
    float *motion;
    /* Number of rows whose segment consists of all frames; the window of such a row is constant. */
    size_t n_whole;
    int n_frames;
    /* [frames][counts] indices of the rows that are rendered in each frame, in ascending order. */
    uint32_t **of;
    size_t *counts; /* [frames] number of rows that are rendered in each frame */
};

/* A row is rendered in a frame if its Gaussian window at the time of the frame is at least this
 * value. */
extern const double spin_rows_4d_least_weight;

/* Divides the tracks of the input into rows, and sets the numbers of splats in the plan to those of
 * the rows. SPIN_E_NOT_FOUND if the input was not trained with --method tracks; SPIN_E_UNSUPPORTED
 * if its frames are not in the order of their times. Zero *rows before the call, and close it also
 * after a failure. */
spin_status spin_rows_4d_cut(struct spin_rows_4d *rows, struct spin_plan *plan);
void spin_rows_4d_close(struct spin_rows_4d *rows);
/* Replaces the measured exposures and falloffs of the plan by those that the training of the input
 * learned. */
spin_status spin_rows_4d_photometric(struct spin_plan *plan);
/* Uploads the rows, and for each frame the list of rows that are rendered in it. It is called
 * instead of spin_frames_load() with --method 4d. */
spin_status spin_rows_4d_load(const struct spin_rows_4d *rows, const struct spin_plan *plan,
                              struct spin_trainer *trainer, struct spin_frames *frames);
/* Downloads the current rows to *out, rounds their values and calls spin_splats_4d_finish(). The
 * caller frees *out, also after a failure. */
spin_status spin_rows_4d_read(const struct spin_plan *plan, struct spin_trainer *trainer,
                              enum spin_round_4d round, struct spin_splats_4d *out);
