/* Encodes columns of integers as bytes for the blocks of a web page, and decodes them.
 * exporters/html/format.md describes the format.
 *
 * A column begins with one byte: the number of byte planes in bits 0 to 2 (0: all differences are
 * zero), and the predictor in bits 4 and 5. The difference d of each number from its prediction is
 * zigzag coded (2 d, or -2 d - 1 if d < 0). The codes are stored as byte planes: the lowest bytes
 * of all codes, then the next higher bytes, and so on. */
#pragma once

#include "spin.h"

/* Upper limit on the magnitude of numbers, so that sums and products in the decoder do not
 * overflow. */
#define SPIN_PAGE_MOST (1 << 26)

struct spin_page_bytes {
    uint8_t *data;
    size_t n, room;
};
void spin_page_bytes_free(struct spin_page_bytes *b);

/* Appends a column of a key frame, or of rows that only one frame has: n numbers, which are stored
 * unchanged or as differences from the previous number, whichever needs fewer bits. */
spin_status spin_page_encode_whole(struct spin_page_bytes *b, const int32_t *x, size_t n);

/* Appends a column of 4D splats. other: the previous column; NULL: none. One of four predictors is
 * used for the whole column, whichever leads to the smallest size: zero, the previous number, the
 * number of `other` in the same row, or that number plus the previous row's difference from
 * `other`. */
spin_status spin_page_encode_column(struct spin_page_bytes *b, const int32_t *x,
                                    const int32_t *other, size_t n);

/* The state of a dynamic column in the decoder, from which numbers are predicted: last, the numbers
 * of the previous frame; mean, 16 times their exponential moving average, in which weights halve
 * with each earlier frame. */
struct spin_page_state {
    int32_t *last, *mean;
};

/* Appends the changes of a frame: a mask with a bit for each number, which is 1 if the number
 * differs from its prediction, then the zigzag codes, minus 1, of the differences that are not
 * zero. The predictions are state->last or the averages of state->mean, whichever leads to a
 * smaller size. Updates *state with x. */
spin_status spin_page_encode_changes(struct spin_page_bytes *b, const int32_t *x, size_t n,
                                     struct spin_page_state *state);

/* The inverse functions decode a column that begins at byte *at, and set *at to its end. They fail
 * with SPIN_E_MALFORMED if the data end early or the first byte of the column is invalid. */
spin_status spin_page_decode_whole(const uint8_t *data, size_t size, size_t *at, int32_t *x,
                                   size_t n);
spin_status spin_page_decode_column(const uint8_t *data, size_t size, size_t *at, int32_t *x,
                                    const int32_t *other, size_t n);
spin_status spin_page_decode_changes(const uint8_t *data, size_t size, size_t *at, size_t n,
                                     struct spin_page_state *state);
