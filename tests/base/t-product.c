/* Matrix products of importers' networks.  K: base product network importers simd */
#include <string.h>

#include "base/product.h"
#include "math/rng.h"
#include "tests/check.h"
#include "tests/tap.h"

enum { MOST_ROWS = 19, MOST_COLUMNS = 48, MOST_TERMS = 37, APART = MOST_TERMS + 3 };

static float left[MOST_ROWS * APART], right[MOST_TERMS * MOST_COLUMNS], start[MOST_ROWS];
static float sums[MOST_ROWS * MOST_COLUMNS], want[MOST_ROWS * MOST_COLUMNS];

static void fill(float *to, size_t n, uint64_t stream)
{
    for (size_t i = 0; i < n; i++)
        to[i] = 2 * spin_rng_uniform(1, stream, i) - 1;
}

/* Rounds after every operation and in the order of the terms, as all SIMD paths must. */
static float sum_of(int row, int column, int columns, int n, float sum)
{
    for (int k = 0; k < n; k++) {
        volatile float product = left[row * APART + k] * right[k * columns + column];

        sum += product;
    }
    return sum;
}

static void check_size(int rows, int columns, int n, bool starts, bool relu)
{
    fill(sums, sizeof sums / sizeof *sums, 3);
    for (int r = 0; r < rows; r++)
        for (int c = 0; c < columns; c++) {
            float *w = &want[r * columns + c];

            *w = sum_of(r, c, columns, n, starts ? start[r] : sums[r * columns + c]);
            *w = relu && *w < 0 ? 0 : *w;
        }
    spin_multiply_add(rows, columns, n, left, APART, right, starts ? start : NULL, relu, sums);
    check_same_bits(sums, want, (size_t)rows * (size_t)columns * sizeof *want,
                    relu ? "with ReLU, the bits of a scalar loop"
                         : "the bits of a scalar loop without FMA");
}

TAP_MAIN
{
    static const int rows[] = {1, 2, 3, 4, 7, 8, 9, MOST_ROWS};

    fill(left, sizeof left / sizeof *left, 0);
    fill(right, sizeof right / sizeof *right, 1);
    fill(start, MOST_ROWS, 2);
    for (size_t i = 0; i < sizeof rows / sizeof *rows; i++)
        for (int columns = 16; columns <= MOST_COLUMNS; columns += 16)
            check_size(rows[i], columns, MOST_TERMS, i % 2 == 0, columns == 32);
    check_size(3, 16, 1, true, false);
    check_size(3, 16, 0, false, false);
}
