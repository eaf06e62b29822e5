/* Decides which splats are omitted from output files because viewers cannot draw them:
 *
 * - splats with NaN or infinity, which make some viewers hang;
 * - splats with a rotation of length zero;
 * - splats that are too large: the square of their scale overflows float, or their standard
 *   deviation exceeds --max-scale (by default 1) times the diagonal of the bounding box of the
 *   frame's positions, so that they would cover the whole scene with one colour. */
#pragma once

#include <stddef.h>

#include "math/portable.h"

/* The largest log scale in any frame, whatever the size of the scene. Renderers square the scale,
 * and exp(2 * 44) still fits into a float, whereas exp(2 * 45) does not. */
#define SPIN_LOG_SCALE_LIMIT 44.0f
/* The largest value whose exp() fits into a float. */
#define SPIN_LOG_SCALE_MOST 88.72283f
/* The bounding box of fewer positions than this is not used as a measure of the scene's size. */
#define SPIN_LEAST_FOR_BOX 8

/* Why a splat is omitted. */
enum spin_undrawable {
    SPIN_ROWS_NOT_FINITE,  /* a value is NaN or infinite */
    SPIN_ROWS_NO_ROTATION, /* the rotation has length zero */
    SPIN_ROWS_TOO_LARGE,   /* a log scale is above spin_log_scale_limit() */
    SPIN_ROWS_REASONS      /* number of reasons; returned for a splat that is kept */
};

/* Returns 0 if all n values are finite, otherwise NaN. x * 0 is 0 for finite x, and NaN for NaN and
 * infinities, so the sum tests all values without branches. */
SPIN_FN float spin_zeros(const float *x, size_t n)
{
    float sum = 0;

    for (size_t i = 0; i < n; i++)
        sum += x[i] * 0.0f;
    return sum;
}

/* Extends a bounding box by a position if the position is finite, and returns 1; otherwise returns
 * 0. Initialise low to INFINITY and high to -INFINITY. */
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

/* The largest allowed log scale in a frame with n finite positions within this bounding box.
 * max_scale: largest allowed scale as a multiple of the diagonal of the bounding box; 0: only
 * SPIN_LOG_SCALE_LIMIT applies. */
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

/* Returns why a splat is omitted, or SPIN_ROWS_REASONS if it is kept. limit: largest allowed log
 * scale. An infinite logit is allowed, since it is an opacity of 0 or 1; so is a finite quaternion
 * of any length except zero. */
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
