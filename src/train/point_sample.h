/* A sample of a clip's points, and the ball that holds most of them. */
#pragma once

#include "spin.h"

struct spin_point_sample {
    float *point; /* [n][3], and room for a float more for each */
    size_t n;
};

/* Room for the points of so many frames. Zero it first; close it also after a failure. */
spin_status spin_point_sample_open(struct spin_point_sample *sample, int n_frames);
void spin_point_sample_close(struct spin_point_sample *sample);
/* Points of a frame, at most 20000, evenly out of all. */
void spin_point_sample_add(struct spin_point_sample *sample, const struct spin_splats *s);
/* centre = the median of each axis; returns the 90th percentile of the distance to it. At least one
 * point. */
float spin_point_sample_enclose(struct spin_point_sample *sample, float centre[3]);
/* The square of a point's distance to a centre. */
double spin_point_square_to(const float *point, const float centre[3]);
