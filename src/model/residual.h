/* Converts residual values of splats in host memory between two layouts. In rows, each splat has
 * SPIN_RESIDUAL consecutive floats: 3 of log scale, 4 of rotation, 3 of colour, 1 of logit opacity.
 * The device stores the values in four consecutive groups instead, [n][3] [n][4] [n][3] [n],
 * because each group has its own learning rate. */
#pragma once

#include "device/device.h"

/* Number of floats that a splat has in each group; groups have the order of the heads. */
extern const size_t spin_residual_width[SPIN_HEADS];

/* Copies the values of n splats from rows to groups, or from groups to rows. Rows begin `stride`
 * floats apart. Splat i of the groups has row row_of[i] or, if row_of is NULL, row i. */
void spin_residual_from_rows(size_t n, const float *rows, size_t stride, const uint32_t *row_of,
                             float *groups);
void spin_residual_to_rows(size_t n, const float *groups, const uint32_t *row_of, float *rows,
                           size_t stride);
