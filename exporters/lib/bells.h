/* Converts 4D splats for file formats that store a Gaussian window in time: times in the file's
 * unit with 0 at the first frame, paths of a degree that the format supports, and nothing that it
 * cannot represent. The loss is measured. */
#pragma once

#include "spin.h"

struct spin_bells {
    const struct spin_export_job *job; /* has splats_4d */
    const char *name;                  /* of the format, for messages */
    double length;                     /* of the clip, in the file's unit of time */
    double most_sigma;                 /* largest sigma to write, in clip lengths */
    bool says_cov2d;                   /* the format stores the two cov2d factors */
    int least_degree, degree;          /* lowest and highest degree of paths in the format */

    struct spin_splats_4d clip; /* the rows visible at some time of the clip; not settled */
    size_t *from;               /* [clip.n] row of the source */
    struct spin_splats view;    /* the arrays of clip as a frame's */
    /* The largest error: world units at times where the window is at least 1/2, degrees, 0..1. */
    double lost_place, lost_turn, lost_colour;
};

/* Checks that the windows are Gaussian within the clip, and that it has more than one frame. */
spin_status spin_bells_can(const struct spin_bells *b);
/* Frames per second: the option's, the bundle's, or 30 with a warning. */
spin_status spin_bells_fps(const struct spin_bells *b, double *out);
/* Fills clip and all after it. */
spin_status spin_bells_convert(struct spin_bells *b);
/* Warns once for each kind of loss. */
void spin_bells_warn(const struct spin_bells *b);
/* Converts a time of the source to the file's. */
double spin_bells_time(const struct spin_bells *b, double time);
/* Moves the centre of row k in time; the row keeps its path. */
void spin_bells_move(struct spin_splats_4d *s, size_t k, double time);
void spin_bells_free(struct spin_bells *b);
