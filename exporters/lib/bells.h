/* 4D splats as files take them whose windows are bells: in the file's unit of time, which is 0 at
 * the first frame, on paths of a degree that it has, without what it has not. What that loses is
 * measured. */
#pragma once

#include "spin.h"

struct spin_bells {
    const struct spin_export_job *job; /* with splats_4d */
    const char *name;                  /* of the format, for messages */
    double length;                     /* of the clip, in the file's unit */
    double most_sigma;                 /* clips that a sigma lasts at most */
    bool says_cov2d;                   /* the file holds these two factors */
    int least_degree, degree;          /* of paths that the file holds */

    struct spin_splats_4d clip; /* rows that some time of the clip shows; not settled */
    size_t *from;               /* [clip.n] row of the source */
    struct spin_splats view;    /* the clip's arrays, as those of a frame */
    double lost_place, lost_turn,
        lost_colour; /* the most: world units where half is seen, degrees, of 1 */
};

/* Whether windows are bells while the clip lasts, and it has more than one frame. */
spin_status spin_bells_can(const struct spin_bells *b);
/* Frames per second: the option's, the bundle's, or 30 with a warning. */
spin_status spin_bells_fps(const struct spin_bells *b, double *out);
/* Fills the last six. */
spin_status spin_bells_convert(struct spin_bells *b);
/* One warning for each thing that is lost. */
void spin_bells_warn(const struct spin_bells *b);
/* The file's time of a source's. */
double spin_bells_time(const struct spin_bells *b, double time);
/* Row k of the clip belongs to another time from now on, and stays on its path. */
void spin_bells_move(struct spin_splats_4d *s, size_t k, double time);
void spin_bells_free(struct spin_bells *b);
