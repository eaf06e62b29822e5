/* Converts residual values of splats in host memory between two layouts. In rows, each splat has
 * SPIN_RESIDUAL consecutive floats: 3 of log scale, 4 of rotation, 3 of colour, 1 of logit opacity.
 * The device stores four consecutive groups instead, one for each attribute, [n][3] [n][4] [n][3]
 * [n], because each attribute has its own learning rate. */
#pragma once

#include "device/device.h"

/* Number of floats per splat in each group: 3, 4, 3 and 1, in the order of the heads of the
 * network. */
extern const size_t spin_residual_width[SPIN_HEADS];

/* Copies the values of n splats from rows to groups, or from groups to rows. Consecutive rows begin
 * `stride` floats apart. Splat i of the groups corresponds to row row_of[i] or, if row_of is NULL,
 * to row i. */
void spin_residual_from_rows(size_t n, const float *rows, size_t stride, const uint32_t *row_of,
                             float *groups);
void spin_residual_to_rows(size_t n, const float *groups, const uint32_t *row_of, float *rows,
                           size_t stride);
