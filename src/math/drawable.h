/* Decides which splats are omitted from output files because no viewer can draw them: those with a
 * NaN or infinity, which hangs some viewers; a rotation of length zero; a scale whose square
 * overflows float; or a scale larger than the scene, that is, a standard deviation above the
 * diagonal of the bounding box of the frame's positions, which would cover everything with one
 * colour. */
#pragma once

#include <stddef.h>

#include "math/portable.h"

/* exp(2 * 44) is the last integer power that float holds: renderers square the scale. */
#define SPIN_LOG_SCALE_LIMIT 44.0f
/* exp() of larger values overflows float. */
#define SPIN_LOG_SCALE_MOST 88.72283f
/* With fewer positions than this, their bounding box does not measure the scene. */
#define SPIN_LEAST_FOR_BOX 8

/* Why a splat is omitted. */
enum spin_undrawable {
    SPIN_ROWS_NOT_FINITE,  /* NaN or infinity */
    SPIN_ROWS_NO_ROTATION, /* of length zero */
    SPIN_ROWS_TOO_LARGE,   /* compared with the scene */
    SPIN_ROWS_REASONS      /* not omitted */
};

/* x * 0 is 0 for a finite x and NaN for any other: the sum tests all values without a branch. */
SPIN_FN float spin_zeros(const float *x, size_t n)
{
    float sum = 0;

    for (size_t i = 0; i < n; i++)
        sum += x[i] * 0.0f;
    return sum;
}

/* Extends a bounding box by a position if that is finite, and returns whether it is. low and high
 * start as INFINITY and -INFINITY. */
SPIN_FN int spin_box_add(const float place[3], float low[3], float high[3])
{
    if (spin_zeros(place, 3) != 0.0f)
        return 0;
    for (int c = 0; c < 3; c++) {
        low[c] = spin_minf(low[c], place[c]);
        high[c] = spin_maxf(high[c], place[c]);
    }
    return 1;
}

/* The largest log scale of a frame that has n finite positions in this bounding box. max_scale: in
 * units of its diagonal; 0: no limit but SPIN_LOG_SCALE_LIMIT. */
SPIN_FN float spin_log_scale_limit(const float low[3], const float high[3], size_t n,
                                   double max_scale)
{
    double square = 0, limit;

    for (int c = 0; c < 3 && n > 0; c++)
        square += ((double)high[c] - low[c]) * ((double)high[c] - low[c]);
    if (n < SPIN_LEAST_FOR_BOX || !(square > 0) || !(max_scale > 0))
        return SPIN_LOG_SCALE_LIMIT;
    limit = log(max_scale) + 0.5 * log(square);
    return limit < (double)SPIN_LOG_SCALE_LIMIT ? (float)limit : SPIN_LOG_SCALE_LIMIT;
}

/* Quaternions whose squared length overflows float are drawable. An infinite logit is an opacity of
 * 0 or 1. */
SPIN_FN enum spin_undrawable spin_undrawable(const float place[3], const float q[4],
                                             const float log_scale[3], const float *logit,
                                             const float *sh, size_t n_sh, float limit)
{
    float sum =
        spin_zeros(place, 3) + spin_zeros(q, 4) + spin_zeros(log_scale, 3) + spin_zeros(sh, n_sh);

    if (sum != 0.0f || isnan(*logit))
        return SPIN_ROWS_NOT_FINITE;
    if (!(q[0] || q[1] || q[2] || q[3]))
        return SPIN_ROWS_NO_ROTATION;
    if (!(spin_maxf(log_scale[0], spin_maxf(log_scale[1], log_scale[2])) <= limit))
        return SPIN_ROWS_TOO_LARGE;
    return SPIN_ROWS_REASONS;
}
