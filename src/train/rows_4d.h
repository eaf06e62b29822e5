/* The splats of a trained clip as 4D splats (--method 4d): each of its tracks is cut into pieces
 * along which it goes straight and looks the same; a splat without a track is one by itself. A
 * piece is a row: a splat with a velocity, and a bell over the times in which it is seen. In
 * training a row is a track with motion (device.h). */
#pragma once

#include "train/frames.h"

struct spin_rows_4d {
    size_t n, capacity;
    float *values;  /* [n][SPIN_TRACK] place, then a row of residual values (model/residual.h) */
    float *motion;  /* [n][SPIN_MOTION] in the unit of spin_field_time() */
    size_t n_whole; /* of them those that all frames show alike: their bell does not fall */
    int n_frames;
    uint32_t **of;  /* [frames][counts] the rows that a frame shows, ascending */
    size_t *counts; /* [frames] */
};

/* The weight from which a row is part of a frame. */
extern const double spin_rows_4d_least_weight;

/* From the clip that plan's input holds; SPIN_E_NOT_FOUND where --method tracks did not train it.
 * Sets how many splats the plan's frames have. Zero it first; close it also after a failure. */
spin_status spin_rows_4d_cut(struct spin_rows_4d *rows, struct spin_plan *plan);
void spin_rows_4d_close(struct spin_rows_4d *rows);
/* The gains and falloffs that the input was trained with, in place of what its points tell. */
spin_status spin_rows_4d_looks(struct spin_plan *plan);
/* The rows to the trainer, and each frame's list of them; what spin_frames_load() does for other
 * methods. */
spin_status spin_rows_4d_load(const struct spin_rows_4d *rows, const struct spin_plan *plan,
                              struct spin_trainer *trainer, struct spin_frames *frames);
/* The rows as they are by now, settled; to be freed also after a failure. */
spin_status spin_rows_4d_read(const struct spin_plan *plan, struct spin_trainer *trainer,
                              enum spin_round_4d round, struct spin_splats_4d *out);
