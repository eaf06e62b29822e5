/* Sorts points along a space-filling curve, the Morton curve. */
#pragma once

#include "spin.h"

/* Sets order [n] to the indices of the points, sorted by Morton code. The code interleaves the bits
 * of a point's coordinates, each quantised to 21 bits over the bounding box of all points. Points
 * with equal codes are sorted by index. points [n][3] must be finite. */
spin_status spin_morton_order(size_t n, const float *points, uint32_t *order);
