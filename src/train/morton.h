/* Order of points along a space-filling curve. */
#pragma once

#include "spin.h"

/* order[0..n-1] = the points sorted by Morton code, which interleaves the bits of their coordinates
 * (21 bits per axis within the bounding box); ties by index. points [n][3], finite. */
spin_status spin_morton_order(size_t n, const float *points, uint32_t *order);
