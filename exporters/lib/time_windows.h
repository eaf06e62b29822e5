/* Converts 4D splats for file formats that store a Gaussian window in time. Times are converted to
 * the file's unit, with 0 at the first frame, and paths to a degree that the format supports;
 * attributes that the format cannot represent are dropped. The errors are measured. */
#pragma once

#include "spin.h"
#include "exporters/lib/splat_rows.h"

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

/* ---- The check ------------------------------------------------------------------------------- */

/* --check for files of 4D splats: reads a file back with its importer and compares it with the clip
 * that was written. */

struct spin_time_windows_check {
    /* The clip, with times and sigmas rounded as in the file. */
    const struct spin_time_windows *windows;
    /* The filter that chose the rows of windows->view to be written. */
    const struct spin_splat_rows *rows;
    const struct spin_keyed *order; /* [n] row j of the file is row order[j].row of windows->clip */
    const uint32_t *row;            /* [n] the same; used if `order` is NULL */
    size_t n;
    /* For clips of frames: loads the rows of frame f into windows->clip and `rows`, and sets *first
     * to the number of the first of them in `row`. NULL: windows->clip contains all rows. */
    spin_status (*load)(void *context, int frame, size_t *first);
    void *context;
    const char *importer;
    /* Tolerance of log(1 + |x|) of coordinates x: half a quantisation step; 0: not quantised. */
    double half[3];
};

/* Fills job->report->check with the largest errors over all frames of the job. Returns SPIN_E_IO if
 * the file does not contain the values that were written. */
spin_status spin_time_windows_check(const struct spin_time_windows_check *of);
