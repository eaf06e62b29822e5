/* A sample of a clip's points, and the ball that contains most of them. */
#pragma once

#include "spin.h"

struct spin_point_sample {
    float *point; /* [n][3], followed by scratch of [n] */
    size_t n;
};

/* Allocates for the points of n_frames frames. Zero it first; close it also after a failure. */
spin_status spin_point_sample_open(struct spin_point_sample *sample, int n_frames);
void spin_point_sample_close(struct spin_point_sample *sample);
/* Adds at most 20000 points of a frame, evenly spaced in its order. */
void spin_point_sample_add(struct spin_point_sample *sample, const struct spin_splats *s);
/* centre = the median of each axis; returns the 90th percentile of the distance to it. The sample
 * must have a point. */
float spin_point_sample_enclose(struct spin_point_sample *sample, float centre[3]);
/* Squared distance of a point from a centre. */
double spin_point_square_to(const float *point, const float centre[3]);
