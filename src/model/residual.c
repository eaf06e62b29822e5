/* Copies residual values between rows and groups. */
#include "model/residual.h"

#include <string.h>

const size_t spin_residual_width[SPIN_HEADS] = {3, 4, 3, 1};

void spin_residual_from_rows(size_t n, const float *rows, size_t stride, const uint32_t *row_of,
                             float *groups)
{
    for (size_t k = 0, first = 0; k < SPIN_HEADS; first += spin_residual_width[k++])
        for (size_t i = 0; i < n; i++, groups += spin_residual_width[k])
            memcpy(groups, rows + (row_of ? row_of[i] : i) * stride + first,
                   spin_residual_width[k] * sizeof *groups);
}

void spin_residual_to_rows(size_t n, const float *groups, const uint32_t *row_of, float *rows,
                           size_t stride)
{
    for (size_t k = 0, first = 0; k < SPIN_HEADS; first += spin_residual_width[k++])
        for (size_t i = 0; i < n; i++, groups += spin_residual_width[k])
            memcpy(rows + (row_of ? row_of[i] : i) * stride + first, groups,
                   spin_residual_width[k] * sizeof *groups);
}
