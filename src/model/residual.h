/* Stored values of splats in host memory. A row has SPIN_RESIDUAL floats: log scale 3, rotation 4,
 * colour 3, logit opacity 1. The device stores the same as four consecutive groups, [n][3] [n][4]
 * [n][3] [n], because each group has its own learning rate. */
#pragma once

#include "device/device.h"

/* Floats per splat of each group, in the order of the heads. */
extern const size_t spin_residual_width[SPIN_HEADS];

/* Rows are `stride` floats apart. Splat i of the groups is row row_of[i]; NULL: row i. */
void spin_residual_from_rows(size_t n, const float *rows, size_t stride, const uint32_t *row_of,
                             float *groups);
void spin_residual_to_rows(size_t n, const float *groups, const uint32_t *row_of, float *rows,
                           size_t stride);
