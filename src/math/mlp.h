/* A head of the field: three linear layers with an activation after the first and the second
 * (docs/method.md 3.4). This file contains the layout of a head's parameters and the ReLU; the
 * matrix products are in src/device. */
#pragma once

#include <stddef.h>

#include "math/approx.h"

/* Offsets of the parameters of a head, in floats: w1 [hidden][n_in], b1 [hidden],
 * w2 [hidden][hidden], b2 [hidden], w3 [n_out][hidden], b3 [n_out]. Layer k computes y = wk x + bk.
 * size: number of floats of a head. */
struct spin_head_layout {
    size_t w1, b1, w2, b2, w3, b3, size;
};

SPIN_FN struct spin_head_layout spin_head_layout(int n_in, int hidden, int n_out)
{
    struct spin_head_layout at;

    at.w1 = 0;
    at.b1 = at.w1 + (size_t)hidden * n_in;
    at.w2 = at.b1 + (size_t)hidden;
    at.b2 = at.w2 + (size_t)hidden * hidden;
    at.w3 = at.b2 + (size_t)hidden;
    at.b3 = at.w3 + (size_t)n_out * hidden;
    at.size = at.b3 + (size_t)n_out;
    return at;
}

SPIN_FN float spin_relu(float x) { return x < 0.0f ? 0.0f : x; }
SPIN_FN float spin_relu_slope(float x) { return x > 0.0f ? 1.0f : 0.0f; }
