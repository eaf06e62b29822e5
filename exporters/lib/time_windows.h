/* Converts 4D splats for file formats that store a Gaussian window in time. Times are converted to
 * the file's unit, with 0 at the first frame, and paths to a degree that the format supports;
 * attributes that the format cannot represent are dropped. The errors are measured. */
#pragma once

#include "spin.h"

struct spin_time_windows {
    const struct spin_export_job *job; /* the export; job->splats_4d is not NULL */
    const char *name;                  /* the format's name in messages */
    double length;                     /* duration of the clip in the file's unit of time */
    /* Largest sigma to write, as a multiple of the clip's duration; 0: no limit. */
    double most_sigma;
    bool stores_cuts;         /* true: the format stores abrupt beginnings and ends */
    bool says_cov2d;          /* true: the format stores the two factors of splats_4d->cov2d */
    int least_degree, degree; /* lowest and highest degree of paths in the format */

    /* The splats that are visible at some time of the clip; `spans` is not set. */
    struct spin_splats_4d clip;
    size_t *from;            /* [clip.n] row of the source from which each row was converted */
    struct spin_splats view; /* the arrays of `clip` in the form of a frame */
    /* Largest errors. lost_place: of a position in world units, at times when the window is at
     * least 1/2; lost_turn: of a rotation in degrees; lost_colour: of a colour channel, whose range
     * is 0..1. */
    double lost_place, lost_turn, lost_colour;
};

/* Returns SPIN_E_UNSUPPORTED if a window is not Gaussian within the clip, or if the clip has only
 * one frame. */
spin_status spin_time_windows_can(const struct spin_time_windows *b);
/* Sets *out to the frames per second: the value of --fps, else that of the bundle, else 30 with a
 * warning. */
spin_status spin_time_windows_fps(const struct spin_time_windows *b, double *out);
/* Converts the 4D splats: sets `clip` and all members after it. */
spin_status spin_time_windows_convert(struct spin_time_windows *b);
/* Warns once for each kind of loss. */
void spin_time_windows_warn(const struct spin_time_windows *b);
/* Converts a time from the source's unit to the file's. */
double spin_time_windows_time(const struct spin_time_windows *b, double time);
/* Sets the time of row k, and moves its centre along the path to the position at this time. The
 * path stays the same curve. */
void spin_time_windows_move(struct spin_splats_4d *s, size_t k, double time);
void spin_time_windows_free(struct spin_time_windows *b);
