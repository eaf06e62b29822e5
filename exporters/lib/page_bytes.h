/* Columns of integers as bytes, for the blocks of a page; exporters/html/format.md describes the
 * layout.
 *
 * A column begins with one byte: the number of byte planes in bits 0 to 2 (0: all numbers are zero)
 * and the predictor in bits 4 and 5. Each difference d from the prediction is zigzag coded as d < 0
 * ? -2 d - 1 : 2 d, and stored as planes: the lowest bytes of all numbers, then the next higher. */
#pragma once

#include "spin.h"

/* Upper limit of the magnitude of numbers, so that sums and products in the decoder do not
 * overflow. */
#define SPIN_PAGE_MOST (1 << 26)

struct spin_page_bytes {
    uint8_t *data;
    size_t n, room;
};
void spin_page_bytes_free(struct spin_page_bytes *b);

/* Appends a column of a key frame, or of rows that only one frame has: n numbers, stored as they
 * are or as differences from the previous number, whichever is smaller. */
spin_status spin_page_encode_whole(struct spin_page_bytes *b, const int32_t *x, size_t n);

/* Appends a column of 4D splats. `other` is the previous column; NULL: there is none. A number is
 * predicted as zero, as the previous number, as the number of `other` in the same row, or as a
 * combination of the last two. The predictor that leads to the smallest column is used for all
 * numbers. */
spin_status spin_page_encode_column(struct spin_page_bytes *b, const int32_t *x,
                                    const int32_t *other, size_t n);

/* The decoder's state of a dynamic column: the numbers of the frame before, and 16 times their
 * exponential moving average, in which the weight halves with each earlier frame. */
struct spin_page_state {
    int32_t *last, *mean;
};

/* Appends the changes of a frame: a mask with a bit for each number, which is 1 if the number
 * differs from its prediction, then the zigzag codes of these differences, decremented by one. The
 * predictions are the numbers of the frame before or their moving averages, whichever leads to a
 * smaller size. Updates *state to x. */
spin_status spin_page_encode_changes(struct spin_page_bytes *b, const int32_t *x, size_t n,
                                     struct spin_page_state *state);

/* The inverse functions decode a column that begins at byte *at and set *at to its end.
 * SPIN_E_MALFORMED: the data ends early or the first byte of the column is invalid. */
spin_status spin_page_decode_whole(const uint8_t *data, size_t size, size_t *at, int32_t *x,
                                   size_t n);
spin_status spin_page_decode_column(const uint8_t *data, size_t size, size_t *at, int32_t *x,
                                    const int32_t *other, size_t n);
spin_status spin_page_decode_changes(const uint8_t *data, size_t size, size_t *at, size_t n,
                                     struct spin_page_state *state);
