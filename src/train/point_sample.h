/* A sample of the points of a clip, and a ball that contains most of the points. */
#pragma once

#include "spin.h"

struct spin_point_sample {
    float *point; /* [n][3] sampled points, followed by [n] floats of scratch */
    size_t n;
};

/* Allocates memory for the sampled points of n_frames frames. Zero *sample first; close it also
 * after a failure. */
spin_status spin_point_sample_open(struct spin_point_sample *sample, int n_frames);
void spin_point_sample_close(struct spin_point_sample *sample);
/* Adds the means of at most 20000 splats of a frame, at even distances in the order of its rows. */
void spin_point_sample_add(struct spin_point_sample *sample, const struct spin_splats *s);
/* Sets centre to the median of the points along each axis, and returns the radius of the ball
 * around it that contains 90 % of the points. The sample must contain at least one point. */
float spin_point_sample_enclose(struct spin_point_sample *sample, float centre[3]);
/* Squared distance of a point from a centre. */
double spin_point_square_to(const float *point, const float centre[3]);
